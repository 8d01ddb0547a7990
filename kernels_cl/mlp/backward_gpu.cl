/* The backward pass of the MLPs: GPU form. Hidden values are computed again. For the batches from
 * first_batch on, at most PARTS of them, and for one head after the other, the first kernel fills
 * the rows of the batches, and the second makes the weight gradient of them.
 *
 * mlp_backward_layers
 *     Work-item: a block of samples. Work-group: any; no local memory.
 *     Launch: BATCH work-items per batch.
 * mlp_backward_weights
 *     Work-item: every SUM_LANES-th sample of a batch, for WEIGHT_ROWS rows of the head's gradient
 *         by every STEPS-th COLUMNS of the inputs.
 *     Work-group: GROUP_SIZE work-items; the sums of SUM_LANES of them are added in local memory.
 *     Launch: a work-group per tile of rows (dimension 0) and batch (dimension 1).
 *
 * backward_sum.cl adds the parts.
 */
#include "common/lanes.h"
#include "mlp/batch.h"
#include "mlp/block_backward.h"
#include "mlp/inputs.h"
#include "mlp/layout.h"
#include "mlp/runs.h"
#include "mlp/slots.h"
#include "mlp/weight_tile.h"

/* Column tiles that a work-group sums at the same time. */
#define STEPS (GROUP_SIZE / SUM_LANES)

/* values: (batches, BATCH_SIZE). */
__kernel void mlp_backward_layers(__global const float *feature, __global const float *position,
                                  __global const int *visible, const int count,
                                  __global const float *weights, __global const float *camera,
                                  const int padded, __global const float *output,
                                  __global const float *d_output, __global const int *active,
                                  const int first_batch, const int head, __global float *values,
                                  __global float *d_feature, __global float *d_position)
{
    const int sample = (int)get_global_id(0) * BLOCK, batch = first_batch + sample / BATCH;
    const size_t first = (size_t)first_batch * BATCH + (size_t)sample;
    if (first >= (size_t)padded || sample % BATCH >= active_samples(batch, padded, active))
        return;
    const Inputs inputs = {feature, position, visible, (size_t)count, camera};
    const Outputs outputs = {output, d_output, (size_t)padded};
    const AnchorGradients d = {d_feature, d_position};
    block_backward(&inputs, weights, &outputs, head, first,
                   computed_slots(output + first, outputs.stride), 0,
                   values + (size_t)(sample / BATCH) * BATCH_SIZE + sample % BATCH, &d);
}

/* Adds the gradient of a batch to its part of partial (parts, part_size()). */
__kernel void mlp_backward_weights(const int padded, __global const int *active,
                                   const int first_batch, const int head,
                                   __global const float *values, __global float *partial)
{
    const int item = (int)get_local_id(0), batch = first_batch + (int)get_group_id(1);
    const int samples = active_samples(batch, padded, active);
    const WeightTile tile = weight_tile(head, (int)get_group_id(0));
    __global const float *rows = values + get_group_id(1) * BATCH_SIZE;
    const int lane = item % SUM_LANES, own_step = item / SUM_LANES;
    const Runs lanes = {1, {lane}, {samples}};
    __local float shared[STEPS * SUMS * LANES_PITCH];
    __global float *part = partial + (size_t)(batch % PARTS) * part_size() + tile.sums;
    for (int first = 0; first < column_tiles(&tile); first += STEPS) {
        __global const float *columns[COLUMNS];
        multiplied_rows(&tile, min(first + own_step, column_tiles(&tile) - 1) * COLUMNS, rows,
                        columns);
        float sums[SUMS];
        dot_products(rows + tile.d_row * BATCH_STRIDE, columns, &lanes, sums);
        for (int i = 0; i < SUMS; ++i)
            shared[(own_step * SUMS + i) * LANES_PITCH + lane] = sums[i];
        barrier(CLK_LOCAL_MEM_FENCE);
        const int steps = min(column_tiles(&tile) - first, STEPS);
        for (int sum = item; sum < steps * SUMS; sum += GROUP_SIZE)
            part[first * SUMS + sum] += lane_tree(shared + sum * LANES_PITCH);
        barrier(CLK_LOCAL_MEM_FENCE);
    }
}
