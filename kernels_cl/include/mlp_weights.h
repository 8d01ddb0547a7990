/* The weight gradient of the MLPs, batch by batch and head by head. */
#ifndef CLGS_MLP_WEIGHTS_H
#define CLGS_MLP_WEIGHTS_H

#include "include/lanes.h"
#include "include/mlp_backward.h"
#include "include/mlp_layout.h"

/* Where TILE neighbouring rows of a head's weight gradient come from, among the rows of a batch,
 * and where they go to: in a part, and in the packed vector. */
typedef struct {
    int row;    /* of the gradients by sums */
    int column; /* first row of the layer's inputs */
    int inputs;
    int slots; /* that the rows belong to */
    int sums;
    int weight;
    int bias;
} Layer;

/* Rows of both layers of a head. */
inline int layer_rows(const int head)
{
    return HIDDEN_DIM + K_OFFSETS * slot_rows(head);
}

inline Layer layer_of(const int head, const int row)
{
    Layer layer;
    layer.sums = (head * HIDDEN_DIM + first_output(head) + row) / TILE * TILE_SUMS;
    if (row < HIDDEN_DIM) {
        layer.row = D_HIDDEN_ROW + row;
        layer.column = 0;
        layer.inputs = INPUT_DIM;
        layer.slots = (1 << K_OFFSETS) - 1;
        layer.weight = head_start(head) + row * INPUT_DIM;
        layer.bias = head_start(head) + HIDDEN_DIM * INPUT_DIM + row;
    } else {
        const int start = head_start(head) + HIDDEN_SIZE, outer = row - HIDDEN_DIM;
        layer.row = D_OUTPUT_ROW + outer;
        layer.column = HIDDEN_ROW;
        layer.inputs = HIDDEN_DIM;
        layer.slots = 0;
        for (int o = 0; o < TILE; ++o)
            layer.slots |= 1 << (outer + o) / slot_rows(head);
        layer.weight = start + outer * HIDDEN_DIM;
        layer.bias = start + K_OFFSETS * slot_rows(head) * HIDDEN_DIM + outer;
    }
    return layer;
}

/* COLUMNS of a layer's inputs and bias, how often. */
inline int pairs_of(const Layer *layer)
{
    return (layer->inputs + COLUMNS) / COLUMNS;
}

/* The vectors of a batch that a work-item sums over, in order. */
typedef struct {
    size_t count;
    size_t vector[BATCH / VEC];
} Steps;

#if VEC > 1
/* The first step of the sums of the lanes of a and of b: four numbers each. */
inline float8 halves(const fv a, const fv b)
{
#if VEC == 16
    const float8 c = a.lo + a.hi, d = b.lo + b.hi;
    return (float8)(c.lo, d.lo) + (float8)(c.hi, d.hi);
#elif VEC == 8
    return (float8)(a.lo, b.lo) + (float8)(a.hi, b.hi);
#else
    return (float8)(a, b);
#endif
}

/* Sums over the lanes of TILE by COLUMNS vectors, as lane_sum makes them, but of four rows at
 * once. */
inline void lane_sums(fv sum[TILE][COLUMNS], float sums[TILE * COLUMNS])
{
    int o = 0;
    for (; o + 4 <= TILE; o += 4) {
        const float8 a = halves(sum[o][0], sum[o][1]), b = halves(sum[o + 1][0], sum[o + 1][1]);
        const float8 c = halves(sum[o + 2][0], sum[o + 2][1]);
        const float8 d = halves(sum[o + 3][0], sum[o + 3][1]);
        const float8 e =
            (float8)(a.s01, b.s01, a.s45, b.s45) + (float8)(a.s23, b.s23, a.s67, b.s67);
        const float8 f =
            (float8)(c.s01, d.s01, c.s45, d.s45) + (float8)(c.s23, d.s23, c.s67, d.s67);
        const float8 four =
            (float8)(e.s02, f.s02, e.s46, f.s46) + (float8)(e.s13, f.s13, e.s57, f.s57);
        vstore4(four.lo, 0, sums + o);
        vstore4(four.hi, 0, sums + TILE + o);
    }
    for (; o < TILE; ++o)
        for (int c = 0; c < COLUMNS; ++c)
            sums[c * TILE + o] = lane_sum(sum[o][c]);
}
#else
inline void lane_sums(fv sum[TILE][COLUMNS], float sums[TILE * COLUMNS])
{
    for (int o = 0; o < TILE; ++o)
        for (int c = 0; c < COLUMNS; ++c)
            sums[c * TILE + o] = sum[o][c];
}
#endif

