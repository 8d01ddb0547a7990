/* Color and covariance heads and neural Gaussians at once, for pictures without gradients: what the
 * stages mlp and neural do, but on a CPU the heads' outputs never leave its cache.
 */
#include "include/anchors.h"
#include "include/real.h"

#if VEC == 1
#define OUTPUT_SPACE __global
#else
#define OUTPUT_SPACE __private
#endif
#include "include/gaussians.h"
#include "include/mlp_dense.h"
#include "include/mlp_layout.h"
#include "include/mlp_output.h"

/* One work-item a block of samples. output: (110, padded), of which the opacities are there; the
 * Gaussians of sample v go to numbers[v] and on, for each bit of bits[v]. */
__kernel void decode_forward(__global const float *feature, __global const float *position,
                             __global const int *visible, const int count,
                             __global const float *weights, __global const float *camera,
                             const int padded, __global const float *offset,
                             __global const float *scaling, __global const int *numbers,
                             __global const int *bits, const int capacity, __global float *output,
                             __global float *mean, __global float *scale, __global float *rotation,
                             __global float *color, __global float *opacity, __global int *slot)
{
    const size_t first = get_global_id(0) * BLOCK, stride = (size_t)padded;
    if (first >= (size_t)count)
        return;
    const int slots = computed_slots(output + first, stride);
    if (SKIP_OPACITY_FIRST && slots == 0)
        return;
#if VEC == 1
    __global float *rows = output + first;
    const size_t rows_stride = stride;
#else
    fv lanes[OUTPUT_ROWS * VECTORS];
    float *rows = (float *)lanes;
    const size_t rows_stride = BLOCK;
    for (int j = 0; j < K_OFFSETS; ++j)
        for (int s = 0; s < VECTORS; ++s)
            lanes[j * VECTORS + s] = LOAD_ALIGNED(s, output + j * stride + first);
#endif
    const Model model = {feature, position, visible, (size_t)count, weights, camera};
    float x[(INPUT_DIM + 1) * BLOCK], hidden[HIDDEN_DIM * BLOCK];
    size_t listed[OUTPUT_ROWS];
    gather(&model, first, x);
    for (int head = COLOR; head < HEADS; ++head) {
        __global const float *weight = weights + head_start(head);
        hidden_layer(weight, x, hidden);
        output_layer(weight + HIDDEN_SIZE, head, hidden, listed, rows_of(slots, head, listed),
                     rows + first_output(head) * rows_stride, rows_stride);
    }
    const Parameters parameters = {visible, (size_t)count, position, offset, scaling};
    const Gaussians gaussians = {mean, scale, rotation, color, opacity, slot};
    for (size_t s = 0; s < VECTORS; ++s) {
        const size_t v = first + s * VEC;
        const Drawn drawn = list_drawn(bits, numbers, v, (size_t)count, (size_t)capacity);
        if (drawn.count != 0)
            write_gaussians(&parameters, &drawn, v, rows + s * VEC, rows_stride, &gaussians);
    }
}
