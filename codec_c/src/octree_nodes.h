/* The nodes of one octree level, in Morton order, each with its 26 neighbours. */
#ifndef CLGS_OCTREE_NODES_H
#define CLGS_OCTREE_NODES_H

#include "clgs_codec.h"

#define CLGS_NEIGHBOURS 27 /* 9 (dx + 1) + 3 (dy + 1) + (dz + 1); 13 is the node itself */
#define CLGS_SELF 13

typedef struct clgs_nodes {
    size_t count, capacity;
    uint64_t *code;        /* Morton code of the node's cell at its level */
    uint8_t *occupancy;    /* bit c: child c exists; child c = 4 x + 2 y + z */
    uint32_t *first_child; /* index on the next level; valid while the next level is built */
    uint32_t *present;     /* bit d: a node lies in direction d; always has bit 13 */
    uint32_t *neighbour;   /* [27 i + d]: its index, valid where `present` has bit d */
    /* direction[o][m][c]: where child c of the cell on the far side of the axes in m (bits as in a
     * child number) lies, seen from child o. It touches child o where c differs from o in all of
     * m: those c are the bits of reach[o][m]. */
    uint8_t direction[8][8][8];
    uint8_t reach[8][8];
} clgs_nodes;

/* One node, the root; `capacity` bounds the nodes of every level. */
void clgs_nodes_begin(clgs_nodes *nodes);

/* Replace the level by its children. Returns 0 where they exceed the capacity. `last`: they are
 * leaves, whose neighbours are not needed. */
int clgs_nodes_descend(clgs_nodes *nodes, int last);

#endif
