/* Layers of the MLPs for one block of samples. A block's arrays are private, rows of BLOCK
 * numbers, so that lanes are samples and weights are broadcast; TILE rows are computed at a time,
 * in registers. */
#ifndef CLGS_MLP_DENSE_H
#define CLGS_MLP_DENSE_H

#include "common/camera.h"
#include "common/lanes.h"
#include "mlp/mlp_layout.h"
#include "common/prefetch.h"

/* What all blocks read. */
typedef struct {
    __global const float *feature;
    __global const float *position;
    __global const int *visible;
    size_t count;
    __global const float *weights;
    __global const float *camera;
} Model;

/* Makes unit vectors, without overflow, zero for zero; returns their lengths. */
static inline fv make_directions(fv v[3])
{
    fv largest = fabs(v[0]);
    for (int i = 1; i < 3; ++i)
        largest = fabs(v[i]) > largest ? fabs(v[i]) : largest;
    for (int i = 0; i < 3; ++i)
        v[i] /= largest;
    const fv root = sqrt(fma(v[2], v[2], fma(v[1], v[1], v[0] * v[0])));
    for (int i = 0; i < 3; ++i)
        v[i] = largest == (fv)(0.0f) ? (fv)(0.0f) : v[i] / root;
    return largest * root;
}

static inline bool any_positive(const fv x)
{
#if VEC == 1
    return x > 0.0f;
#else
    return any(x > (fv)(0.0f));
#endif
}

/* Anchor of a sample; -1 for one that does not count. */
static inline int anchor_of(const Model *model, const size_t sample)
{
    return sample < model->count ? model->visible[sample] : -1;
}

/* Whether a sample of the block at `first` counts: the first one, mostly. */
static inline bool any_anchor(const Model *model, const size_t first)
{
    for (size_t lane = 0; lane < BLOCK; ++lane)
        if (anchor_of(model, first + lane) >= 0)
            return true;
    return false;
}

/* Unit vectors from the camera to the positions of VEC anchors, and their lengths. */
static inline fv view_directions(const Model *model, __global const float *position[VEC],
                                 fv view[3])
{
    for (int i = 0; i < 3; ++i)
        view[i] = GATHER_V(position, i) - model->camera[CAMERA_CENTRE + i];
    return make_directions(view);
}

/* The features of the block at `first` are read next. */
static inline void fetch_features(const Model *model, const size_t first)
{
    for (size_t lane = 0; lane < BLOCK; ++lane) {
        const size_t row = (size_t)max(anchor_of(model, first + lane), 0);
        for (size_t k = 0; k < FEATURE_DIM; k += LINE)
            PREFETCH(model->feature + row * FEATURE_DIM + k);
    }
}

/* Inputs of a block: feature, direction, and a row of ones that is zero where a sample does not
 * count, as are its inputs: where there is no anchor, or an input is not finite. */
static inline void gather(const Model *model, const size_t first, float x[(INPUT_DIM + 1) * BLOCK])
{
    __global const float *feature[BLOCK], *position[BLOCK];
    fetch_features(model, first + BLOCK);
    for (size_t lane = 0; lane < BLOCK; ++lane) {
        const int anchor = anchor_of(model, first + lane);
        const size_t row = (size_t)(anchor < 0 ? 0 : anchor);
        feature[lane] = model->feature + row * FEATURE_DIM;
        position[lane] = model->position + row * 3;
        x[INPUT_DIM * BLOCK + lane] = anchor < 0 ? 0.0f : 1.0f;
    }
    fv ones[VECTORS];
    bool all = true;
    for (int s = 0; s < VECTORS; ++s) {
        ones[s] = LOAD_V(s, x + INPUT_DIM * BLOCK);
        for (int k = 0; k < FEATURE_DIM; ++k)
            STORE_V(GATHER_V(feature + s * VEC, k), s, x + k * BLOCK);
        fv view[3];
        view_directions(model, position + s * VEC, view);
        for (int i = 0; i < 3; ++i)
            STORE_V(view[i], s, x + (FEATURE_DIM + i) * BLOCK);
        for (int k = 0; k < INPUT_DIM; ++k)
            ones[s] = fabs(LOAD_V(s, x + k * BLOCK)) <= (fv)(INPUT_LIMIT) ? ones[s] : (fv)(0.0f);
        STORE_V(ones[s], s, x + INPUT_DIM * BLOCK);
        all = all && !any_positive((fv)(1.0f) - ones[s]);
    }
    for (int k = 0; k < INPUT_DIM && !all; ++k)
        for (int s = 0; s < VECTORS; ++s) {
            const fv value = LOAD_V(s, x + k * BLOCK);
            STORE_V(ones[s] == (fv)(1.0f) ? value : (fv)(0.0f), s, x + k * BLOCK);
        }
}

