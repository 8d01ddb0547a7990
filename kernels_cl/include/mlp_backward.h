/* The backward pass of the MLPs. */
#ifndef CLGS_MLP_BACKWARD_H
#define CLGS_MLP_BACKWARD_H

#include "include/lanes.h"
#include "include/mlp_dense.h"
#include "include/mlp_layout.h"

/* What the forward pass left, and the gradient by it: rows of stride samples. */
typedef struct {
    __global const float *output;
    __global const float *d_output;
    size_t stride;
} Outputs;

/* Dense gradients, zero before; an anchor is visible at most once. */
typedef struct {
    __global float *d_feature;
    __global float *d_position;
} AnchorGradients;

/* dL/d(sums of one head's output layer) for the block at `first`; zero where nothing is drawn. */
inline void output_gradients(const Outputs *outputs, const int head, const size_t first,
                             const int slots, float *d_sum)
{
    const int each = slot_rows(head);
    for (int j = 0; j < K_OFFSETS; ++j) {
        for (int i = 0; i < each; ++i) {
            const size_t row =
                (size_t)(first_output(head) + j * each + i) * outputs->stride + first;
            PREFETCH(outputs->output + row + BLOCK);
            PREFETCH(outputs->d_output + row + BLOCK);
            for (int s = 0; s < VECTORS; ++s) {
                fv d = (fv)(0.0f);
                if (slots >> j & 1) {
                    const fv opacity =
                        LOAD_ALIGNED(s, outputs->output + j * outputs->stride + first);
                    const fv y = LOAD_ALIGNED(s, outputs->output + row);
                    const fv slope = head == OPACITY ? fma(-y, y, (fv)(1.0f))
                                     : head == COLOR ? fma(-y, y, y)
                                                     : (fv)(1.0f);
                    d = LOAD_ALIGNED(s, outputs->d_output + row) * slope;
                    d = opacity > (fv)(0.0f) ? d : (fv)(0.0f);
                }
                STORE_V(d, s, d_sum + (j * each + i) * BLOCK);
            }
        }
    }
}

inline void copy_rows(const float *rows, const int count, __global float *chunk)
{
    for (int row = 0; row < count; ++row)
        for (int s = 0; s < VECTORS; ++s)
            STORE_ALIGNED(LOAD_V(s, rows + row * BLOCK), s, chunk + row * CHUNK_STRIDE);
}

/* dL/d(sums) of both layers of one head, from the block's inputs; all into the chunk as well. */
inline void head_backward(const Model *model, const Outputs *outputs, const int head,
                          const size_t first, const int slots, const float *x, float *d_hidden,
                          __global float *chunk)
{
    __global const float *weight = model->weights + head_start(head);
    float hidden[HIDDEN_DIM * BLOCK], d_sum[OUTPUT_ROWS * BLOCK];
    size_t rows[OUTPUT_ROWS];
    hidden_layer(weight, x, hidden);
    output_gradients(outputs, head, first, slots, d_sum);
    const size_t count = rows_of(slots, head, rows);
    for (int unit = 0; unit < HIDDEN_DIM; unit += TILE) {
        fv sum[TILE][VECTORS] = {{(fv)(0.0f)}};
        add_columns(sum, weight + HIDDEN_SIZE + unit, HIDDEN_DIM, rows, count, d_sum);
#pragma unroll
        for (int o = 0; o < TILE; ++o)
#pragma unroll
            for (int s = 0; s < VECTORS; ++s) {
                const fv active = LOAD_V(s, hidden + (unit + o) * BLOCK);
                STORE_V(active > (fv)(0.0f) ? sum[o][s] : (fv)(0.0f), s,
                        d_hidden + (unit + o) * BLOCK);
            }
    }
    copy_rows(hidden, HIDDEN_DIM, chunk + (VALUE_ROW + head * HIDDEN_DIM) * CHUNK_STRIDE);
    copy_rows(d_hidden, HIDDEN_DIM, chunk + (D_HIDDEN_ROW + head * HIDDEN_DIM) * CHUNK_STRIDE);
    copy_rows(d_sum, K_OFFSETS * slot_rows(head),
              chunk + (D_OUTPUT_ROW + first_output(head)) * CHUNK_STRIDE);
}

