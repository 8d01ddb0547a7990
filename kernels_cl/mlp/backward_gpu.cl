/* The backward pass of the MLPs: GPU form. Hidden values are computed again. For the batches from
 * first_batch on, at most PARTS of them, the first kernel fills the rows of the batches, the second
 * makes the gradients by the inputs of them, and the third the weight gradient.
 *
 * mlp_backward_layers, mlp_backward_inputs
 *     Work-item: some units of each layer for a quad of samples, see group/layer.h. It keeps the
 *         sums of one layer at a time: one kernel for both would need more registers than the GPUs
 *         of AMD and Intel have.
 *     Work-group: SAMPLES samples, LAYER_ITEMS work-items; inputs, gradients by hidden values and a
 *         slice of the weights lie in local memory.
 *     Launch: a work-group per SAMPLES samples (dimension 0); of the first kernel also per
 *         HEADS_PER_GROUP heads (dimension 1).
 * mlp_backward_weights
 *     Work-item: every SUM_LANES-th sample of a batch, for WEIGHT_ROWS rows of a layer's gradient
 *         by every STEPS-th COLUMNS of the inputs.
 *     Work-group: GROUP_SIZE work-items; the sums of SUM_LANES of them are added in local memory.
 *     Launch: a work-group per tile of rows of all heads (dimension 0) and batch (dimension 1).
 *
 * backward_sum.cl adds the parts.
 */
#include "common/form.h"
#include "common/lanes.h"
#include "common/method.h"
#include "mlp/batch.h"
#include "mlp/gradients.h"
#include "mlp/group/inputs.h"
#include "mlp/group/layer.h"
#include "mlp/inputs.h"
#include "mlp/layout.h"
#include "mlp/weight_tile.h"

/* Heads that a work-group of the first kernel computes, one after the other: 1 or HEADS. */
#ifndef HEADS_PER_GROUP
#define HEADS_PER_GROUP 3
#endif

/* Column tiles that a work-group sums at the same time. */
#define STEPS (GROUP_SIZE / SUM_LANES)
#define WEIGHT_GROUP GROUP_OF(GROUP_SIZE)

/* A group's samples, and its local memory: `rows` and `slice` as for the forward pass. */
typedef struct {
    size_t first;
    int samples; /* that may have gradients other than zero; they are its first ones */
    int slots;   /* that they draw, one per bit */
    __local float *x;
    __local float *d_sums;
    __local float *slice;
    __local int *rows;
} Group;

/* Writes a work-item's quads of `count` rows to the group's columns of a batch. */
static inline CONSTANT_UNITS void store_columns(float (*quads)[4], const int units, const int count,
                                                __global float *columns)
{
#pragma unroll
    for (int u = 0; u < units; ++u)
        if (unit_of(units, u) < count)
            *(__global float4 *)(columns + unit_of(units, u) * BATCH_STRIDE + 4 * own_quad()) =
                whole_quad(quads[u]);
}

/* dL/d(sums of the output layer) of the listed rows to `to`, rows of ROW_PITCH, and to the batch.
 */
static inline void load_gradients(const Outputs *outputs, const int head, const Group *group,
                                  const int begin, const int some, __local float *to,
                                  __global float *columns)
{
    const int each = slot_rows(head);
    for (int i = (int)get_local_id(0); i < some * SAMPLES; i += LAYER_ITEMS) {
        const int sample = i % SAMPLES, row = group->rows[begin + i / SAMPLES];
        const float d = sample < group->samples ? sum_gradient(outputs, head, row / each,
                                                               (size_t)(first_output(head) + row),
                                                               group->first + (size_t)sample)
                                                : 0.0f;
        to[i / SAMPLES * ROW_PITCH + sample] = d;
        columns[(D_OUTPUT_ROW(head) + row) * BATCH_STRIDE + sample] = d;
    }
}

/* Zero to the rows of the batch that belong to slots which no sample of the group draws. */
static inline void clear_gradients(const int head, const int slots, __global float *columns)
{
    const int each = slot_rows(head);
    for (int i = (int)get_local_id(0); i < K_OFFSETS * each * SAMPLES; i += LAYER_ITEMS) {
        const int sample = i % SAMPLES, row = i / SAMPLES;
        if ((slots >> row / each & 1) == 0)
            columns[(D_OUTPUT_ROW(head) + row) * BATCH_STRIDE + sample] = 0.0f;
    }
}

