/* Gradients on both sides of the MLPs: by their outputs, and by their inputs. */
#ifndef CLGS_MLP_GRADIENTS_H
#define CLGS_MLP_GRADIENTS_H

#include "common/lane_math.h"
#include "common/lanes.h"
#include "common/real.h"
#include "mlp/inputs.h"
#include "mlp/layout.h"

/* Whether the gradient by the positions is asked for. */
#ifndef WANT_POSITION
#define WANT_POSITION 1
#endif

/* Outputs of the forward pass and the gradient by them: rows of `stride` samples. */
typedef struct {
    __global const float *output;
    __global const float *d_output;
    size_t stride;
} Outputs;

/* Gradients of all anchors, zero before. An anchor is visible at most once. */
typedef struct {
    __global float *d_feature;
    __global float *d_position;
} AnchorGradients;

/* dL/dz of one output of slot j of VEC samples, for y = act(z), from y and dL/dy; zero if the slot
 * is not drawn. */
static inline fv sum_gradient(const Outputs *outputs, const int head, const int j, const size_t row,
                              const size_t first)
{
    const fv opacity = LOAD_ALIGNED(0, outputs->output + j * outputs->stride + first);
    fv d = LOAD_ALIGNED(0, outputs->d_output + row * outputs->stride + first);
    if (head != COVARIANCE) {
        const fv y = LOAD_ALIGNED(0, outputs->output + row * outputs->stride + first);
        d *= head == OPACITY ? fma(-y, y, (fv)(1.0f)) : fma(-y, y, y);
    }
    return opacity > (fv)(0.0f) ? d : (fv)(0.0f);
}

/* dL/d(position) through the unit direction, of VEC samples: d is the gradient by the direction. */
static inline void position_backward(const Inputs *inputs, const size_t first, const fv d[3],
                                     __global float *d_position)
{
    int anchor[VEC];
    __global const float *position[VEC];
    for (size_t lane = 0; lane < VEC; ++lane) {
        anchor[lane] = anchor_of(inputs, first + lane);
        position[lane] = inputs->position + 3 * (size_t)max(anchor[lane], 0);
    }
    fv view[3];
    const fv distance = view_directions(inputs, position, view);
    const fv along = dot3(d, view);
    for (int i = 0; i < 3; ++i) {
        float across[VEC];
        STORE_V(distance > (fv)(0.0f) ? (d[i] - along * view[i]) / distance : (fv)(0.0f), 0,
                across);
        for (size_t lane = 0; lane < VEC; ++lane)
            if (anchor[lane] >= 0)
                d_position[3 * (size_t)anchor[lane] + i] = across[lane];
    }
}

#endif