/* dL/d(TILE inputs from first on) of one block. */
inline void input_backward(const int first, __global const float *weights, const float *d_hidden,
                           float d_input[TILE * BLOCK])
{
    size_t units[HIDDEN_DIM];
    for (size_t unit = 0; unit < HIDDEN_DIM; ++unit)
        units[unit] = unit;
    fv sum[TILE][VECTORS] = {{(fv)(0.0f)}};
    for (int head = 0; head < HEADS; ++head)
        add_columns(sum, weights + head_start(head) + first, INPUT_DIM, units, HIDDEN_DIM,
                    d_hidden + head * HIDDEN_DIM * BLOCK);
#pragma unroll
    for (int o = 0; o < TILE; ++o)
#pragma unroll
        for (int s = 0; s < VECTORS; ++s)
            STORE_V(sum[o][s], s, d_input + o * BLOCK);
}

/* dL/d(position) through the unit direction, from rows of BLOCK numbers dL/d(direction). */
inline void position_backward(const Model *model, const float *d_direction, const size_t first,
                              __global float *d_position)
{
    for (int s = 0; s < VECTORS; ++s) {
        int anchor[VEC];
        __global const float *position[VEC];
        for (size_t lane = 0; lane < VEC; ++lane) {
            anchor[lane] = anchor_of(model, first + s * VEC + lane);
            position[lane] = model->position + 3 * (size_t)max(anchor[lane], 0);
        }
        fv view[3], d[3];
        const fv distance = view_directions(model, position, view);
        for (int i = 0; i < 3; ++i)
            d[i] = LOAD_V(s, d_direction + i * BLOCK);
        const fv along = fma(d[2], view[2], fma(d[1], view[1], d[0] * view[0]));
        for (int i = 0; i < 3; ++i) {
            float across[VEC];
            STORE_V(distance > (fv)(0.0f) ? (d[i] - along * view[i]) / distance : (fv)(0.0f), 0,
                    across);
            for (size_t lane = 0; lane < VEC; ++lane)
                if (anchor[lane] >= 0)
                    d_position[3 * (size_t)anchor[lane] + i] = across[lane];
        }
    }
}

/* Layers of the block at sample `first`, which is written to its columns of the chunk. */
inline void block_backward(const Model *model, const Outputs *outputs, const size_t first,
                           const int slots, __global float *chunk, const AnchorGradients *d)
{
    float x[(INPUT_DIM + 1) * BLOCK], d_hidden[HIDDEN_ROWS * BLOCK], d_input[TILE * BLOCK];
    gather(model, first, x);
    copy_rows(x, INPUT_DIM + 1, chunk);
    for (int head = 0; head < HEADS; ++head)
        head_backward(model, outputs, head, first, slots, x, d_hidden + head * HIDDEN_DIM * BLOCK,
                      chunk);
    for (int k = 0; k < FEATURE_DIM; k += TILE) {
        input_backward(k, model->weights, d_hidden, d_input);
        for (size_t lane = 0; lane < BLOCK; ++lane) {
            const int anchor = anchor_of(model, first + lane);
            for (int o = 0; o < TILE && anchor >= 0; ++o)
                d->d_feature[(size_t)anchor * FEATURE_DIM + k + o] = d_input[o * BLOCK + lane];
        }
    }
#if WANT_POSITION
    input_backward(INPUT_DIM - TILE, model->weights, d_hidden, d_input);
    position_backward(model, d_input + (TILE - 3) * BLOCK, first, d->d_position);
#endif
}

/* Where TILE neighbouring rows of the weight gradient come from, among the rows of a chunk, and
 * where they go to in the packed vector. */
typedef struct {
    int row;    /* of the gradients by sums */
    int column; /* first row of the layer's inputs */
    int inputs;
    int weight;
    int bias;
    int slots; /* that the rows belong to */
} Layer;

