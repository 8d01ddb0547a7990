/* Shapes of the Gaussians of drawn slots: scales and rotations. */
#ifndef CLGS_SHAPES_H
#define CLGS_SHAPES_H

#include "common/own_function.h"
#include "common/real.h"
#include "gaussian/drawn_slots.h"
#include "gaussian/log_scale.h"
#include "gaussian/output_rows.h"
#include "gaussian/unit_quaternion.h"
#include "gaussian/visible_anchors.h"

/* Slot m of the drawn slots, gathered for arithmetic by lanes. */
typedef struct {
    float size[3][SLOTS]; /* exp(log scale) of its anchor */
    float logit[3][SLOTS];
    float quaternion[4][SLOTS];
} Shapes;

static inline OWN_FUNCTION void gather_shapes(const AnchorLanes *a, const DrawnSlots *drawn,
                                              const OutputRows *rows, Shapes *shapes)
{
    float size[3][VEC];
    for (int i = 0; i < 3; ++i)
        STORE_V(exp_log_scale(LOAD_V(0, a->log_scale[3 + i])), 0, size[i]);
    for (size_t m = 0; m < DRAWN(drawn); ++m) {
        const size_t lane = drawn->lane[m];
        ROW_SPACE const float *slot =
            rows->at + (COVARIANCE_ROW + 7 * drawn->offset[m]) * rows->stride + lane;
#pragma unroll
        for (int i = 0; i < 3; ++i) {
            shapes->size[i][m] = size[i][lane];
            shapes->logit[i][m] = slot[i * rows->stride];
        }
#pragma unroll
        for (int i = 0; i < 4; ++i)
            shapes->quaternion[i][m] = slot[(3 + i) * rows->stride];
    }
}

/* Scales and rotations of VEC drawn slots from number m on. */
static inline void load_shapes(const Shapes *shapes, const size_t m, fv scale[3], fv rotation[4])
{
    for (int i = 0; i < 3; ++i)
        scale[i] = LOAD_V(0, shapes->size[i] + m) * sigmoid_v(LOAD_V(0, shapes->logit[i] + m));
    for (int i = 0; i < 4; ++i)
        rotation[i] = LOAD_V(0, shapes->quaternion[i] + m);
    make_unit(rotation);
}

#endif
