/* Layers of the MLPs for one block of samples.
 *
 * A block's arrays are private, rows of BLOCK numbers: lanes are samples, and weights are
 * broadcast. A register tile of TILE rows is computed at a time.
 */
#ifndef CLGS_MLP_BLOCK_LAYER_H
#define CLGS_MLP_BLOCK_LAYER_H

#include "common/method.h"
#include "common/own_function.h"
#include "common/real.h"
#include "mlp/layout.h"

/* Address space of the outputs; a program that keeps them private defines it before this file. */
#ifndef OUTPUT_SPACE
#define OUTPUT_SPACE __global
#endif

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
static inline OWN_FUNCTION void hidden_units(__global const float *weight, const int unit,
                                             const float *x, float *hidden)
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

static inline fv activate(const fv z, const int head)
{
    return head == OPACITY ? tanh_v(z) : head == COLOR ? sigmoid_v(z) : z;
}

/* The listed rows of one head's output layer. */
static inline OWN_FUNCTION void output_layer(__global const float *weight, const int head,
                                             const float *hidden, const size_t *rows,
                                             const size_t count, OUTPUT_SPACE float *output,
                                             const size_t stride)
{
    __global const float *bias = weight + K_OFFSETS * slot_rows(head) * HIDDEN_DIM;
    for (size_t first = 0; first < count; first += TILE) {
        size_t row[TILE];
        __global const float *weights[TILE];
        fv sum[TILE][VECTORS];
#pragma unroll
        for (int o = 0; o < TILE; ++o) {
            row[o] = rows[min(first + (size_t)o, count - 1)]; /* the last tile may repeat a row */
            weights[o] = weight + row[o] * HIDDEN_DIM;
#pragma unroll
            for (int s = 0; s < VECTORS; ++s)
                sum[o][s] = (fv)(bias[row[o]]);
        }
        add_rows(sum, weights, HIDDEN_DIM, hidden);
#pragma unroll
        for (int o = 0; o < TILE; ++o)
#pragma unroll
            for (int s = 0; s < VECTORS; ++s)
                ((OUTPUT_SPACE fv *)(output + row[o] * stride))[s] = activate(sum[o][s], head);
    }
}

#endif