inline Layer layer_of(const int row)
{
    Layer layer;
    layer.row = D_HIDDEN_ROW + row;
    if (row < HIDDEN_ROWS) {
        const int start = head_start(row / HIDDEN_DIM), inner = row % HIDDEN_DIM;
        layer.column = 0;
        layer.inputs = INPUT_DIM;
        layer.weight = start + inner * INPUT_DIM;
        layer.bias = start + HIDDEN_DIM * INPUT_DIM + inner;
        layer.slots = (1 << K_OFFSETS) - 1;
    } else {
        const int outer = row - HIDDEN_ROWS;
        const int head = outer < first_output(1) ? 0 : outer < first_output(2) ? 1 : 2;
        const int start = head_start(head) + HIDDEN_SIZE, inner = outer - first_output(head);
        layer.column = VALUE_ROW + head * HIDDEN_DIM;
        layer.inputs = HIDDEN_DIM;
        layer.weight = start + inner * HIDDEN_DIM;
        layer.bias = start + K_OFFSETS * slot_rows(head) * HIDDEN_DIM + inner;
        layer.slots = 0;
        for (int o = 0; o < TILE; ++o)
            layer.slots |= 1 << (inner + o) / slot_rows(head);
    }
    return layer;
}

/* The vectors of a chunk that a work-item sums over, in order. */
typedef struct {
    size_t count;
    size_t vector[CHUNK / VEC];
} Steps;

/* sums[o * COLUMNS + c] = sum over the steps of row o times column c. */
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
            const fv row = LOAD_ALIGNED(v, rows + o * CHUNK_STRIDE);
#pragma unroll
            for (int c = 0; c < COLUMNS; ++c)
                sum[o][c] = fma(row, lanes[c], sum[o][c]);
        }
    }
#pragma unroll
    for (int o = 0; o < TILE; ++o)
#pragma unroll
        for (int c = 0; c < COLUMNS; ++c)
            sums[o * COLUMNS + c] = lane_sum(sum[o][c]);
}

inline void store_weight(const Layer *layer, const int row, const int column, const float value,
                         __global float *weights)
{
    if (column < layer->inputs)
        weights[layer->weight + row * layer->inputs + column] = value;
    else if (column == layer->inputs)
        weights[layer->bias + row] = value;
}

/* Rows of the chunk that COLUMNS columns of a layer's weights multiply; the bias' is ones. */
inline void layer_columns(const Layer *layer, const int column, __global const float *chunk,
                          __global const float *columns[COLUMNS])
{
    for (int c = 0; c < COLUMNS; ++c)
        columns[c] = chunk + (column + c < layer->inputs ? layer->column + column + c : ONES_ROW) *
                                 CHUNK_STRIDE;
}

/* Samples of a chunk whose gradients may differ from zero. */
inline int drawing_samples(const int chunk, const int padded, __global const int *active)
{
    return SKIP_OPACITY_FIRST ? active[chunk] : min(CHUNK, padded - chunk * CHUNK);
}

/* One work-item a block of the chunks from first_chunk on, which are written to `chunks`. */
__kernel void mlp_backward_layers(__global const float *feature, __global const float *position,
                                  __global const int *visible, const int count,
                                  __global const float *weights, __global const float *camera,
                                  const int padded, __global const float *output,
                                  __global const float *d_output, __global const int *active,
                                  const int first_chunk, __global float *chunks,
                                  __global float *d_feature, __global float *d_position)
{
    const int sample = (int)get_global_id(0) * BLOCK, chunk = first_chunk + sample / CHUNK;
    const size_t first = (size_t)first_chunk * CHUNK + (size_t)sample;
    if (first >= (size_t)padded || sample % CHUNK >= drawing_samples(chunk, padded, active))
        return;
    const Model model = {feature, position, visible, (size_t)count, weights, camera};
    const Outputs outputs = {output, d_output, (size_t)padded};
    const AnchorGradients d = {d_feature, d_position};
    block_backward(&model, &outputs, first, computed_slots(output + first, outputs.stride),
                   chunks + (size_t)(sample / CHUNK) * CHUNK_SIZE + sample % CHUNK, &d);
}

/* GROUP_SIZE work-items by TILE rows (dimension 0) by chunk (dimension 1): the weight gradient of
 * each chunk, summed in a fixed order. partial: (all chunks, MLP_SIZE). */
