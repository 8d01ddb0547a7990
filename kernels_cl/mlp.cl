/* The three decoding MLPs (opacity, color, covariance), forward and backward.
 *
 * Everything is feature-major: row r of an array holds one number for each of the Vp padded
 * samples (visible anchors), so that lanes are samples and weights are broadcast. A work-item
 * owns VECTORS * VEC samples and computes TILE rows at a time in registers.
 */
#include "include/real.h"
#include "include/camera.h"
#include "include/lanes.h"
#include "include/mlp_layout.h"
#include "include/vector3.h"

inline float3 camera_centre(__global const float *camera)
{
    return load3(camera + CAMERA_CENTRE, 0);
}

/* Unit vector along v and its length, without overflow; zero for zero. */
inline float3 direction(float3 v, float *length)
{
    const float largest = fmax(fabs(v.x), fmax(fabs(v.y), fabs(v.z)));
    const float3 scaled = v / largest;
    const float root = sqrt(dot3(scaled, scaled));
    *length = largest * root;
    return largest == 0.0f ? (float3)(0.0f) : scaled / root;
}

/* Column of one sample: feature, direction, 1; stride between the rows. */
inline void gather_sample(__global const float *feature, __global const float *position,
                          __global const float *camera, const int anchor, __global float *column,
                          const size_t stride)
{
    __global const float *row = feature + (size_t)anchor * FEATURE_DIM;
    for (int k = 0; k < FEATURE_DIM; ++k)
        column[k * stride] = row[k];
    float distance;
    const float3 view = direction(load3(position, anchor) - camera_centre(camera), &distance);
    column[FEATURE_DIM * stride] = view.x;
    column[(FEATURE_DIM + 1) * stride] = view.y;
    column[(FEATURE_DIM + 2) * stride] = view.z;
    column[INPUT_DIM * stride] = 1.0f;
}

/* Zero the columns with an input that is not finite; NaN in their lanes of the result, else 0. */
inline fv quarantine(__global float *x, const size_t stride)
{
    fv poison = (fv)(0.0f);
    for (int k = 0; k < INPUT_DIM; ++k)
        poison = fabs(LOAD_V(0, x + k * stride)) <= (fv)(INPUT_LIMIT) ? poison : (fv)(NAN);
    for (int k = 0; k <= INPUT_DIM; ++k) {
        const fv value = LOAD_V(0, x + k * stride);
        STORE_V(poison == (fv)(0.0f) ? value : (fv)(0.0f), 0, x + k * stride);
    }
    return poison;
}

/* sum[o][s] += weight[o * along + k * across] * x[k], over count rows x[k] of a block. */
inline void add_products(fv sum[TILE][VECTORS], __global const float *weight, const int along,
                         const int across, const int count, __global const float *x,
                         const size_t stride)
{
    for (int k = 0; k < count; ++k) {
        fv lanes[VECTORS];
#pragma unroll
        for (int s = 0; s < VECTORS; ++s)
            lanes[s] = LOAD_V(s, x + k * stride);
#pragma unroll
        for (int o = 0; o < TILE; ++o) {
            const fv broadcast = (fv)(weight[o * along + k * across]);
#pragma unroll
            for (int s = 0; s < VECTORS; ++s)
                sum[o][s] = fma(broadcast, lanes[s], sum[o][s]);
        }
    }
}

/* TILE rows of weight * x + bias; weight and bias point at the first of them. */
inline void dense(fv sum[TILE][VECTORS], __global const float *weight, __global const float *bias,
                  const int inputs, __global const float *x, const size_t stride)
{
#pragma unroll
    for (int o = 0; o < TILE; ++o)
#pragma unroll
        for (int s = 0; s < VECTORS; ++s)
            sum[o][s] = (fv)(bias[o]);
    add_products(sum, weight, inputs, 1, inputs, x, stride);
}

inline fv activate(const fv z, const int head)
{
    return head == OPACITY ? tanh_v(z) : head == COLOR ? sigmoid_v(z) : z;
}