/* sum[o][s] += weight[o][k] * row k of x, over count rows. */
static inline void add_rows(fv sum[TILE][VECTORS], __global const float *weight[TILE],
                            const size_t count, const float *x)
{
#pragma unroll 2
    for (size_t k = 0; k < count; ++k) {
        fv lanes[VECTORS];
#pragma unroll
        for (int s = 0; s < VECTORS; ++s)
            lanes[s] = LOAD_V(s, x + k * BLOCK);
#pragma unroll
        for (int o = 0; o < TILE; ++o) {
            const fv broadcast = (fv)(weight[o][k]);
#pragma unroll
            for (int s = 0; s < VECTORS; ++s)
                sum[o][s] = fma(broadcast, lanes[s], sum[o][s]);
        }
    }
}

/* The transpose: sum[o][s] += weight[row * inputs + o] * row of d, over rows [begin, end). */
static inline void add_columns(fv sum[TILE][VECTORS], __global const float *weight,
                               const size_t inputs, const size_t begin, const size_t end,
                               const float *d)
{
#pragma unroll 2
    for (size_t row = begin; row < end; ++row) {
        fv lanes[VECTORS];
#pragma unroll
        for (int s = 0; s < VECTORS; ++s)
            lanes[s] = LOAD_V(s, d + row * BLOCK);
#pragma unroll
        for (int o = 0; o < TILE; ++o) {
            const fv broadcast = (fv)(weight[row * inputs + (size_t)o]);
#pragma unroll
            for (int s = 0; s < VECTORS; ++s)
                sum[o][s] = fma(broadcast, lanes[s], sum[o][s]);
        }
    }
}

/* TILE units, from `unit` on, of one head's hidden layer; a NaN stays one. */
static inline void hidden_units(__global const float *weight, const int unit, const float *x,
                                float *hidden)
{
    __global const float *bias = weight + HIDDEN_DIM * INPUT_DIM;
    __global const float *weights[TILE];
    fv sum[TILE][VECTORS];
#pragma unroll
    for (int o = 0; o < TILE; ++o) {
        weights[o] = weight + (unit + o) * INPUT_DIM;
#pragma unroll
        for (int s = 0; s < VECTORS; ++s)
            sum[o][s] = (fv)(bias[unit + o]);
    }
    add_rows(sum, weights, INPUT_DIM, x);
#pragma unroll
    for (int o = 0; o < TILE; ++o)
#pragma unroll
        for (int s = 0; s < VECTORS; ++s)
            STORE_V(sum[o][s] < (fv)(0.0f) ? (fv)(0.0f) : sum[o][s], s,
                    hidden + (unit + o) * BLOCK);
}

static inline void hidden_layer(__global const float *weight, const float *x, float *hidden)
{
    for (int unit = 0; unit < HIDDEN_DIM; unit += TILE)
        hidden_units(weight, unit, x, hidden);
}

/* The slots, one a bit, with a positive opacity in some sample of a block; NaN is not positive. */
static inline int drawn_slots(__global const float *opacity, const size_t stride)
{
    int slots = 0;
    for (int j = 0; j < K_OFFSETS; ++j)
        for (int s = 0; s < VECTORS; ++s)
            slots |= any_positive(LOAD_ALIGNED(s, opacity + j * stride)) ? 1 << j : 0;
    return slots;
}

/* Those that are computed. */
static inline int computed_slots(__global const float *opacity, const size_t stride)
{
    const int drawn = drawn_slots(opacity, stride), all = (1 << K_OFFSETS) - 1;
    if (SKIP_SLOTS)
        return drawn;
    return SKIP_OPACITY_FIRST && drawn == 0 ? 0 : all;
}

/* Rows of one head that belong to the given slots, ascending; returns how many. */
static inline size_t rows_of(const int slots, const int head, size_t rows[OUTPUT_ROWS])
{
    const size_t each = (size_t)slot_rows(head);
    size_t count = 0;
    for (size_t j = 0; j < K_OFFSETS; ++j)
        for (size_t i = 0; (slots >> j & 1) && i < each; ++i)
            rows[count++] = j * each + i;
    return count;
}

#endif
