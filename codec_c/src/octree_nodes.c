#include <string.h>

#include "octree_nodes.h"

static uint32_t popcount8(uint32_t bits)
{
    bits = bits - (bits >> 1 & 0x55);
    bits = (bits & 0x33) + (bits >> 2 & 0x33);
    return (bits + (bits >> 4)) & 0x0F;
}

/* Step along one axis from half `own` to half `other`, of the next node where `beyond`. */
static int32_t step(uint32_t own, uint32_t other, uint32_t beyond)
{
    if (beyond)
        return own ? 1 : -1;
    return (int32_t)other - (int32_t)own;
}

void clgs_nodes_begin(clgs_nodes *nodes)
{
    nodes->count = 1;
    nodes->code[0] = 0;
    nodes->present[0] = 1u << CLGS_SELF;
    nodes->neighbour[CLGS_SELF] = 0;
    memset(nodes->reach, 0, sizeof nodes->reach);
    for (uint32_t own = 0; own < 8; own++)
        for (uint32_t m = 0; m < 8; m++)
            for (uint32_t c = 0; c < 8; c++) {
                int32_t x = step(own >> 2, c >> 2, m >> 2);
                int32_t y = step(own >> 1 & 1, c >> 1 & 1, m >> 1 & 1);
                int32_t z = step(own & 1, c & 1, m & 1);
                nodes->direction[own][m][c] = (uint8_t)(CLGS_SELF + 9 * x + 3 * y + z);
                if (((own ^ c) & m) == m)
                    nodes->reach[own][m] |= (uint8_t)(1u << c);
            }
}

/* Fill the neighbours of child `own` of a node with neighbours `row`; returns their bits. */
static uint32_t child_neighbours(const clgs_nodes *nodes, const uint32_t *row, uint32_t present,
                                 uint32_t own, uint32_t *out)
{
    uint32_t found = 0;
    for (uint32_t m = 0; m < 8; m++) {
        uint32_t parent = nodes->direction[own][m][own];
        if (!(present >> parent & 1))
            continue;
        uint32_t occupancy = nodes->occupancy[row[parent]];
        uint32_t next = nodes->first_child[row[parent]];
        uint32_t touching = nodes->reach[own][m];
        for (uint32_t child = 0; occupancy >> child; child++) {
            if (!(occupancy >> child & 1))
                continue;
            if (touching >> child & 1) {
                uint32_t d = nodes->direction[own][m][child];
                out[d] = next;
                found |= 1u << d;
            }
            next++;
        }
    }
    return found;
}

int clgs_nodes_descend(clgs_nodes *nodes, int last)
{
    size_t total = 0;
    for (size_t i = 0; i < nodes->count; i++) {
        nodes->first_child[i] = (uint32_t)total;
        total += popcount8(nodes->occupancy[i]);
    }
    if (total > nodes->capacity)
        return 0;
    /* From the back, in place: the children of node i start at or behind i. */
    for (size_t i = nodes->count, next = total; i-- > 0;) {
        uint32_t row[CLGS_NEIGHBOURS];
        uint64_t code = nodes->code[i];
        uint32_t present = nodes->present[i];
        memcpy(row, nodes->neighbour + i * CLGS_NEIGHBOURS, sizeof row);
        for (uint32_t octant = 8; octant-- > 0;) {
            if (!(nodes->occupancy[i] >> octant & 1))
                continue;
            next--;
            nodes->code[next] = code << 3 | octant;
            if (!last)
                nodes->present[next] = child_neighbours(nodes, row, present, octant,
                                                        nodes->neighbour + next * CLGS_NEIGHBOURS);
        }
    }
    nodes->count = total;
    return 1;
}