/* Hidden layer of one head for one block; a NaN stays one. */
inline void hidden_layer(__global const float *weight, __global const float *x,
                         __global float *hidden, const size_t stride)
{
    __global const float *bias = weight + HIDDEN_DIM * INPUT_DIM;
    for (int row = 0; row < HIDDEN_DIM; row += TILE) {
        fv sum[TILE][VECTORS];
        dense(sum, weight + row * INPUT_DIM, bias + row, INPUT_DIM, x, stride);
#pragma unroll
        for (int o = 0; o < TILE; ++o)
#pragma unroll
            for (int s = 0; s < VECTORS; ++s)
                STORE_V(sum[o][s] < (fv)(0.0f) ? (fv)(0.0f) : sum[o][s], s,
                        hidden + (row + o) * stride);
    }
}

/* Output layer of one head for one block; poison is added to every output. */
inline void output_layer(__global const float *weight, const int head, __global const float *hidden,
                         const fv poison[VECTORS], __global float *output, const size_t stride)
{
    const int rows = first_output(head + 1) - first_output(head);
    __global const float *bias = weight + rows * HIDDEN_DIM;
    for (int row = 0; row < rows; row += TILE) {
        fv sum[TILE][VECTORS];
        dense(sum, weight + row * HIDDEN_DIM, bias + row, HIDDEN_DIM, hidden, stride);
#pragma unroll
        for (int o = 0; o < TILE; ++o)
#pragma unroll
            for (int s = 0; s < VECTORS; ++s)
                STORE_V(activate(sum[o][s], head) + poison[s], s, output + (row + o) * stride);
    }
}

/* One work-item a block of samples. input: INPUT_DIM rows and a row of ones, hidden: HIDDEN_ROWS,
 * output: OUTPUT_ROWS, all of padded columns; columns from count on get the input zero. */
__kernel void mlp_forward(__global const float *feature, __global const float *position,
                          __global const int *visible, const int count, const int padded,
                          __global const float *weights, __global const float *camera,
                          __global float *input, __global float *hidden, __global float *output)
{
    const size_t first = get_global_id(0) * BLOCK;
    const size_t stride = (size_t)padded;
    if (first >= stride)
        return;
    __global float *x = input + first;
    for (size_t lane = 0; lane < BLOCK; ++lane) {
        if (first + lane < (size_t)count) {
            gather_sample(feature, position, camera, visible[first + lane], x + lane, stride);
        } else {
            for (int k = 0; k <= INPUT_DIM; ++k)
                x[k * stride + lane] = 0.0f;
        }
    }
    fv poison[VECTORS];
    for (int s = 0; s < VECTORS; ++s)
        poison[s] = quarantine(x + s * VEC, stride);
    for (int head = 0; head < HEADS; ++head) {
        __global const float *weight = weights + head_start(head);
        __global float *inner = hidden + head * HIDDEN_DIM * stride + first;
        hidden_layer(weight, x, inner, stride);
        output_layer(weight + HIDDEN_SIZE, head, inner, poison,
                     output + first_output(head) * stride + first, stride);
    }
}

/* dL/d(sums of the output layer) from dL/d(output); zero where the sample does not count. */
inline fv output_gradient(const fv d_output, const fv output, const fv counts, const int head)
{
    const fv slope = head == OPACITY ? fma(-output, output, (fv)(1.0f))
                     : head == COLOR ? fma(-output, output, output)
                                     : (fv)(1.0f);
    return counts == (fv)(1.0f) ? d_output * slope : (fv)(0.0f);
}

