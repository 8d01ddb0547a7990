/* The backward pass through both layers of one head, for one block of samples. */
#ifndef CLGS_MLP_BLOCK_BACKWARD_H
#define CLGS_MLP_BLOCK_BACKWARD_H

#include "common/lanes.h"
#include "common/method.h"
#include "common/own_function.h"
#include "common/prefetch.h"
#include "common/real.h"
#include "common/transpose.h"
#include "mlp/batch.h"
#include "mlp/block/layer.h"
#include "mlp/block/runs.h"
#include "mlp/gradients.h"
#include "mlp/inputs.h"
#include "mlp/layout.h"

/* The same for all outputs of one head and the block at `first`: to d_sum and to the block's
 * columns of the batch. Prefetches the next block, of which the slots `next` are computed. */
static inline void output_gradients(const Outputs *outputs, const int head, const size_t first,
                                    const int slots, const int next, float *d_sum,
                                    __global float *column)
{
    const int each = slot_rows(head);
    for (int k = 0; k < K_OFFSETS * each; ++k) {
        const int j = k / each;
        const size_t row = (size_t)(first_output(head) + k);
        for (size_t i = 0; i < BLOCK && (next >> j & 1); i += LINE) {
            PREFETCH(outputs->d_output + row * outputs->stride + first + BLOCK + i);
            if (head != COVARIANCE)
                PREFETCH(outputs->output + row * outputs->stride + first + BLOCK + i);
        }
        for (int s = 0; s < VECTORS; ++s) {
            const fv d =
                slots >> j & 1 ? sum_gradient(outputs, head, j, row, first + s * VEC) : (fv)(0.0f);
            STORE_V(d, s, d_sum + k * BLOCK);
            STORE_ALIGNED(d, s, column + (D_OUTPUT_ROW(head) + k) * BATCH_STRIDE);
        }
    }
}

/* Copies `count` rows of a block from its columns of the batch. */
static inline void load_rows(__global const float *column, const int count, float *rows)
{
    for (int row = 0; row < count; ++row)
        for (int s = 0; s < VECTORS; ++s)
            STORE_V(LOAD_ALIGNED(s, column + row * BATCH_STRIDE), s, rows + row * BLOCK);
}

/* The reverse of load_rows. */
static inline void store_rows(const float *rows, const int count, __global float *column)
{
    for (int row = 0; row < count; ++row)
        for (int s = 0; s < VECTORS; ++s)
            STORE_ALIGNED(LOAD_V(s, rows + row * BLOCK), s, column + row * BATCH_STRIDE);
}

/* dL/d(sums of the hidden layer) of a block from d_sum, those of the output layer: to d_hidden and
 * to the block's columns of the batch. */
static inline void hidden_backward(__global const float *weight, const int head, const int slots,
                                   const float *hidden, const float *d_sum, float *d_hidden,
                                   __global float *column)
{
    const int each = slot_rows(head);
    Runs rows;
    rows.count = 0;
    for (int j = 0; j < K_OFFSETS; ++j)
        if (slots >> j & 1)
            add_run(&rows, j * each, (j + 1) * each);
    for (int unit = 0; unit < HIDDEN_DIM; unit += TILE) {
        fv sum[TILE][VECTORS] = {{(fv)(0.0f)}};
        for (int run = 0; run < rows.count; ++run)
            add_columns(sum, weight + HIDDEN_SIZE + unit, HIDDEN_DIM, (size_t)rows.begin[run],
                        (size_t)rows.end[run], d_sum);
#pragma unroll
        for (int o = 0; o < TILE; ++o)
#pragma unroll
            for (int s = 0; s < VECTORS; ++s) {
                const fv active = LOAD_V(s, hidden + (unit + o) * BLOCK);
                const fv d = active > (fv)(0.0f) ? sum[o][s] : (fv)(0.0f);
                STORE_V(d, s, d_hidden + (unit + o) * BLOCK);
                STORE_ALIGNED(d, s, column + (D_HIDDEN_ROW(head) + unit + o) * BATCH_STRIDE);
            }
    }
}

