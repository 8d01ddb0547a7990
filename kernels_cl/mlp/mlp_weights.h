/* The weight gradient of the MLPs, batch by batch and head by head. */
#ifndef CLGS_MLP_WEIGHTS_H
#define CLGS_MLP_WEIGHTS_H

#include "common/lanes.h"
#include "mlp/mlp_backward.h"
#include "mlp/mlp_layout.h"

/* Where WEIGHT_ROWS neighbouring rows of a head's weight gradient come from, among the rows of a
 * batch, and where they go to: in a part, and in the packed vector. */
typedef struct {
    int row;    /* of the gradients by sums */
    int column; /* first row of the layer's inputs */
    int inputs;
    int slots;    /* that the rows belong to */
    int repeated; /* rows that the tile before has as well */
    int sums;
    int weight;
    int bias;
} Layer;

/* Tile number `tile` of a head's layers. */
static inline Layer layer_of(const int head, const int tile)
{
    const bool inner = tile < TILES_OF(HIDDEN_DIM);
    const int rows = inner ? HIDDEN_DIM : K_OFFSETS * slot_rows(head);
    const int next = (inner ? tile : tile - TILES_OF(HIDDEN_DIM)) * WEIGHT_ROWS;
    const int first = min(next, rows - WEIGHT_ROWS);
    const int start = head_start(head) + (inner ? 0 : HIDDEN_SIZE);
    Layer layer;
    layer.row = (inner ? D_HIDDEN_ROW : D_OUTPUT_ROW) + first;
    layer.column = inner ? 0 : HIDDEN_ROW;
    layer.inputs = inner ? INPUT_DIM : HIDDEN_DIM;
    layer.slots = inner ? (1 << K_OFFSETS) - 1 : 0;
    for (int o = 0; o < WEIGHT_ROWS && !inner; ++o)
        layer.slots |= 1 << (first + o) / slot_rows(head);
    layer.repeated = next - first;
    layer.sums = (tiles_before(head) + tile) * TILE_SUMS;
    layer.weight = start + first * layer.inputs;
    layer.bias = start + rows * layer.inputs + first;
    return layer;
}

/* COLUMNS of a layer's inputs and bias, how often. */
static inline int column_tiles(const Layer *layer)
{
    return (layer->inputs + COLUMNS) / COLUMNS;
}

/* A CPU's compiler keeps all the sums in registers in a function of its own only. */
#if USE_LOCAL
#define APART static inline
#else
#define APART static __attribute__((noinline))
#endif

/* sum[o][c] += row o times column c, of every GROUP_SIZE-th vector of [begin, end). */
APART void add_products(__global const float *rows, __global const float *columns[COLUMNS],
                        const size_t begin, const size_t end, fv sum[WEIGHT_ROWS][COLUMNS])
{
    fv own[WEIGHT_ROWS][COLUMNS];
#pragma unroll
    for (int o = 0; o < WEIGHT_ROWS; ++o)
#pragma unroll
        for (int c = 0; c < COLUMNS; ++c)
            own[o][c] = sum[o][c];
    for (size_t v = begin; v < end; v += GROUP_SIZE) {
        fv lanes[COLUMNS];
#pragma unroll
        for (int c = 0; c < COLUMNS; ++c)
            lanes[c] = LOAD_ALIGNED(v, columns[c]);
#pragma unroll
        for (int o = 0; o < WEIGHT_ROWS; ++o) {
            const fv row = LOAD_ALIGNED(v, rows + o * BATCH_STRIDE);
#pragma unroll
            for (int c = 0; c < COLUMNS; ++c)
                own[o][c] = fma(row, lanes[c], own[o][c]);
        }
    }
#pragma unroll
    for (int o = 0; o < WEIGHT_ROWS; ++o)
#pragma unroll
        for (int c = 0; c < COLUMNS; ++c)
            sum[o][c] = own[o][c];
}

/* sums[c * WEIGHT_ROWS + o] = sum over row o times column c, of every GROUP_SIZE-th vector of the
 * runs. */
static inline void dot_products(__global const float *rows, __global const float *columns[COLUMNS],
                                const Runs *runs, float sums[SUMS])
{
    fv sum[WEIGHT_ROWS][COLUMNS] = {{(fv)(0.0f)}};
    for (int run = 0; run < runs->count; ++run)
        add_products(rows, columns, (size_t)runs->begin[run], (size_t)runs->end[run], sum);
    for (int c = 0; c < COLUMNS; ++c) {
        float *column = sums + c * WEIGHT_ROWS;
        int o = 0;
        for (; o + 4 <= WEIGHT_ROWS; o += 4)
            vstore4(lane_sums(sum[o][c], sum[o + 1][c], sum[o + 2][c], sum[o + 3][c]), 0,
                    column + o);
        for (; o < WEIGHT_ROWS; ++o)
            column[o] = lane_sum(sum[o][c]);
    }
}

/* Rows of the batch that COLUMNS columns of a layer's weights multiply; the bias' is ones. */
static inline void layer_columns(const Layer *layer, const int column, __global const float *values,
                                 __global const float *columns[COLUMNS])
{
    for (int c = 0; c < COLUMNS; ++c)
        columns[c] = values + (column + c < layer->inputs ? layer->column + column + c : ONES_ROW) *
                                  BATCH_STRIDE;
}

/* Samples of a batch whose gradients may differ from zero; they are its first ones. */
static inline int drawing_samples(const int batch, const int padded, __global const int *active)
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

