/* The three decoding MLPs (opacity, color, covariance), forward: CPU form. Between the two kernels,
 * the one of order_cpu.cl puts the samples of each chunk in the order of their drawn slots.
 *
 * Work-item: a block of BLOCK samples, blocks counted from the middle one on. Its inputs, hidden
 *     values and sums are private; nothing but the outputs is kept, since the backward pass
 *     computes the hidden values again in less time than moving them through memory would take.
 * Work-group: any; no local memory.
 * Launch: padded / BLOCK work-items or more.
 */
#include "common/items.h"
#include "common/lanes.h"
#include "common/method.h"
#include "common/real.h"
#include "mlp/block/layer.h"
#include "mlp/inputs.h"
#include "mlp/layout.h"
#include "mlp/slots.h"

/* opacity: (K, padded), in the order of visible. Zero if there is no anchor, NaN if an input is not
 * finite. */
__kernel void mlp_opacity(__global const float *feature, __global const float *position,
                          __global const int *visible, const int count,
                          __global const float *weights, __global const float *camera,
                          const int padded, __global float *opacity)
{
    const size_t first = item_from_middle() * BLOCK, stride = (size_t)padded;
    if (first >= stride)
        return;
    const Inputs inputs = {feature, position, visible, (size_t)count, camera};
    if (!any_anchor(&inputs, first)) { /* padding */
        for (size_t j = 0; j < K_OFFSETS; ++j)
            for (size_t s = 0; s < VECTORS; ++s)
                STORE_ALIGNED((fv)(0.0f), s, opacity + j * stride + first);
        return;
    }
    float x[(INPUT_DIM + 1) * BLOCK], hidden[HIDDEN_DIM * BLOCK];
    gather_inputs(&inputs, first, x);
    hidden_layer(weights, x, hidden);
    size_t rows[OUTPUT_ROWS];
    const size_t used = rows_of((1 << K_OFFSETS) - 1, OPACITY, rows);
    output_layer(weights + HIDDEN_SIZE, OPACITY, hidden, rows, used, opacity + first, stride);
    for (size_t lane = 0; lane < BLOCK; ++lane) {
        if (x[INPUT_DIM * BLOCK + lane] == 1.0f)
            continue;
        for (size_t j = 0; j < K_OFFSETS; ++j)
            opacity[j * stride + first + lane] = anchor_of(&inputs, first + lane) < 0 ? 0.0f : NAN;
    }
}

/* Color and covariance rows of output (110, padded), whose opacities are there. Rows of slots that
 * no sample of the block draws are left as they are. */
__kernel void mlp_heads(__global const float *feature, __global const float *position,
                        __global const int *visible, const int count, __global const float *weights,
                        __global const float *camera, const int padded, __global float *output)
{
    const size_t first = item_from_middle() * BLOCK, stride = (size_t)padded;
    if (first >= stride)
        return;
    const Inputs inputs = {feature, position, visible, (size_t)count, camera};
    const int slots = computed_slots(output + first, stride);
    if (SKIP_OPACITY_FIRST && slots == 0)
        return;
    float x[(INPUT_DIM + 1) * BLOCK], hidden[HIDDEN_DIM * BLOCK];
    size_t rows[OUTPUT_ROWS];
    gather_inputs(&inputs, first, x);
    for (int head = COLOR; head < HEADS; ++head) {
        __global const float *weight = weights + head_start(head);
        hidden_layer(weight, x, hidden);
        output_layer(weight + HIDDEN_SIZE, head, hidden, rows, rows_of(slots, head, rows),
                     output + first_output(head) * stride + first, stride);
    }
}