/* Adds one head's dL/d(feature) to the block's columns of the batch; the first head sets them. */
static inline void input_backward(__global const float *weight, const int head,
                                  const float *d_hidden, __global float *column)
{
    for (int k = 0; k < FEATURE_DIM; k += TILE) {
        __global float *d_input = column + (D_INPUT_ROW + k) * BATCH_STRIDE;
        fv sum[TILE][VECTORS];
#pragma unroll
        for (int o = 0; o < TILE; ++o)
#pragma unroll
            for (int s = 0; s < VECTORS; ++s)
                sum[o][s] = head == 0 ? (fv)(0.0f) : LOAD_ALIGNED(s, d_input + o * BATCH_STRIDE);
        add_columns(sum, weight + k, INPUT_DIM, 0, HIDDEN_DIM, d_hidden);
#pragma unroll
        for (int o = 0; o < TILE; ++o)
#pragma unroll
            for (int s = 0; s < VECTORS; ++s)
                STORE_ALIGNED(sum[o][s], s, d_input + o * BATCH_STRIDE);
    }
}

/* Writes the gradients by the features of the block's anchors, from its columns of the batch. */
static inline void anchors_backward(const Inputs *inputs, const size_t first,
                                    __global const float *column, __global float *d_feature)
{
    __global const float *d_input = column + D_INPUT_ROW * BATCH_STRIDE;
    for (size_t s = 0; s < VECTORS; ++s) {
        __global float *rows[VEC];
        for (size_t lane = 0; lane < VEC; ++lane) {
            const int anchor = anchor_of(inputs, first + s * VEC + lane);
            rows[lane] = anchor < 0 ? 0 : d_feature + (size_t)anchor * FEATURE_DIM;
        }
        size_t k = 0;
        for (; k + 4 <= FEATURE_DIM; k += 4) {
            fv four[4];
#pragma unroll
            for (size_t i = 0; i < 4; ++i)
                four[i] = LOAD_ALIGNED(s, d_input + (k + i) * BATCH_STRIDE);
            scatter_4(four, rows, k);
        }
        for (; k < FEATURE_DIM; ++k)
            for (size_t lane = 0; lane < VEC; ++lane)
                if (rows[lane])
                    rows[lane][k] = d_input[k * BATCH_STRIDE + s * VEC + lane];
    }
}

/* Both layers of one head for the block at sample `first`, whose columns of the batch get what the
 * weight gradient needs. slots, next: the slots that are computed for this block and for the next
 * one. Call it for the heads in order: the first one gathers the inputs, the last one writes the
 * gradients by them. */
static inline OWN_FUNCTION void block_backward(const Inputs *inputs, __global const float *weights,
                                               const Outputs *outputs, const int head,
                                               const size_t first, const int slots, const int next,
                                               __global float *column, __global float *d_feature)
{
    __global const float *weight = weights + head_start(head);
    float x[(INPUT_DIM + 1) * BLOCK], hidden[HIDDEN_DIM * BLOCK], d_hidden[HIDDEN_DIM * BLOCK];
    float d_sum[7 * K_OFFSETS * BLOCK];
    if (head == 0) {
        gather_inputs(inputs, first, x);
        store_rows(x, INPUT_DIM + 1, column);
    } else {
        load_rows(column, INPUT_DIM, x);
    }
    for (int unit = 0; unit < HIDDEN_DIM; unit += TILE) {
        hidden_units(weight, unit, x, hidden);
        store_rows(hidden + unit * BLOCK, TILE, column + (HIDDEN_ROW(head) + unit) * BATCH_STRIDE);
    }
    output_gradients(outputs, head, first, slots, next, d_sum, column);
    hidden_backward(weight, head, slots, hidden, d_sum, d_hidden, column);
    input_backward(weight, head, d_hidden, column);
    if (head == HEADS - 1)
        anchors_backward(inputs, first, column, d_feature);
}

#endif