/* Both layers of one head: writes the rows of the batch. */
static inline CONSTANT_UNITS void head_backward(__global const float *weight,
                                                const Outputs *outputs, const int head,
                                                const Group *group, __global float *columns)
{
    float sum[UNITS(HIDDEN_DIM)][4];
    hidden_quads(weight, group->x, group->slice, sum);
    store_columns(sum, UNITS(HIDDEN_DIM), HIDDEN_DIM, columns + HIDDEN_ROW(head) * BATCH_STRIDE);
#pragma unroll
    for (int u = 0; u < UNITS(HIDDEN_DIM); ++u) {
        fill_quad(sum[u], 0.0f);
    }
    const int count = list_rows(group->slots, head, group->rows);
    clear_gradients(head, group->slots, columns);
    for (int begin = 0; begin < count; begin += HIDDEN_DIM) {
        const int some = min(HIDDEN_DIM, count - begin);
        const LayerWeights back = {weight + HIDDEN_SIZE, HIDDEN_DIM, 1,
                                   HIDDEN_DIM,           0,          group->rows + begin};
        barrier(CLK_LOCAL_MEM_FENCE);
        load_gradients(outputs, head, group, begin, some, group->d_sums, columns);
        add_layer(sum, UNITS(HIDDEN_DIM), &back, group->d_sums, some, group->slice);
    }
#pragma unroll
    for (int u = 0; u < UNITS(HIDDEN_DIM); ++u) { /* registers are too few to keep hidden values */
        const int row = HIDDEN_ROW(head) + min(unit_of(UNITS(HIDDEN_DIM), u), HIDDEN_DIM - 1);
        const float4 hidden =
            *(__global const float4 *)(columns + row * BATCH_STRIDE + 4 * own_quad());
#pragma unroll
        for (int i = 0; i < 4; ++i)
            sum[u][i] = NUMBER(hidden, i) > 0.0f ? sum[u][i] : 0.0f;
    }
    store_columns(sum, UNITS(HIDDEN_DIM), HIDDEN_DIM, columns + D_HIDDEN_ROW(head) * BATCH_STRIDE);
}

/* values: (batches, BATCH_SIZE). */
LAYER_GROUP __kernel void
mlp_backward_layers(__global const float *feature, __global const float *position,
                    __global const int *visible, const int count, __global const float *weights,
                    __global const float *camera, const int padded, __global float *output,
                    __global const float *d_output, __global const int *active,
                    const int first_batch, __global float *values)
{
    __local float x[(INPUT_DIM + 1) * ROW_PITCH] __attribute__((aligned(16)));
    __local float d_sums[HIDDEN_DIM * ROW_PITCH] __attribute__((aligned(16)));
    __local float slice[SLICE_SIZE] __attribute__((aligned(16)));
    __local int rows[7 * K_OFFSETS], shared;
    const int sample = (int)get_group_id(0) * SAMPLES, batch = first_batch + sample / BATCH;
    const size_t first = (size_t)first_batch * BATCH + (size_t)sample;
    const int samples = min(active_samples(batch, padded, active) - sample % BATCH, SAMPLES);
    if (samples <= 0)
        return;
    const Inputs inputs = {feature, position, visible, (size_t)count, camera};
    const Outputs outputs = {output, d_output, (size_t)padded};
    const int slots = group_slots(output, first, first + (size_t)samples, outputs.stride, &shared);
    const Group group = {first, samples, slots, x, d_sums, slice, rows};
    __global float *columns = values + (size_t)(sample / BATCH) * BATCH_SIZE + sample % BATCH;
    gather_rows(&inputs, first, x);
    for (int i = (int)get_local_id(0); get_group_id(1) == 0 && i < (INPUT_DIM + 1) * SAMPLES;
         i += LAYER_ITEMS) {
        const float value = x[i / SAMPLES * ROW_PITCH + i % SAMPLES];
        const bool counts = i / SAMPLES < INPUT_DIM || value == 1.0f;
        columns[i / SAMPLES * BATCH_STRIDE + i % SAMPLES] = counts ? value : 0.0f;
    }
#if HEADS_PER_GROUP == 1 /* no loop: Intel's compiler would keep more in registers */
    const int head = (int)get_group_id(1);
#else
    for (int head = 0; head < HEADS; ++head)
#endif
    head_backward(weights + head_start(head), &outputs, head, &group, columns);
}

