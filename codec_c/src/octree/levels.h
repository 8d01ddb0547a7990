/* The nodes of two octree levels, in Morton order: one that is coded, and the one above it.
 *
 * A node knows the nodes among the 26 cells around its own: a list as long as needed, found among
 * the children of those around its parent. Nodes that were coded whole have no children.
 */
#ifndef CLGS_OCTREE_LEVELS_H
#define CLGS_OCTREE_LEVELS_H

#include "clgs_codec.h"

#define CLGS_AROUND 26     /* cells around a node */
#define CLGS_DIRECTIONS 27 /* 9 (dx + 1) + 3 (dy + 1) + (dz + 1); 13 is the node itself */
#define CLGS_SELF 13

typedef struct clgs_level {
    size_t count;
    uint64_t *code;     /* Morton code of the node's cell at its level */
    uint32_t *begin;    /* encoder: index of the node's first point */
    uint32_t *end;      /* encoder: one after its last point */
    uint32_t *first;    /* where its list starts in `list`; one more entry at the end */
    uint32_t *list;     /* 32 * index of a node + its direction */
    uint32_t *child;    /* index of its first child, one level below */
    uint8_t *occupancy; /* bit c: child c exists; child c = 4 x + 2 y + z */
} clgs_level;

/* Of the cells of a node's children and those around them, 4 x 4 x 4 with numbers 16 x + 4 y + z,
 * the children's own are those with x, y, z in 1 to 2. Bits of 64-bit masks are such cells. */
typedef struct clgs_touch {
    uint64_t window[8];              /* the 26 cells around child [0] */
    uint64_t spread[256];            /* children of occupancy [0], with x, y, z in 0 to 1 */
    uint8_t shift[CLGS_DIRECTIONS];  /* rotates them to their place for nodes in direction [0] */
    uint8_t facing[CLGS_DIRECTIONS]; /* mask of children there that are among the cells */
    uint8_t owner[64];               /* direction of the node whose child has cell [0] */
    uint8_t before[64];              /* mask of its children before that one */
    uint8_t direction[8][64];        /* from child [0] to cell [1] */
    uint8_t mirror[8][256];          /* occupancy [1] with child c at place c xor [0] */
    uint8_t count[256];              /* number of bits set */
} clgs_touch;

typedef struct clgs_levels {
    clgs_level above, now;
    size_t capacity; /* nodes that a level can hold */
    size_t children; /* of the nodes of `now` so far */
    int root;        /* `now` is the root's level */
    clgs_touch touch;
} clgs_levels;

/* Bytes of both levels with room for `count` nodes. */
size_t clgs_levels_size(size_t count);

/* Lay the arrays out at `memory`. `above` holds one node, whose only child, number 0, is the root
 * and holds points 0 to count - 1. */
void clgs_levels_begin(clgs_levels *levels, size_t count, uint8_t *memory);

/* Make the coded level the one above. Returns 0 if its children exceed the capacity. */
int clgs_levels_descend(clgs_levels *levels);

/* Nodes around in eight classes: 0, 1, 2, 3, 4-5, 6-8, 9-13, more. */
static inline uint32_t clgs_crowd(uint32_t around)
{
    if (around < 4)
        return around;
    return around < 6 ? 4 : around < 9 ? 5 : around < 14 ? 6 : 7;
}

/* Index of the lowest bit set, of at least one. */
static inline uint32_t clgs_lowest(uint32_t bits)
{
#if defined(__GNUC__)
    return (uint32_t)__builtin_ctz(bits);
#else
    uint32_t index = 0;
    while (!(bits >> index & 1))
        index++;
    return index;
#endif
}

static inline uint32_t clgs_lowest64(uint64_t bits)
{
#if defined(__GNUC__)
    return (uint32_t)__builtin_ctzll(bits);
#else
    uint32_t low = (uint32_t)bits;
    return low ? clgs_lowest(low) : 32 + clgs_lowest((uint32_t)(bits >> 32));
#endif
}

/* Cells of the children of a node in direction d. */
static inline uint64_t clgs_touch_cells(const clgs_touch *touch, uint32_t d, uint32_t occupancy)
{
    uint64_t spread = touch->spread[occupancy & touch->facing[d]];
    uint32_t shift = touch->shift[d];
    return spread << shift | spread >> (-shift & 63);
}

#endif