/* GROUP_SIZE work-items by WEIGHT_ROWS rows (dimension 0) by batch (dimension 1), PARTS batches at
 * most: each adds its weight gradient to its part, summed in a fixed order. partial: (parts,
 * part_size()). */
__kernel void mlp_backward_weights(const int padded, __global const int *active,
                                   const int first_batch, const int head,
                                   __global const float *values, __global float *partial)
{
    const int item = (int)get_local_id(0), batch = first_batch + (int)get_group_id(1);
    const int samples = drawing_samples(batch, padded, active);
    const Layer layer = layer_of(head, (int)get_group_id(0));
    __global const float *rows = values + get_group_id(1) * BATCH_SIZE;
    const Runs vectors = {1, {item}, {(samples + VEC - 1) / VEC}};
    __local float shared[GROUP_SIZE * SUMS];
    __global float *part = partial + (size_t)(batch % PARTS) * part_size() + layer.sums;
    for (int tile = 0; tile < column_tiles(&layer); ++tile) {
        __global const float *columns[COLUMNS];
        layer_columns(&layer, tile * COLUMNS, rows, columns);
        float sums[SUMS];
        dot_products(rows + layer.row * BATCH_STRIDE, columns, &vectors, sums);
        for (int i = 0; i < SUMS; ++i)
            shared[item * SUMS + i] = sums[i];
        barrier(CLK_LOCAL_MEM_FENCE);
        for (int sum = item; sum < SUMS; sum += GROUP_SIZE) {
            float total = 0.0f;
            for (int i = 0; i < GROUP_SIZE; ++i)
                total += shared[i * SUMS + sum];
            part[tile * SUMS + sum] += total;
        }
        barrier(CLK_LOCAL_MEM_FENCE);
    }
}

/* Vectors of the blocks in which one of a layer's slots is drawn. */
static inline Runs drawing_vectors(const Layer *layer, const int *slots, const int blocks)
{
    const bool all = !SKIP_SLOTS || layer->inputs == INPUT_DIM;
    Runs vectors;
    vectors.count = 0;
    for (int block = 0; block < blocks; ++block)
        if (all || (slots[block] & layer->slots))
            add_run(&vectors, block * VECTORS, (block + 1) * VECTORS);
    return vectors;
}

/* Adds the weight gradient of one batch and one head. */
static inline void add_weights(__global const float *values, const int head, const int *slots,
                               const int blocks, __global float *part)
{
    for (int row_tile = 0; row_tile < head_tiles(head); ++row_tile) {
        const Layer layer = layer_of(head, row_tile);
        const Runs vectors = drawing_vectors(&layer, slots, blocks);
        for (int tile = 0; tile < column_tiles(&layer); ++tile) {
            __global const float *columns[COLUMNS];
            layer_columns(&layer, tile * COLUMNS, values, columns);
            float sums[SUMS];
            dot_products(values + layer.row * BATCH_STRIDE, columns, &vectors, sums);
#pragma unroll
            for (int i = 0; i < SUMS; ++i)
                part[layer.sums + tile * SUMS + i] += sums[i];
        }
    }
}

/* One batch, in rows of its own. */
static inline void batch_backward(const Model *model, const Outputs *outputs, const int batch,
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

/* Work-items take part after part until none is left, each with a BATCH_SIZE of its own, which
 * stays in the cache: whoever is faster takes more, and a part is the same whoever takes it. next:
 * how many are taken; partial: (parts, part_size()); both zero before. */
__kernel void mlp_backward(__global const float *feature, __global const float *position,
                           __global const int *visible, const int count,
                           __global const float *weights, __global const float *camera,
                           const int padded, __global const float *output,
                           __global const float *d_output, __global const int *active,
                           __global int *next, __global float *values, __global float *partial,
                           __global float *d_feature, __global float *d_position)
{
    const Model model = {feature, position, visible, (size_t)count, weights, camera};
    const Outputs outputs = {output, d_output, (size_t)padded};
    const AnchorGradients d = {d_feature, d_position};
    for (int part = atomic_inc(next); part < PARTS; part = atomic_inc(next))
        for (int batch = part; batch * BATCH < padded; batch += PARTS)
            batch_backward(&model, &outputs, batch, drawing_samples(batch, padded, active),
                           values + get_global_id(0) * BATCH_SIZE,
                           partial + (size_t)part * part_size(), &d);
}

/* One work-item a tile of rows (dimension 0: of all heads, one behind the other) by COLUMNS columns
 * (dimension 1): their sums over the parts, in order, to their places. */
__kernel void mlp_backward_sum(__global const float *partial, const int parts,
                               __global float *d_weights)
{
    int row_tile = (int)get_global_id(0), head = 0;
    for (; head < HEADS - 1 && row_tile >= head_tiles(head); ++head)
        row_tile -= head_tiles(head);
    const Layer layer = layer_of(head, row_tile);
    const int tile = (int)get_global_id(1);
    if (tile >= column_tiles(&layer))
        return;
    float sums[SUMS] = {0.0f};
    for (int part = 0; part < parts; ++part)
#pragma unroll
        for (int i = 0; i < SUMS; ++i)
            sums[i] += partial[(size_t)part * part_size() + layer.sums + tile * SUMS + i];
    for (int c = 0; c < COLUMNS; ++c)
        for (int o = layer.repeated; o < WEIGHT_ROWS; ++o) {
            const int column = tile * COLUMNS + c;
            if (column < layer.inputs)
                d_weights[layer.weight + o * layer.inputs + column] = sums[c * WEIGHT_ROWS + o];
            else if (column == layer.inputs)
                d_weights[layer.bias + o] = sums[c * WEIGHT_ROWS + o];
        }
}

#endif
