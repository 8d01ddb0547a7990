/* Sizes, register tile and weight layout of the MLPs. Weights are packed as in
 * clgs/scene/mlps.py: for each head (opacity, color, covariance) hidden weight, hidden bias,
 * output weight, output bias; row-major, (outputs, inputs). */
#ifndef CLGS_MLP_LAYOUT_H
#define CLGS_MLP_LAYOUT_H

#include "include/real.h"

#ifndef USE_LOCAL
#define USE_LOCAL 0
#endif
#ifndef K_OFFSETS
#define K_OFFSETS 10
#endif
#ifndef FEATURE_DIM
#define FEATURE_DIM 50
#endif
#ifndef HIDDEN_DIM
#define HIDDEN_DIM 50
#endif
#ifndef WANT_POSITION
#define WANT_POSITION 1
#endif
/* Samples of a chunk: the unit of the sum over samples, whatever the device. */
#ifndef CHUNK
#define CHUNK 1024
#endif

/* Register tile: TILE rows, which divides every layer's, by VECTORS vectors: 10 accumulators.
 * GROUP_SIZE work-items share a chunk of the weight gradient. */
#if USE_LOCAL
#define TILE 10
#define VECTORS 1
#define GROUP_SIZE 64
#else
#define TILE 5
#define VECTORS 2
#define GROUP_SIZE 1
#endif
#define BLOCK (VEC * VECTORS)

/* Inputs of the weight gradient's register tile. */
#define COLUMNS 2

#define INPUT_DIM (FEATURE_DIM + 3)
#define HEADS 3
#define HIDDEN_ROWS (HEADS * HIDDEN_DIM)
#define OUTPUT_ROWS (11 * K_OFFSETS)
#define HIDDEN_SIZE (HIDDEN_DIM * (INPUT_DIM + 1))
#define MLP_SIZE (HEADS * HIDDEN_SIZE + OUTPUT_ROWS * (HIDDEN_DIM + 1))

/* A larger input counts as not finite: no product with sane weights overflows below it. */
#define INPUT_LIMIT 1e15f

#define OPACITY 0
#define COLOR 1

/* First output row of a head, in units of K_OFFSETS; the last entry is the end. */
__constant int head_rows[HEADS + 1] = {0, 1, 4, 11};

inline int first_output(int head)
{
    return K_OFFSETS * head_rows[head];
}

/* Where the weights of a head start. */
inline int head_start(int head)
{
    return head * HIDDEN_SIZE + first_output(head) * (HIDDEN_DIM + 1);
}

/* Where TILE neighbouring rows of the weight gradient take their columns from and go to. */
typedef struct {
    __global const float *columns;
    int inputs;
    int weight; /* position of the first row's weights and bias in the packed vector */
    int bias;
} Layer;

inline Layer layer_of(const int delta_row, __global const float *input,
                      __global const float *hidden, const size_t stride)
{
    Layer layer;
    if (delta_row < HIDDEN_ROWS) {
        const int start = head_start(delta_row / HIDDEN_DIM), row = delta_row % HIDDEN_DIM;
        layer.columns = input;
        layer.inputs = INPUT_DIM;
        layer.weight = start + row * INPUT_DIM;
        layer.bias = start + HIDDEN_DIM * INPUT_DIM + row;
    } else {
        const int row = delta_row - HIDDEN_ROWS;
        const int head = row < first_output(1) ? 0 : row < first_output(2) ? 1 : 2;
        const int start = head_start(head) + HIDDEN_SIZE, inner = row - first_output(head);
        const int rows = first_output(head + 1) - first_output(head);
        layer.columns = hidden + head * HIDDEN_DIM * stride;
        layer.inputs = HIDDEN_DIM;
        layer.weight = start + inner * HIDDEN_DIM;
        layer.bias = start + rows * HIDDEN_DIM + inner;
    }
    return layer;
}

#endif
