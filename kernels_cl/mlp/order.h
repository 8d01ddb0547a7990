/* The order of the samples of a chunk: by the slots that they draw, so that neighbours draw the
 * same slots and few slots are computed for each block of samples. */
#ifndef CLGS_MLP_ORDER_H
#define CLGS_MLP_ORDER_H

#include "common/lanes.h"
#include "common/method.h"
#include "common/real.h"

/* Samples are sorted by these keys, equal ones as they were: drawn slots in the order of a Gray
 * code, in which neighbours differ in one slot, backwards; then samples that draw nothing, and at
 * the end those without anchor. */
#define KEYS ((1 << K_OFFSETS) + 1)
#define KEY_NONE (KEYS - 2)
#define KEY_NO_ANCHOR (KEYS - 1)

/* Keys of VEC samples, each of which has an anchor. */
static inline iv sort_keys(__global const float *opacity, const size_t stride)
{
    iv slots = (iv)(0);
    for (int j = 0; j < K_OFFSETS; ++j)
        slots |= LOAD_ALIGNED(0, opacity + j * stride) > (fv)(0.0f) ? (iv)(1 << j) : (iv)(0);
    for (int reach = 1; reach < K_OFFSETS; reach *= 2)
        slots ^= slots >> reach;
    return (iv)(KEY_NONE)-slots;
}

/* Copies the opacities and the anchor of a sample to its place. */
static inline void move_sample(const size_t from, const size_t to, const size_t count,
                               const size_t stride, __global const float *opacity,
                               __global const int *visible, __global float *output,
                               __global int *sorted)
{
    for (int j = 0; j < K_OFFSETS; ++j)
        output[j * stride + to] = opacity[j * stride + from];
    if (to < count)
        sorted[to] = visible[from];
}

#endif
