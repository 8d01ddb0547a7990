/* The backward pass of the MLPs: GPU form. Hidden values are computed again. For the batches from
 * first_batch on, at most PARTS of them, and for one head after the other, the first kernel fills
 * the rows of the batches, and the second makes the weight gradient of them.
 *
 * mlp_backward_layers
 *     Work-item: a block of samples. Work-group: any; no local memory.
 *     Launch: BATCH work-items per batch.
 * mlp_backward_weights
 *     Work-item: every GROUP_SIZE-th vector of a batch, for WEIGHT_ROWS rows of the head's
 * gradient. Work-group: GROUP_SIZE work-items, whose sums are added in local memory in a fixed
 * order. Launch: a work-group per tile of rows (dimension 0) and batch (dimension 1).
 *
 * backward_sum.cl adds the parts.
 */
#include "common/real.h"
#include "mlp/batch.h"
#include "mlp/block_backward.h"
#include "mlp/inputs.h"
#include "mlp/layout.h"
#include "mlp/runs.h"
#include "mlp/slots.h"
#include "mlp/weight_tile.h"

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
    const Runs vectors = {1, {item}, {(samples + VEC - 1) / VEC}};
    __local float shared[GROUP_SIZE * SUMS];
    __global float *part = partial + (size_t)(batch % PARTS) * part_size() + tile.sums;
    for (int step = 0; step < column_tiles(&tile); ++step) {
        __global const float *columns[COLUMNS];
        multiplied_rows(&tile, step * COLUMNS, rows, columns);
        float sums[SUMS];
        dot_products(rows + tile.d_row * BATCH_STRIDE, columns, &vectors, sums);
        for (int i = 0; i < SUMS; ++i)
            shared[item * SUMS + i] = sums[i];
        barrier(CLK_LOCAL_MEM_FENCE);
        for (int sum = item; sum < SUMS; sum += GROUP_SIZE) {
            float total = 0.0f;
            for (int i = 0; i < GROUP_SIZE; ++i)
                total += shared[i * SUMS + sum];
            part[step * SUMS + sum] += total;
        }
        barrier(CLK_LOCAL_MEM_FENCE);
    }
}