/* sums[c * TILE + o] = sum over the steps of row o times column c. */
inline void dot_products(__global const float *rows, __global const float *columns[COLUMNS],
                         const Steps *steps, float sums[TILE * COLUMNS])
{
    fv sum[TILE][COLUMNS] = {{(fv)(0.0f)}};
    for (size_t i = 0; i < steps->count; ++i) {
        const size_t v = steps->vector[i];
        fv lanes[COLUMNS];
#pragma unroll
        for (int c = 0; c < COLUMNS; ++c)
            lanes[c] = LOAD_ALIGNED(v, columns[c]);
#pragma unroll
        for (int o = 0; o < TILE; ++o) {
            const fv row = LOAD_ALIGNED(v, rows + o * BATCH_STRIDE);
#pragma unroll
            for (int c = 0; c < COLUMNS; ++c)
                sum[o][c] = fma(row, lanes[c], sum[o][c]);
        }
    }
    lane_sums(sum, sums);
}

/* Rows of the batch that COLUMNS columns of a layer's weights multiply; the bias' is ones. */
inline void layer_columns(const Layer *layer, const int column, __global const float *values,
                          __global const float *columns[COLUMNS])
{
    for (int c = 0; c < COLUMNS; ++c)
        columns[c] = values + (column + c < layer->inputs ? layer->column + column + c : ONES_ROW) *
                                  BATCH_STRIDE;
}

/* Samples of a batch whose gradients may differ from zero; they are its first ones. */
inline int drawing_samples(const int batch, const int padded, __global const int *active)
{
    const int first = batch * BATCH;
    const int end = SKIP_OPACITY_FIRST ? active[first / CHUNK] + first / CHUNK * CHUNK : padded;
    return clamp(end - first, 0, BATCH);
}

/* One work-item a block of the batches from first_batch on, whose rows are in `values`: one head
 * after the other. */
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
    if (first >= (size_t)padded || sample % BATCH >= drawing_samples(batch, padded, active))
        return;
    const Model model = {feature, position, visible, (size_t)count, weights, camera};
    const Outputs outputs = {output, d_output, (size_t)padded};
    const AnchorGradients d = {d_feature, d_position};
    block_backward(&model, &outputs, head, first, computed_slots(output + first, outputs.stride), 0,
                   values + (size_t)(sample / BATCH) * BATCH_SIZE + sample % BATCH, &d);
}

/* GROUP_SIZE work-items by TILE rows (dimension 0) by batch (dimension 1), PARTS batches at most:
 * each adds its weight gradient to its part, summed in a fixed order. partial: (PARTS, PART_SIZE).
 */
__kernel void mlp_backward_weights(const int padded, __global const int *active,
                                   const int first_batch, const int head,
                                   __global const float *values, __global float *partial)
{
    const int item = (int)get_local_id(0), batch = first_batch + (int)get_group_id(1);
    const int samples = drawing_samples(batch, padded, active);
    const Layer layer = layer_of(head, (int)get_group_id(0) * TILE);
    __global const float *rows = values + get_group_id(1) * BATCH_SIZE;
    Steps steps = {0, {0}};
    for (int v = item; v * VEC < samples; v += GROUP_SIZE)
        steps.vector[steps.count++] = (size_t)v;
    __local float shared[GROUP_SIZE * TILE * COLUMNS];
    __global float *part = partial + (size_t)(batch % PARTS) * PART_SIZE + layer.sums;
    for (int pair = 0; pair < pairs_of(&layer); ++pair) {
        __global const float *columns[COLUMNS];
        layer_columns(&layer, pair * COLUMNS, rows, columns);
        float sums[TILE * COLUMNS];
        dot_products(rows + layer.row * BATCH_STRIDE, columns, &steps, sums);
        for (int i = 0; i < TILE * COLUMNS; ++i)
            shared[item * TILE * COLUMNS + i] = sums[i];
        barrier(CLK_LOCAL_MEM_FENCE);
        for (int sum = item; sum < TILE * COLUMNS; sum += GROUP_SIZE) {
            float total = 0.0f;
            for (int i = 0; i < GROUP_SIZE; ++i)
                total += shared[i * TILE * COLUMNS + sum];
            part[pair * TILE * COLUMNS + sum] += total;
        }
        barrier(CLK_LOCAL_MEM_FENCE);
    }
}