/* dL/d(sums of one head) for one block: its output rows, then its hidden rows. */
inline void head_backward(const int head, __global const float *weight, __global const float *ones,
                          __global const float *hidden, __global const float *output,
                          __global const float *d_output, const size_t stride,
                          __global float *d_hidden, __global float *d_outer, const size_t d_stride)
{
    const int rows = first_output(head + 1) - first_output(head);
    for (int row = 0; row < rows; ++row)
        for (int s = 0; s < VECTORS; ++s)
            STORE_V(output_gradient(LOAD_V(s, d_output + row * stride),
                                    LOAD_V(s, output + row * stride), LOAD_V(s, ones), head),
                    s, d_outer + row * d_stride);
    for (int unit = 0; unit < HIDDEN_DIM; unit += TILE) {
        fv sum[TILE][VECTORS] = {{(fv)(0.0f)}};
        add_products(sum, weight + unit, 1, HIDDEN_DIM, rows, d_outer, d_stride);
#pragma unroll
        for (int o = 0; o < TILE; ++o)
#pragma unroll
            for (int s = 0; s < VECTORS; ++s) {
                const fv active = LOAD_V(s, hidden + (unit + o) * stride);
                STORE_V(active > (fv)(0.0f) ? sum[o][s] : (fv)(0.0f), s,
                        d_hidden + (unit + o) * d_stride);
            }
    }
}

/* dL/d(TILE inputs from first on) of one block, as rows of BLOCK numbers. */
inline void input_backward(const int first, __global const float *weights,
                           __global const float *d_hidden, const size_t d_stride,
                           float d_input[TILE * BLOCK])
{
    fv sum[TILE][VECTORS] = {{(fv)(0.0f)}};
    for (int head = 0; head < HEADS; ++head)
        add_products(sum, weights + head_start(head) + first, 1, INPUT_DIM, HIDDEN_DIM,
                     d_hidden + head * HIDDEN_DIM * d_stride, d_stride);
#pragma unroll
    for (int o = 0; o < TILE; ++o)
#pragma unroll
        for (int s = 0; s < VECTORS; ++s)
            STORE_V(sum[o][s], s, d_input + o * BLOCK);
}

/* dL/d(position) through the unit direction, from rows of BLOCK numbers dL/d(direction). */
inline void position_backward(const float *d_direction, __global const float *position,
                              __global const int *visible, __global const float *camera,
                              const size_t first, const size_t count, __global float *d_position)
{
    for (size_t lane = 0; lane < BLOCK && first + lane < count; ++lane) {
        const size_t anchor = (size_t)visible[first + lane];
        float distance;
        const float3 view = direction(load3(position, anchor) - camera_centre(camera), &distance);
        const float3 d =
            (float3)(d_direction[lane], d_direction[BLOCK + lane], d_direction[2 * BLOCK + lane]);
        const float3 across = (d - dot3(d, view) * view) / distance;
        store3(distance > 0.0f ? across : (float3)(0.0f), d_position, anchor);
    }
}

/* One work-item a block of samples, of the slab that starts at slab_first. delta holds the slab's
 * gradients by the layers' sums: HIDDEN_ROWS, then OUTPUT_ROWS, d_padded columns each.
 * d_feature and d_position are dense and zero before; an anchor is visible at most once. */
__kernel void mlp_backward(__global const float *input, __global const float *hidden,
                           __global const float *output, __global const float *d_output,
                           const int count, const int padded, const int slab_first,
                           const int d_padded, __global const float *position,
                           __global const int *visible, __global const float *weights,
                           __global const float *camera, __global float *delta,
                           __global float *d_feature, __global float *d_position)
{
    const size_t column = get_global_id(0) * BLOCK;
    const size_t first = (size_t)slab_first + column;
    const size_t stride = (size_t)padded, d_stride = (size_t)d_padded;
    if (first >= stride)
        return;
    __global const float *ones = input + INPUT_DIM * stride + first;
    __global float *d_hidden = delta + column;
    for (int head = 0; head < HEADS; ++head) {
        const size_t outer = first_output(head) * stride + first;
        head_backward(head, weights + head_start(head) + HIDDEN_SIZE, ones,
                      hidden + head * HIDDEN_DIM * stride + first, output + outer, d_output + outer,
                      stride, d_hidden + head * HIDDEN_DIM * d_stride,
                      d_hidden + (HIDDEN_ROWS + first_output(head)) * d_stride, d_stride);
    }
    float d_input[TILE * BLOCK];
    for (int k = 0; k < FEATURE_DIM; k += TILE) {
        input_backward(k, weights, d_hidden, d_stride, d_input);
        for (size_t lane = 0; lane < BLOCK && first + lane < (size_t)count; ++lane) {
            const size_t anchor = (size_t)visible[first + lane];
            for (int o = 0; o < TILE; ++o)
                d_feature[anchor * FEATURE_DIM + k + o] = d_input[o * BLOCK + lane];
        }
    }
#if WANT_POSITION
    input_backward(INPUT_DIM - TILE, weights, d_hidden, d_stride, d_input);
    position_backward(d_input + (TILE - 3) * BLOCK, position, visible, camera, first, (size_t)count,
                      d_position);
#endif
}

