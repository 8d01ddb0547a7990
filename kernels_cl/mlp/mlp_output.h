/* Output layers of the MLPs' heads for one block of samples. */
#ifndef CLGS_MLP_OUTPUT_H
#define CLGS_MLP_OUTPUT_H

#include "mlp/mlp_dense.h"
#include "mlp/mlp_layout.h"

/* Where the outputs lie. */
#ifndef OUTPUT_SPACE
#define OUTPUT_SPACE __global
#endif

static inline fv activate(const fv z, const int head)
{
    return head == OPACITY ? tanh_v(z) : head == COLOR ? sigmoid_v(z) : z;
}

/* The listed rows of one head's output layer. */
static inline void output_layer(__global const float *weight, const int head, const float *hidden,
                                const size_t *rows, const size_t count, OUTPUT_SPACE float *output,
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