__kernel void mlp_backward_weights(const int padded, __global const int *active,
                                   const int first_chunk, __global const float *chunks,
                                   __global float *partial)
{
    const int item = (int)get_local_id(0), chunk = first_chunk + (int)get_group_id(1);
    const int samples = drawing_samples(chunk, padded, active);
    const Layer layer = layer_of((int)get_group_id(0) * TILE);
    __global const float *values = chunks + get_group_id(1) * CHUNK_SIZE;
    Steps steps = {0, {0}};
    for (int v = item; v * VEC < samples; v += GROUP_SIZE)
        steps.vector[steps.count++] = (size_t)v;
    __local float shared[GROUP_SIZE * TILE * COLUMNS];
    for (int column = 0; column <= layer.inputs; column += COLUMNS) {
        __global const float *columns[COLUMNS];
        layer_columns(&layer, column, values, columns);
        float sums[TILE * COLUMNS];
        dot_products(values + layer.row * CHUNK_STRIDE, columns, &steps, sums);
        for (int i = 0; i < TILE * COLUMNS; ++i)
            shared[item * TILE * COLUMNS + i] = sums[i];
        barrier(CLK_LOCAL_MEM_FENCE);
        for (int sum = item; sum < TILE * COLUMNS; sum += GROUP_SIZE) {
            float total = 0.0f;
            for (int i = 0; i < GROUP_SIZE; ++i)
                total += shared[i * TILE * COLUMNS + sum];
            store_weight(&layer, sum / COLUMNS, column + sum % COLUMNS, total,
                         partial + (size_t)chunk * MLP_SIZE);
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

/* The weight gradient of one chunk. */
inline void chunk_weights(__global const float *values, const int *slots, const int blocks,
                          __global float *weights)
{
    for (int row = 0; row < HIDDEN_ROWS + OUTPUT_ROWS; row += TILE) {
        const Layer layer = layer_of(row);
        Steps steps;
        list_steps(&layer, slots, blocks, &steps);
        for (int column = 0; column <= layer.inputs; column += COLUMNS) {
            __global const float *columns[COLUMNS];
            layer_columns(&layer, column, values, columns);
            float sums[TILE * COLUMNS];
            dot_products(values + layer.row * CHUNK_STRIDE, columns, &steps, sums);
            for (int i = 0; i < TILE * COLUMNS; ++i)
                store_weight(&layer, i / COLUMNS, column + i % COLUMNS, sums[i], weights);
        }
    }
}

/* One work-item every global-size-th chunk, one after the other in a CHUNK_SIZE of its own, which
 * stays in the cache. partial: (chunks, MLP_SIZE), the weight gradient of each chunk. */
__kernel void mlp_backward(__global const float *feature, __global const float *position,
                           __global const int *visible, const int count,
                           __global const float *weights, __global const float *camera,
                           const int padded, __global const float *output,
                           __global const float *d_output, __global const int *active,
                           __global float *chunks, __global float *partial,
                           __global float *d_feature, __global float *d_position)
{
    const Model model = {feature, position, visible, (size_t)count, weights, camera};
    const Outputs outputs = {output, d_output, (size_t)padded};
    const AnchorGradients d = {d_feature, d_position};
    __global float *values = chunks + get_global_id(0) * CHUNK_SIZE;
    for (int chunk = (int)get_global_id(0); chunk * CHUNK < padded;
         chunk += (int)get_global_size(0)) {
        const int blocks = (drawing_samples(chunk, padded, active) + BLOCK - 1) / BLOCK;
        int slots[CHUNK / BLOCK];
        for (int block = 0; block < blocks; ++block) {
            const size_t first = (size_t)(chunk * CHUNK + block * BLOCK);
            slots[block] = computed_slots(output + first, outputs.stride);
            block_backward(&model, &outputs, first, slots[block], values + block * BLOCK, &d);
        }
        chunk_weights(values, slots, blocks, partial + (size_t)chunk * MLP_SIZE);
    }
}

/* One work-item a weight: the sum over the chunks, in order. */
__kernel void mlp_backward_sum(__global const float *partial, const int chunks,
                               __global float *d_weights)
{
    const size_t i = get_global_id(0);
    if (i >= MLP_SIZE)
        return;
    float sum = 0.0f;
    for (int chunk = 0; chunk < chunks; ++chunk)
        sum += partial[(size_t)chunk * MLP_SIZE + i];
    d_weights[i] = sum;
}

#endif
