/* The backward pass of the MLPs: CPU form. Hidden values are computed again.
 *
 * Work-item: part after part of the weight gradient, until none is left. A part is made of every
 *     PARTS-th batch; the rows of a batch stay in the cache, in BATCH_SIZE floats of the work-item.
 *     A faster work-item takes more parts; which of them computes a part changes no bit of it.
 * Work-group: one work-item; no local memory.
 * Launch: a work-item per thread of the CPU, PARTS at most. backward_sum.cl adds the parts.
 */
#include "mlp/batch.h"
#include "mlp/block/backward.h"
#include "mlp/inputs.h"
#include "mlp/layout.h"
#include "mlp/block/products.h"
#include "mlp/block/runs.h"
#include "mlp/gradients.h"
#include "mlp/slots.h"
#include "mlp/weight_tile.h"

/* Whether the weight gradient is wanted; if not, `partial` is not written. */
#ifndef BY_WEIGHTS
#define BY_WEIGHTS 1
#endif

/* Vectors of samples that add something to a tile: those of the blocks that draw one of its slots.
 */
static inline Runs drawing_vectors(const WeightTile *tile, const int *slots, const int blocks)
{
    const bool all = !SKIP_SLOTS || tile->inputs == INPUT_DIM;
    Runs vectors;
    vectors.count = 0;
    for (int block = 0; block < blocks; ++block)
        if (all || (slots[block] & tile->slots))
            add_run(&vectors, block * VECTORS, (block + 1) * VECTORS);
    return vectors;
}

/* Adds the weight gradient of one batch and one head to a part. values: the rows of the batch. */
static inline void add_weights(__global const float *values, const int head, const int *slots,
                               const int blocks, __global float *part)
{
    for (int number = 0; number < head_tiles(head); ++number) {
        const WeightTile tile = weight_tile(head, number);
        const Runs vectors = drawing_vectors(&tile, slots, blocks);
        for (int step = 0; step < column_tiles(&tile); ++step) {
            __global const float *columns[COLUMNS];
            multiplied_rows(&tile, step * COLUMNS, values, columns);
            float sums[SUMS];
            dot_products(values + tile.d_row * BATCH_STRIDE, columns, &vectors, sums);
#pragma unroll
            for (int i = 0; i < SUMS; ++i)
                part[tile.sums + step * SUMS + i] += sums[i];
        }
    }
}

/* Adds the weight gradient of one batch to a part, and writes the gradients by its anchors. */
static inline void batch_backward(const Inputs *inputs, __global const float *weights,
                                  const Outputs *outputs, const int batch, const int samples,
                                  __global float *values, __global float *part,
                                  __global float *d_feature)
{
    const int blocks = (samples + BLOCK - 1) / BLOCK;
    int slots[BATCH / BLOCK + 1] = {0};
    for (int block = 0; block < blocks; ++block)
        slots[block] =
            computed_slots(outputs->output + batch * BATCH + block * BLOCK, outputs->stride);
    for (int head = 0; head < HEADS && blocks > 0; ++head) {
        for (int block = 0; block < blocks; ++block)
            block_backward(inputs, weights, outputs, head, (size_t)(batch * BATCH + block * BLOCK),
                           slots[block], slots[block + 1], values + block * BLOCK, d_feature);
        if (BY_WEIGHTS)
            add_weights(values, head, slots, blocks, part);
    }
}

/* next: how many parts are taken; partial: (parts, part_size()); both zero before. values:
 * (work-items, BATCH_SIZE). */
__kernel void mlp_backward(__global const float *feature, __global const float *position,
                           __global const int *visible, const int count,
                           __global const float *weights, __global const float *camera,
                           const int padded, __global const float *output,
                           __global const float *d_output, __global const int *active,
                           __global int *next, __global float *values, __global float *partial,
                           __global float *d_feature)
{
    const Inputs inputs = {feature, position, visible, (size_t)count, camera};
    const Outputs outputs = {output, d_output, (size_t)padded};
    for (int part = atomic_inc(next); part < PARTS; part = atomic_inc(next))
        for (int batch = part; batch * BATCH < padded; batch += PARTS)
            batch_backward(&inputs, weights, &outputs, batch, active_samples(batch, padded, active),
                           values + get_global_id(0) * BATCH_SIZE,
                           partial + (size_t)part * part_size(), d_feature);
}
