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
#ifndef SKIP_OPACITY_FIRST
#define SKIP_OPACITY_FIRST 1
#endif
#ifndef SKIP_SLOTS
#define SKIP_SLOTS 1
#endif
/* Samples of a chunk: the unit of their order and of the sum over them, whatever the device. */
#ifndef CHUNK
#define CHUNK 512
#endif

/* Register tile: TILE rows, which divides every layer's, by VECTORS vectors: 10 accumulators.
 * GROUP_SIZE work-items share a chunk where they share local memory. */
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
#define COVARIANCE 2

/* The numbers of one chunk that its weight gradient needs, as rows of samples: inputs and a row
 * of ones (zero where a sample does not count), hidden values, gradients by the sums of the hidden
 * and of the output layers. The stride spreads the rows over the sets of a cache. */
#define ONES_ROW INPUT_DIM
#define VALUE_ROW (INPUT_DIM + 1)
#define D_HIDDEN_ROW (VALUE_ROW + HIDDEN_ROWS)
#define D_OUTPUT_ROW (D_HIDDEN_ROW + HIDDEN_ROWS)
#define CHUNK_ROWS (D_OUTPUT_ROW + OUTPUT_ROWS)
#define CHUNK_STRIDE (CHUNK + 16)
#define CHUNK_SIZE ((size_t)CHUNK_ROWS * CHUNK_STRIDE)

/* First output row of a head, in units of K_OFFSETS; the last entry is the end. */
__constant int head_rows[HEADS + 1] = {0, 1, 4, 11};

/* Output rows of one slot. */
inline int slot_rows(const int head)
{
    return head_rows[head + 1] - head_rows[head];
}

inline int first_output(const int head)
{
    return K_OFFSETS * head_rows[head];
}

/* Where the weights of a head start. */
inline int head_start(const int head)
{
    return head * HIDDEN_SIZE + first_output(head) * (HIDDEN_DIM + 1);
}

#endif
