/* Inputs of the MLPs: the feature of an anchor, and the unit direction from the camera to it. */
#ifndef CLGS_MLP_INPUTS_H
#define CLGS_MLP_INPUTS_H

#include "common/camera.h"
#include "common/lane_math.h"
#include "common/lanes.h"
#include "common/method.h"
#include "common/own_function.h"
#include "common/prefetch.h"
#include "common/real.h"
#include "mlp/layout.h"
#include "mlp/slots.h"

/* A larger input counts as not finite: no product with sane weights overflows below it. */
#define INPUT_LIMIT 1e15f

/* What all blocks read. */
typedef struct {
    __global const float *feature;
    __global const float *position;
    __global const int *visible;
    size_t count;
    __global const float *camera;
} Inputs;

/* Makes unit vectors, without overflow, zero for zero; returns their lengths. */
static inline fv make_directions(fv v[3])
{
    fv largest = fabs(v[0]);
    for (int i = 1; i < 3; ++i)
        largest = fabs(v[i]) > largest ? fabs(v[i]) : largest;
    for (int i = 0; i < 3; ++i)
        v[i] /= largest;
    const fv root = sqrt(dot3(v, v));
    for (int i = 0; i < 3; ++i)
        v[i] = largest == (fv)(0.0f) ? (fv)(0.0f) : v[i] / root;
    return largest * root;
}

/* Anchor of a sample; -1 if there is none. */
static inline int anchor_of(const Inputs *inputs, const size_t sample)
{
    return sample < inputs->count ? inputs->visible[sample] : -1;
}

/* Whether a sample of the block at `first` has an anchor; mostly the first one has. */
static inline bool any_anchor(const Inputs *inputs, const size_t first)
{
    for (size_t lane = 0; lane < BLOCK; ++lane)
        if (anchor_of(inputs, first + lane) >= 0)
            return true;
    return false;
}

/* Unit vectors from the camera to the positions of VEC anchors, and their lengths. */
static inline fv view_directions(const Inputs *inputs, __global const float *position[VEC],
                                 fv view[3])
{
    for (int i = 0; i < 3; ++i)
        view[i] = GATHER_V(position, i) - inputs->camera[CAMERA_CENTRE + i];
    return make_directions(view);
}

/* Prefetches the features of the block at `first`. */
static inline void prefetch_features(const Inputs *inputs, const size_t first)
{
    for (size_t lane = 0; lane < BLOCK; ++lane) {
        const size_t row = (size_t)max(anchor_of(inputs, first + lane), 0);
        for (size_t k = 0; k < FEATURE_DIM; k += LINE)
            PREFETCH(inputs->feature + row * FEATURE_DIM + k);
    }
}

/* Rows x of a block: feature, direction, and a row of ones, which multiplies the bias. A sample
 * without anchor, or with an input that is not finite, is zero in all of them. */
static inline OWN_FUNCTION void gather_inputs(const Inputs *inputs, const size_t first,
                                              float x[(INPUT_DIM + 1) * BLOCK])
{
    __global const float *feature[BLOCK], *position[BLOCK];
    prefetch_features(inputs, first + BLOCK);
    for (size_t lane = 0; lane < BLOCK; ++lane) {
        const int anchor = anchor_of(inputs, first + lane);
        const size_t row = (size_t)(anchor < 0 ? 0 : anchor);
        feature[lane] = inputs->feature + row * FEATURE_DIM;
        position[lane] = inputs->position + row * 3;
        x[INPUT_DIM * BLOCK + lane] = anchor < 0 ? 0.0f : 1.0f;
    }
    fv ones[VECTORS];
    bool all = true;
    for (int s = 0; s < VECTORS; ++s) {
        ones[s] = LOAD_V(s, x + INPUT_DIM * BLOCK);
        for (int k = 0; k < FEATURE_DIM; ++k)
            STORE_V(GATHER_V(feature + s * VEC, k), s, x + k * BLOCK);
        fv view[3];
        view_directions(inputs, position + s * VEC, view);
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

#endif
