/* The three decoding MLPs (opacity, color, covariance), forward and backward.
 *
 * Outputs are feature-major: row r holds one number for each of the padded samples. The opacity
 * head runs first. Then the samples of each chunk are put in the order of their drawn slots, those
 * without any last, so that neighbours draw the same slots: a block computes color and covariance
 * of the slots that some sample of it draws. Nothing but the outputs is kept: the backward pass
 * computes the hidden values again, which costs less than moving them through memory.
 */
#include "common/real.h"
#include "common/items.h"
#include "common/lanes.h"
#include "mlp/mlp_dense.h"
#include "mlp/mlp_layout.h"
#include "mlp/mlp_output.h"
#include "mlp/mlp_backward.h"
#include "mlp/mlp_weights.h"

/* One work-item a block of samples: opacity (K, padded), in the order of visible. Zero where there
 * is no anchor, NaN where an input is not finite. */
__kernel void mlp_opacity(__global const float *feature, __global const float *position,
                          __global const int *visible, const int count,
                          __global const float *weights, __global const float *camera,
                          const int padded, __global float *opacity)
{
    const size_t first = item_from_middle() * BLOCK, stride = (size_t)padded;
    if (first >= stride)
        return;
    const Model model = {feature, position, visible, (size_t)count, weights, camera};
    if (!any_anchor(&model, first)) { /* padding */
        for (size_t j = 0; j < K_OFFSETS; ++j)
            for (size_t s = 0; s < VECTORS; ++s)
                STORE_ALIGNED((fv)(0.0f), s, opacity + j * stride + first);
        return;
    }
    float x[(INPUT_DIM + 1) * BLOCK], hidden[HIDDEN_DIM * BLOCK];
    gather(&model, first, x);
    hidden_layer(weights, x, hidden);
    size_t rows[OUTPUT_ROWS];
    const size_t used = rows_of((1 << K_OFFSETS) - 1, OPACITY, rows);
    output_layer(weights + HIDDEN_SIZE, OPACITY, hidden, rows, used, opacity + first, stride);
    for (size_t lane = 0; lane < BLOCK; ++lane) {
        if (x[INPUT_DIM * BLOCK + lane] == 1.0f)
            continue;
        for (size_t j = 0; j < K_OFFSETS; ++j)
            opacity[j * stride + first + lane] = anchor_of(&model, first + lane) < 0 ? 0.0f : NAN;
    }
}

/* Samples are sorted by this key: drawn slots in the order of a Gray code, in which neighbours
 * differ in one slot, backwards; last those without any. */
#define KEYS ((1 << K_OFFSETS) + 1)
#define KEY_NONE (KEYS - 2)
#define KEY_NO_ANCHOR (KEYS - 1)

/* Keys of VEC samples, but for those without anchor. */
static inline iv sort_keys(__global const float *opacity, const size_t stride)
{
    iv slots = (iv)(0);
    for (int j = 0; j < K_OFFSETS; ++j)
        slots |= LOAD_ALIGNED(0, opacity + j * stride) > (fv)(0.0f) ? (iv)(1 << j) : (iv)(0);
    for (int reach = 1; reach < K_OFFSETS; reach *= 2)
        slots ^= slots >> reach;
    return (iv)(KEY_NONE)-slots;
}

static inline void move_sample(const size_t from, const size_t to, const size_t count,
                               const size_t stride, __global const float *opacity,
                               __global const int *visible, __global float *output,
                               __global int *sorted)
{
    for (int j = 0; j < K_OFFSETS; ++j)
        output[j * stride + to] = opacity[j * stride + from];
    if (to < count)
        sorted[to] = visible[from];
}

/* GROUP_SIZE work-items a chunk: its samples in order, equal keys as they were, and how many draw
 * something. Samples past count stay behind all others, as their key is the largest. */
__kernel void mlp_order(__global const float *opacity, __global const int *visible, const int count,
                        const int padded, __global float *output, __global int *sorted,
                        __global int *active)
{
    const size_t stride = (size_t)padded, chunk = get_group_id(0), first = chunk * CHUNK;
    const int samples = min(CHUNK, padded - (int)first);
#if USE_LOCAL
    __local int keys[CHUNK];
    for (int i = (int)get_local_id(0); i < samples; i += GROUP_SIZE) {
        const size_t v = first + (size_t)i;
        const bool anchor = v < (size_t)count && visible[v] >= 0;
        keys[i] = anchor ? sort_keys(opacity + v, stride) : KEY_NO_ANCHOR;
    }
    barrier(CLK_LOCAL_MEM_FENCE);
    for (int i = (int)get_local_id(0); i < samples; i += GROUP_SIZE) {
        int rank = 0, drawn = 0;
        for (int other = 0; other < samples; ++other) {
            rank += keys[other] < keys[i] || (keys[other] == keys[i] && other < i) ? 1 : 0;
            drawn += keys[other] < KEY_NONE ? 1 : 0;
        }
        move_sample(first + (size_t)i, first + (size_t)rank, (size_t)count, stride, opacity,
                    visible, output, sorted);
        if (i == 0)
            active[chunk] = drawn;
    }
#else
    int keys[CHUNK], place[KEYS + 1]; /* of the next sample of each key */
    for (int key = 0; key <= KEYS; ++key)
        place[key] = 0;
    for (int i = 0; i < samples; i += VEC)
        STORE_V(sort_keys(opacity + first + i, stride), 0, keys + i);
    for (int i = 0; i < samples; ++i) {
        const size_t v = first + (size_t)i;
        keys[i] = v < (size_t)count && visible[v] >= 0 ? keys[i] : KEY_NO_ANCHOR;
        ++place[keys[i] + 1];
    }
    for (int key = 0; key < KEYS; ++key)
        place[key + 1] += place[key];
    active[chunk] = place[KEY_NONE];
    for (int i = 0; i < samples; ++i)
        move_sample(first + (size_t)i, first + (size_t)place[keys[i]]++, (size_t)count, stride,
                    opacity, visible, output, sorted);
#endif
}

/* One work-item a block of samples: color and covariance rows of output, behind its opacities.
 * Rows of slots that no sample of the block draws are left as they are. */
__kernel void mlp_heads(__global const float *feature, __global const float *position,
                        __global const int *visible, const int count, __global const float *weights,
                        __global const float *camera, const int padded, __global float *output)
{
    const size_t first = item_from_middle() * BLOCK, stride = (size_t)padded;
    if (first >= stride)
        return;
    const Model model = {feature, position, visible, (size_t)count, weights, camera};
    const int slots = computed_slots(output + first, stride);
    if (SKIP_OPACITY_FIRST && slots == 0)
        return;
    float x[(INPUT_DIM + 1) * BLOCK], hidden[HIDDEN_DIM * BLOCK];
    size_t rows[OUTPUT_ROWS];
    gather(&model, first, x);
    for (int head = COLOR; head < HEADS; ++head) {
        __global const float *weight = weights + head_start(head);
        hidden_layer(weight, x, hidden);
        output_layer(weight + HIDDEN_SIZE, head, hidden, rows, rows_of(slots, head, rows),
                     output + first_output(head) * stride + first, stride);
    }
}