/* Vectors of the blocks in which one of a layer's slots is drawn. */
inline void list_steps(const Layer *layer, const int *slots, const int blocks, Steps *steps)
{
    const bool all = !SKIP_SLOTS || layer->inputs == INPUT_DIM;
    steps->count = 0;
    for (int block = 0; block < blocks; ++block)
        for (int s = 0; s < VECTORS && (all || (slots[block] & layer->slots)); ++s)
            steps->vector[steps->count++] = (size_t)(block * VECTORS + s);
}

/* Adds the weight gradient of one batch and one head. */
inline void add_weights(__global const float *values, const int head, const int *slots,
                        const int blocks, __global float *part)
{
    for (int row = 0; row < layer_rows(head); row += TILE) {
        const Layer layer = layer_of(head, row);
        Steps steps;
        list_steps(&layer, slots, blocks, &steps);
        for (int pair = 0; pair < pairs_of(&layer); ++pair) {
            __global const float *columns[COLUMNS];
            layer_columns(&layer, pair * COLUMNS, values, columns);
            float sums[TILE * COLUMNS];
            dot_products(values + layer.row * BATCH_STRIDE, columns, &steps, sums);
#pragma unroll
            for (int i = 0; i < TILE * COLUMNS; ++i)
                part[layer.sums + pair * TILE * COLUMNS + i] += sums[i];
        }
    }
}

/* One batch, in rows of its own. */
inline void batch_backward(const Model *model, const Outputs *outputs, const int batch,
                           const int samples, __global float *values, __global float *part,
                           const AnchorGradients *d)
{
    const int blocks = (samples + BLOCK - 1) / BLOCK;
    int slots[BATCH / BLOCK + 1] = {0};
    for (int block = 0; block < blocks; ++block)
        slots[block] =
            computed_slots(outputs->output + batch * BATCH + block * BLOCK, outputs->stride);
    for (int head = 0; head < HEADS && blocks > 0; ++head) {
        for (int block = 0; block < blocks; ++block)
            block_backward(model, outputs, head, (size_t)(batch * BATCH + block * BLOCK),
                           slots[block], slots[block + 1], values + block * BLOCK, d);
        add_weights(values, head, slots, blocks, part);
    }
}

/* One work-item every global-size-th part, with a BATCH_SIZE of its own, which stays in the cache.
 * partial: (PARTS, PART_SIZE), zero before. */
__kernel void mlp_backward(__global const float *feature, __global const float *position,
                           __global const int *visible, const int count,
                           __global const float *weights, __global const float *camera,
                           const int padded, __global const float *output,
                           __global const float *d_output, __global const int *active,
                           __global float *values, __global float *partial,
                           __global float *d_feature, __global float *d_position)
{
    const Model model = {feature, position, visible, (size_t)count, weights, camera};
    const Outputs outputs = {output, d_output, (size_t)padded};
    const AnchorGradients d = {d_feature, d_position};
    for (size_t part = get_global_id(0); part < PARTS; part += get_global_size(0))
        for (int batch = (int)part; batch * BATCH < padded; batch += PARTS)
            batch_backward(&model, &outputs, batch, drawing_samples(batch, padded, active),
                           values + get_global_id(0) * BATCH_SIZE, partial + part * PART_SIZE, &d);
}

/* One work-item TILE rows of a head (dimension 0: of all heads, one behind the other) by COLUMNS
 * columns (dimension 1): their sums over the parts, in order, to their places. */
__kernel void mlp_backward_sum(__global const float *partial, const int parts,
                               __global float *d_weights)
{
    int row = (int)get_global_id(0) * TILE, head = 0;
    for (; head < HEADS - 1 && row >= layer_rows(head); ++head)
        row -= layer_rows(head);
    const Layer layer = layer_of(head, row);
    const int pair = (int)get_global_id(1);
    if (pair >= pairs_of(&layer))
        return;
    float sums[TILE * COLUMNS] = {0.0f};
    for (int part = 0; part < parts; ++part)
#pragma unroll
        for (int i = 0; i < TILE * COLUMNS; ++i)
            sums[i] += partial[(size_t)part * PART_SIZE + layer.sums + pair * TILE * COLUMNS + i];
    for (int c = 0; c < COLUMNS; ++c)
        for (int o = 0; o < TILE; ++o) {
            const int column = pair * COLUMNS + c;
            if (column < layer.inputs)
                d_weights[layer.weight + o * layer.inputs + column] = sums[c * TILE + o];
            else if (column == layer.inputs)
                d_weights[layer.bias + o] = sums[c * TILE + o];
        }
}

#endif