/* Gradients by the features, from the gradients by hidden values in `values`. */
LAYER_GROUP __kernel void mlp_backward_inputs(__global const int *visible, const int count,
                                              __global const float *weights, const int padded,
                                              __global const int *active, const int first_batch,
                                              __global const float *values,
                                              __global float *d_feature)
{
    __local float d_rows[(INPUT_DIM + 1) * ROW_PITCH] __attribute__((aligned(16)));
    __local float slice[SLICE_SIZE] __attribute__((aligned(16)));
    const int sample = (int)get_group_id(0) * SAMPLES, batch = first_batch + sample / BATCH;
    const size_t first = (size_t)first_batch * BATCH + (size_t)sample;
    const int samples = min(active_samples(batch, padded, active) - sample % BATCH, SAMPLES);
    if (samples <= 0)
        return;
    const int item = (int)get_local_id(0);
    __global const float *columns = values + (size_t)(sample / BATCH) * BATCH_SIZE + sample % BATCH;
    float d_x[UNITS(FEATURE_DIM)][4]; /* unrolled by a pragma, PoCL's kernel takes twice as long */
    for (int u = 0; u < UNITS(FEATURE_DIM); ++u)
        fill_quad(d_x[u], 0.0f);
    for (int head = 0; head < HEADS; ++head) {
        const LayerWeights back = {weights + head_start(head), FEATURE_DIM, 1, INPUT_DIM, 0, 0};
        barrier(CLK_LOCAL_MEM_FENCE);
        for (int i = item; i < HIDDEN_DIM * SAMPLES; i += LAYER_ITEMS)
            d_rows[i / SAMPLES * ROW_PITCH + i % SAMPLES] =
                columns[(D_HIDDEN_ROW(head) + i / SAMPLES) * BATCH_STRIDE + i % SAMPLES];
        add_layer(d_x, UNITS(FEATURE_DIM), &back, d_rows, HIDDEN_DIM, slice);
    }
    barrier(CLK_LOCAL_MEM_FENCE);
    store_quads(d_x, UNITS(FEATURE_DIM), FEATURE_DIM, d_rows);
    barrier(CLK_LOCAL_MEM_FENCE);
    const Inputs inputs = {0, 0, visible, (size_t)count, 0};
    for (int i = item; i < samples * FEATURE_DIM; i += LAYER_ITEMS) {
        const int anchor = anchor_of(&inputs, first + (size_t)(i / FEATURE_DIM));
        if (anchor >= 0)
            d_feature[(size_t)anchor * FEATURE_DIM + (size_t)(i % FEATURE_DIM)] =
                d_rows[i % FEATURE_DIM * ROW_PITCH + i / FEATURE_DIM];
    }
}

/* Adds the gradient of a batch to its part of partial (parts, part_size()). */
WEIGHT_GROUP __kernel void mlp_backward_weights(const int padded, __global const int *active,
                                                const int first_batch, __global const float *values,
                                                __global float *partial)
{
    int number = (int)get_group_id(0), head = 0;
    for (; head < HEADS - 1 && number >= head_tiles(head); ++head)
        number -= head_tiles(head);
    const int item = (int)get_local_id(0), batch = first_batch + (int)get_group_id(1);
    const int samples = active_samples(batch, padded, active);
    const WeightTile tile = weight_tile(head, number);
    __global const float *rows = values + get_group_id(1) * BATCH_SIZE;
    __global const float *d_rows = rows + tile.d_row * BATCH_STRIDE;
    const int lane = item % SUM_LANES, own_step = item / SUM_LANES;
    __local float shared[STEPS * SUMS * LANES_PITCH];
    __local float *own = shared + own_step * SUMS * LANES_PITCH + lane;
    __global float *part = partial + (size_t)(batch % PARTS) * part_size() + tile.sums;
    for (int first = 0; first < column_tiles(&tile); first += STEPS) {
        __global const float *columns[COLUMNS];
        multiplied_rows(&tile, min(first + own_step, column_tiles(&tile) - 1) * COLUMNS, rows,
                        columns);
        float sum[WEIGHT_ROWS][COLUMNS];
#pragma unroll
        for (int o = 0; o < WEIGHT_ROWS; ++o)
#pragma unroll
            for (int c = 0; c < COLUMNS; ++c)
                sum[o][c] = 0.0f;
        for (int v = lane; v < samples; v += SUM_LANES) {
            float input[COLUMNS];
#pragma unroll
            for (int c = 0; c < COLUMNS; ++c)
                input[c] = columns[c][v];
#pragma unroll
            for (int o = 0; o < WEIGHT_ROWS; ++o) {
                const float d = d_rows[o * BATCH_STRIDE + v];
#pragma unroll
                for (int c = 0; c < COLUMNS; ++c)
                    sum[o][c] = fma(d, input[c], sum[o][c]);
            }
        }
#pragma unroll
        for (int c = 0; c < COLUMNS; ++c)
#pragma unroll
            for (int o = 0; o < WEIGHT_ROWS; ++o)
                own[(c * WEIGHT_ROWS + o) * LANES_PITCH] = sum[o][c];
        barrier(CLK_LOCAL_MEM_FENCE);
        const int steps = min(column_tiles(&tile) - first, STEPS);
        for (int i = item; i < steps * SUMS; i += GROUP_SIZE)
            part[first * SUMS + i] += lane_tree(shared + i * LANES_PITCH);
        barrier(CLK_LOCAL_MEM_FENCE);
    }
}
