/* What is learned while an octree is coded node by node, and what is seen around a node. */
#ifndef CLGS_OCTREE_MODEL_H
#define CLGS_OCTREE_MODEL_H

#include "entropy/mix.h"
#include "octree/levels.h"
#include "entropy/wide_range.h"

#define CLGS_HEIGHTS 6    /* classes of levels from a node to the leaves */
#define CLGS_CROWDS 8     /* classes of nodes around a node */
#define CLGS_TRUST 6      /* classes of bits that a state has seen */
#define CLGS_LOG_STEPS 44 /* quarters of an octave: logarithms of 1 to 2047 */
#define CLGS_BALANCE 12   /* the logarithm of a quotient is cut at +-12 quarters */
#define CLGS_SEEN 257     /* a node not yet coded is seen as occupancy 256 */

/* What a node around adds to what is seen; the children of a node see it together. */
typedef struct clgs_seen {
    uint64_t density;  /* a byte per child: points near to it */
    uint64_t cells[2]; /* 16 bits per child: states of its seven outer cells, two bits each */
} clgs_seen;

typedef struct clgs_octree_model {
    clgs_tables tables;
    uint8_t logarithm[2048];
    uint8_t trust[256];
    clgs_seen seen[CLGS_DIRECTIONS][CLGS_SEEN]; /* by occupancy */
    uint32_t alone[CLGS_HEIGHTS][CLGS_CROWDS];
    uint32_t only_density[CLGS_HEIGHTS][CLGS_CROWDS][4][CLGS_LOG_STEPS];
    uint32_t only_family[CLGS_HEIGHTS][CLGS_CROWDS][256];
    uint32_t half_density[CLGS_HEIGHTS][3][2 * CLGS_BALANCE + 1][CLGS_LOG_STEPS / 4];
    uint32_t half_faces[8][64][64];
    uint32_t child_faces[64][256];
    uint32_t child_outer[16384][8];
    uint32_t child_density[CLGS_HEIGHTS][CLGS_LOG_STEPS][8][8];
    int32_t only_weight[CLGS_TRUST * CLGS_TRUST][2];
    int32_t half_weight[CLGS_TRUST * CLGS_TRUST][2];
    int32_t child_weight[CLGS_TRUST * CLGS_TRUST][3];
    uint16_t only_curve[CLGS_HEIGHTS][CLGS_CURVE_KNOTS];
    uint16_t half_curve[CLGS_HEIGHTS][3][CLGS_CURVE_KNOTS];
    uint16_t child_curve[CLGS_HEIGHTS][8][8][CLGS_CURVE_KNOTS];
} clgs_octree_model;

void clgs_octree_model_begin(clgs_octree_model *model);

/* Code the nodes of `levels->now`, each with `height` levels down to the leaves. Nodes that hold
 * a single point may be coded whole: their codes are appended to `points`, and their occupancy
 * becomes 0. The encoder takes the points from `target`. Returns the new end of `points`. */
uint64_t *clgs_octree_code_level(clgs_octree_model *model, clgs_levels *levels, clgs_wide *coder,
                                 uint32_t height, const uint64_t *target, uint64_t *points);

#endif
