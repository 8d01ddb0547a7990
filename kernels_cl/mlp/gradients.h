/* Gradients by the outputs of the MLPs. */
#ifndef CLGS_MLP_GRADIENTS_H
#define CLGS_MLP_GRADIENTS_H

#include "common/lanes.h"
#include "common/real.h"
#include "mlp/layout.h"

/* Outputs of the forward pass and the gradient by them: rows of `stride` samples. */
typedef struct {
    __global const float *output;
    __global const float *d_output;
    size_t stride;
} Outputs;

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

#endif
