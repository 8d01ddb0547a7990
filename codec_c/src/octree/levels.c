#include "octree/levels.h"

#include "common/bytes.h"

static size_t level_size(size_t count)
{
    return clgs_align(8 * count) + 3 * clgs_align(4 * count) + clgs_align(4 * (count + 1)) +
           clgs_align(4 * CLGS_AROUND * (count + 1)) + clgs_align(count);
}

size_t clgs_levels_size(size_t count)
{
    return 2 * level_size(count);
}

static void *carve(uint8_t **at, size_t size)
{
    void *start = *at;
    *at += clgs_align(size);
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

/* Coordinate of a cell on axis 0 to 2, 0 to 3. */
static int32_t coordinate(uint32_t cell, uint32_t axis)
{
    return (int32_t)(cell >> (4 - 2 * axis) & 3);
}

/* Steps of a direction on axis 0 to 2, -1 to 1. */
static int32_t step(uint32_t d, uint32_t axis)
{
    return (int32_t)(d / (axis == 0 ? 9 : axis == 1 ? 3 : 1) % 3) - 1;
}

/* Fill in which node a cell belongs to, and how the children of a node see it. */
static void cell_begin(clgs_touch *touch, uint32_t cell)
{
    uint32_t owner = 0, child = 0;
    for (uint32_t axis = 0; axis < 3; axis++) {
        uint32_t place = (uint32_t)coordinate(cell, axis) + 1; /* from -1: 1 to 4 */
        owner = 3 * owner + place / 2;
        child = 2 * child + place % 2;
    }
    touch->owner[cell] = (uint8_t)owner;
    touch->before[cell] = (uint8_t)((1u << child) - 1);
    touch->facing[owner] |= (uint8_t)(1u << child);
    for (uint32_t own = 0; own < 8; own++) {
        uint32_t d = 0, near = 1;
        for (uint32_t axis = 0; axis < 3; axis++) {
            int32_t move = coordinate(cell, axis) - 1 - (int32_t)(own >> (2 - axis) & 1);
            near &= move >= -1 && move <= 1;
            d = 3 * d + (uint32_t)(move + 1);
        }
        touch->direction[own][cell] = (uint8_t)(near ? d : CLGS_SELF);
        touch->window[own] |= (uint64_t)(near && d != CLGS_SELF) << cell;
    }
}

static void occupancy_begin(clgs_touch *touch, uint32_t occupancy)
{
    touch->count[occupancy] = (uint8_t)(touch->count[occupancy / 2] + occupancy % 2);
    for (uint32_t child = 0; child < 8; child++) {
        uint64_t cell = 16 * (child >> 2) + 4 * (child >> 1 & 1) + (child & 1);
        touch->spread[occupancy] |= (uint64_t)(occupancy >> child & 1) << cell;
        for (uint32_t own = 0; own < 8; own++)
            touch->mirror[own][occupancy] |= (uint8_t)((occupancy >> child & 1) << (child ^ own));
    }
}

static void touch_begin(clgs_touch *touch)
{
    *touch = (clgs_touch){0};
    for (uint32_t cell = 0; cell < 64; cell++)
        cell_begin(touch, cell);
    for (uint32_t occupancy = 0; occupancy < 256; occupancy++)
        occupancy_begin(touch, occupancy);
    for (uint32_t d = 0; d < CLGS_DIRECTIONS; d++) {
        int32_t shift = 21 + 2 * (16 * step(d, 0) + 4 * step(d, 1) + step(d, 2));
        touch->shift[d] = (uint8_t)((uint32_t)shift & 63);
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
