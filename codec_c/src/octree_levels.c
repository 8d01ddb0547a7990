#include "octree_levels.h"

static size_t align(size_t size)
{
    return (size + 63) / 64 * 64;
}

static size_t level_size(size_t count)
{
    return align(8 * count) + 3 * align(4 * count) + align(4 * (count + 1)) +
           align(4 * CLGS_AROUND * (count + 1)) + align(count);
}

size_t clgs_levels_size(size_t count)
{
    return 2 * level_size(count);
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
    level->begin = carve(at, 4 * count);
    level->end = carve(at, 4 * count);
    level->first = carve(at, 4 * (count + 1));
    level->list = carve(at, 4 * CLGS_AROUND * (count + 1));
    level->child = carve(at, 4 * count);
    level->occupancy = carve(at, count);
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
    touch->count[0] = 0;
    for (uint32_t own = 0; own < 8; own++)
        for (uint32_t occupancy = 0; occupancy < 256; occupancy++) {
            uint32_t mirrored = 0;
            for (uint32_t child = 0; child < 8; child++)
                mirrored |= (occupancy >> child & 1) << (child ^ own);
            touch->mirror[own][occupancy] = (uint8_t)mirrored;
            touch->count[occupancy] = (uint8_t)(touch->count[occupancy / 2] + occupancy % 2);
        }
}

void clgs_levels_begin(clgs_levels *levels, size_t count, uint8_t *memory)
{
    levels->capacity = count;
    carve_level(&levels->above, count, &memory);
    carve_level(&levels->now, count, &memory);
    levels->above.count = 1;
    levels->above.code[0] = 0;
    levels->above.occupancy[0] = 1;
    levels->above.first[0] = levels->above.first[1] = levels->above.child[0] = 0;
    levels->now.count = levels->children = 0;
    levels->now.first[0] = 0;
    levels->now.begin[0] = 0;
    levels->now.end[0] = (uint32_t)count;
    levels->root = 1;
    touch_begin(&levels->touch);
}

int clgs_levels_descend(clgs_levels *levels)
{
    clgs_level spare = levels->above;
    if (levels->children > levels->capacity)
        return 0;
    levels->above = levels->now;
    levels->now = spare;
    levels->now.count = levels->children = 0;
    levels->now.first[0] = 0;
    levels->root = 0;
    return 1;
}
