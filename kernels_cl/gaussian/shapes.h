/* Shapes of the Gaussians of drawn slots: scales and rotations. */
#ifndef CLGS_SHAPES_H
#define CLGS_SHAPES_H

#include "common/own_function.h"
#include "common/real.h"
#include "gaussian/drawn_slots.h"
#include "gaussian/output_rows.h"
#include "gaussian/visible_anchors.h"

/* A quaternion whose largest component is not between these has no direction. */
#define QUATERNION_MIN 1e-35f
#define QUATERNION_MAX 1e37f

static inline fv larger(const fv a, const fv b)
{
    return a > b ? a : b;
}

/* Makes unit quaternions, zero if there is no direction, and returns the reciprocals of their
 * lengths. Division by the largest component keeps squares from overflow and underflow. */
static inline fv make_unit(fv unit[4])
{
    const fv largest =
        larger(larger(fabs(unit[0]), fabs(unit[1])), larger(fabs(unit[2]), fabs(unit[3])));
    const fv shrink = 1.0f / largest;
    fv square = (fv)(0.0f);
    for (int i = 0; i < 4; ++i) {
        unit[i] *= shrink;
        square = fma(unit[i], unit[i], square);
    }
    /* written so that a NaN in any component fails */
    const iv valid = (largest > (fv)(QUATERNION_MIN)) & (largest < (fv)(QUATERNION_MAX)) &
                     (square >= (fv)(0.99f));
    const fv on_length = 1.0f / sqrt(square);
    for (int i = 0; i < 4; ++i)
        unit[i] = valid ? unit[i] * on_length : (fv)(0.0f);
    return valid ? on_length * shrink : (fv)(0.0f);
}

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
        STORE_V(exp_log_scale(a->log_scale[3 + i]), 0, size[i]);
    for (size_t m = 0; m < drawn->count; ++m) {
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