/* sums[o * COLUMNS + c] = sum over this item's samples of row o times column c. */
inline void dot_products(__global const float *rows, const size_t row_stride,
                         __global const float *columns[COLUMNS], const int samples, const int item,
                         float sums[TILE * COLUMNS])
{
    fv sum[TILE][COLUMNS] = {{(fv)(0.0f)}};
    for (int v = item; v < samples / VEC; v += GROUP_SIZE) {
        fv lanes[COLUMNS];
#pragma unroll
        for (int c = 0; c < COLUMNS; ++c)
            lanes[c] = LOAD_V(v, columns[c]);
#pragma unroll
        for (int o = 0; o < TILE; ++o) {
            const fv row = LOAD_V(v, rows + o * row_stride);
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

/* GROUP_SIZE work-items by TILE rows (dimension 0) by chunk of the slab (dimension 1): the
 * weight gradient of each chunk, summed in a fixed order. partial: (chunks, MLP_SIZE). */
__kernel void mlp_backward_weights(__global const float *input, __global const float *hidden,
                                   const int padded, const int slab_first, const int d_padded,
                                   __global const float *delta, __global float *partial)
{
    const int item = (int)get_local_id(0), row = (int)get_group_id(0) * TILE;
    const size_t stride = (size_t)padded, d_first = get_global_id(1) * CHUNK;
    const size_t first = (size_t)slab_first + d_first;
    const int samples = min(CHUNK, padded - (int)first);
    const Layer layer = layer_of(row, input + first, hidden + first, stride);
    __global const float *rows = delta + row * (size_t)d_padded + d_first;
    __global const float *ones = input + INPUT_DIM * stride + first;
    __global float *weights = partial + first / CHUNK * MLP_SIZE;
#if USE_LOCAL
    __local float shared[GROUP_SIZE * TILE * COLUMNS];
#endif
    for (int column = 0; column <= layer.inputs; column += COLUMNS) {
        __global const float *columns[COLUMNS];
        for (int c = 0; c < COLUMNS; ++c)
            columns[c] = column + c < layer.inputs ? layer.columns + (column + c) * stride : ones;
        float sums[TILE * COLUMNS];
        dot_products(rows, (size_t)d_padded, columns, samples, item, sums);
#if USE_LOCAL
        for (int i = 0; i < TILE * COLUMNS; ++i)
            shared[item * TILE * COLUMNS + i] = sums[i];
        barrier(CLK_LOCAL_MEM_FENCE);
        if (item < TILE * COLUMNS) {
            float total = 0.0f;
            for (int i = 0; i < GROUP_SIZE; ++i)
                total += shared[i * TILE * COLUMNS + item];
            store_weight(&layer, item / COLUMNS, column + item % COLUMNS, total, weights);
        }
        barrier(CLK_LOCAL_MEM_FENCE);
#else
        for (int i = 0; i < TILE * COLUMNS; ++i)
            store_weight(&layer, i / COLUMNS, column + i % COLUMNS, sums[i], weights);
#endif
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
