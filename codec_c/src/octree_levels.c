#include "octree_levels.h"

static size_t align(size_t size)
{
    return (size + 63) / 64 * 64;
}

static size_t level_size(size_t count)
{
    return align(8 * count) + 3 * align(4 * (count + 1)) + align(4 * CLGS_AROUND * count) +
           2 * align(count);
}

size_t clgs_levels_size(size_t count)
{
    return 2 * level_size(count) + align(count) + align(4 * count);
}

static void *carve(uint8_t **at, size_t size)
{
    void *start = *at;
    *at += align(size);
    return start;
}

static void carve_level(clgs_level *level, size_t count, uint8_t **at)
{
    level->code = carve(at, 8 * count);
    level->begin = carve(at, 4 * (count + 1));
    level->end = carve(at, 4 * (count + 1));
    level->first = carve(at, 4 * (count + 1));
    level->list = carve(at, 4 * CLGS_AROUND * count);
    level->parent = carve(at, count);
    level->family = carve(at, count);
}

static uint32_t direction(int32_t x, int32_t y, int32_t z)
{
    return (uint32_t)(9 * (x + 1) + 3 * (y + 1) + z + 1);
}

/* Direction from child `own` of a node to child `other` of the node at (x, y, z), or 27 where
 * they do not touch. */
static uint32_t between(uint32_t own, uint32_t other, int32_t x, int32_t y, int32_t z)
{
    x = 2 * x + (int32_t)(other >> 2) - (int32_t)(own >> 2);
    y = 2 * y + (int32_t)(other >> 1 & 1) - (int32_t)(own >> 1 & 1);
    z = 2 * z + (int32_t)(other & 1) - (int32_t)(own & 1);
    if (x < -1 || x > 1 || y < -1 || y > 1 || z < -1 || z > 1)
        return CLGS_DIRECTIONS;
    return direction(x, y, z);
}

static void touch_begin(clgs_touch *touch)
{
    for (uint32_t d = 0; d < CLGS_DIRECTIONS; d++)
        for (uint32_t own = 0; own < 8; own++) {
            int32_t x = (int32_t)(d / 9) - 1, y = (int32_t)(d / 3 % 3) - 1,
                    z = (int32_t)(d % 3) - 1;
            touch->reach[d][own] = 0;
            for (uint32_t other = 0; other < 8; other++) {
                uint32_t step = between(own, other, x, y, z);
                touch->outer[d][own][other] = (uint8_t)step;
                if (step < CLGS_DIRECTIONS)
                    touch->reach[d][own] |= (uint8_t)(1u << other);
                if (d == CLGS_SELF)
                    touch->inner[own][other] = (uint8_t)step;
            }
        }
    for (uint32_t own = 0; own < 8; own++)
        for (uint32_t occupancy = 0; occupancy < 256; occupancy++) {
            uint32_t mirrored = 0;
            for (uint32_t child = 0; child < 8; child++)
                mirrored |= (occupancy >> child & 1) << (child ^ own);
            touch->mirror[own][occupancy] = (uint8_t)mirrored;
        }
}

void clgs_levels_begin(clgs_levels *levels, size_t count, uint8_t *memory)
{
    levels->capacity = count;
    carve_level(&levels->now, count, &memory);
    carve_level(&levels->next, count, &memory);
    levels->occupancy = carve(&memory, count);
    levels->child = carve(&memory, 4 * count);
    levels->now.count = 1;
    levels->now.code[0] = 0;
    levels->now.begin[0] = 0;
    levels->now.end[0] = (uint32_t)count;
    levels->now.first[0] = levels->now.first[1] = 0;
    levels->now.parent[0] = levels->now.family[0] = 0;
    touch_begin(&levels->touch);
}

/* Write the list of child `own` of node i to `list`; returns its length. */
static uint32_t inherit(const clgs_levels *levels, size_t i, uint32_t own, uint32_t *list)
{
    const clgs_level *now = &levels->now;
    uint32_t length = 0, next = levels->child[i];
    for (uint32_t left = levels->occupancy[i]; left; left &= left - 1, next++) {
        uint32_t other = clgs_lowest(left);
        if (other != own)
            list[length++] = next << 5 | levels->touch.inner[own][other];
    }
    for (uint32_t k = now->first[i]; k < now->first[i + 1]; k++) {
        uint32_t d = now->list[k] & 31, node = now->list[k] >> 5;
        uint32_t occupancy = levels->occupancy[node];
        for (uint32_t left = occupancy & levels->touch.reach[d][own]; left; left &= left - 1) {
            uint32_t other = clgs_lowest(left);
            uint32_t before = clgs_count8(occupancy & ((1u << other) - 1));
            list[length++] =
                (levels->child[node] + before) << 5 | levels->touch.outer[d][own][other];
        }
    }
    return length;
}

static void grow(clgs_levels *levels, size_t i)
{
    clgs_level *now = &levels->now, *next = &levels->next;
    uint32_t occupancy = levels->occupancy[i], node = levels->child[i];
    uint8_t parent = (uint8_t)clgs_crowd(now->first[i + 1] - now->first[i]);
    for (uint32_t left = occupancy; left; left &= left - 1, node++) {
        uint32_t first = next->first[node], octant = clgs_lowest(left);
        next->code[node] = now->code[i] << 3 | octant;
        next->parent[node] = parent;
        next->family[node] = levels->touch.mirror[octant][occupancy];
        next->first[node + 1] = first + inherit(levels, i, octant, next->list + first);
    }
}

int clgs_levels_descend(clgs_levels *levels, int last)
{
    clgs_level spare = levels->now;
    size_t total = 0;
    for (size_t i = 0; i < levels->now.count; i++) {
        levels->child[i] = (uint32_t)total;
        total += clgs_count8(levels->occupancy[i]);
    }
    if (total > levels->capacity)
        return 0;
    levels->next.first[0] = 0;
    for (size_t i = 0; i < levels->now.count; i++) {
        if (!last) {
            grow(levels, i);
            continue;
        }
        uint64_t *code = levels->next.code + levels->child[i];
        for (uint32_t left = levels->occupancy[i]; left; left &= left - 1)
            *code++ = levels->now.code[i] << 3 | clgs_lowest(left);
    }
    levels->next.count = total;
    levels->now = levels->next;
    levels->next = spare;
    return 1;
}
