/* Sizes, register tile and weight layout of the MLPs. Weights are packed as in
 * clgs/scene/mlps.py: for each head (opacity, color, covariance) hidden weight, hidden bias,
 * output weight, output bias; row-major, (outputs, inputs). */
#ifndef CLGS_MLP_LAYOUT_H
#define CLGS_MLP_LAYOUT_H

#include "common/real.h"

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
/* Samples that are ordered together, a multiple of BATCH; samples of which the weight gradient is
 * computed together; sums of these, every PARTS-th batch in each. Whatever the device. */
#ifndef CHUNK
#define CHUNK 512
#endif
#ifndef BATCH
#define BATCH 256
#endif
#ifndef PARTS
#define PARTS 64
#endif

/* Register tile of the layers: TILE rows, which divides every layer's, by VECTORS vectors. That of
 * the weight gradient: WEIGHT_ROWS rows, no more than a layer has, by COLUMNS inputs: as many
 * accumulators as leave a CPU's registers room for a row of operands.
 * GROUP_SIZE work-items share a batch where they share local memory. */
#if USE_LOCAL
#define TILE 10
#define VECTORS 1
#define WEIGHT_ROWS 10
#define COLUMNS 2
#define GROUP_SIZE 64
#else
#define TILE 5
#define VECTORS 2
#define WEIGHT_ROWS 4
#define COLUMNS 3
#define GROUP_SIZE 1
#endif
#define BLOCK (VEC * VECTORS)

#define INPUT_DIM (FEATURE_DIM + 3)
#define HEADS 3
#define OUTPUT_ROWS (11 * K_OFFSETS)
#define HIDDEN_SIZE (HIDDEN_DIM * (INPUT_DIM + 1))
#define MLP_SIZE (HEADS * HIDDEN_SIZE + OUTPUT_ROWS * (HIDDEN_DIM + 1))

/* A larger input counts as not finite: no product with sane weights overflows below it. */
#define INPUT_LIMIT 1e15f

#define OPACITY 0
#define COLOR 1
#define COVARIANCE 2

/* The numbers of one batch and one head that the weight gradient needs, as rows of samples: inputs
 * and a row of ones (zero where a sample does not count), the gradients by the inputs (by features,
 * then by the last TILE inputs), hidden values, gradients by the sums of the hidden and of the
 * output layer. One head after the other, they stay in a CPU's cache. The stride spreads the rows
 * over the sets of that cache. */
#define ONES_ROW INPUT_DIM
#define D_INPUT_ROW (INPUT_DIM + 1)
#define HIDDEN_ROW (D_INPUT_ROW + FEATURE_DIM + TILE)
#define D_HIDDEN_ROW (HIDDEN_ROW + HIDDEN_DIM)
#define D_OUTPUT_ROW (D_HIDDEN_ROW + HIDDEN_DIM)
#define BATCH_ROWS (D_OUTPUT_ROW + 7 * K_OFFSETS)
#define BATCH_STRIDE (BATCH + 16)
#define BATCH_SIZE ((size_t)BATCH_ROWS * BATCH_STRIDE)

/* First output row of a head, in units of K_OFFSETS; the last entry is the end. */
__constant int head_rows[HEADS + 1] = {0, 1, 4, 11};

/* Output rows of one slot. */
static inline int slot_rows(const int head)
{
    return head_rows[head + 1] - head_rows[head];
}

static inline int first_output(const int head)
{
    return K_OFFSETS * head_rows[head];
}

/* Where the weights of a head start. */
static inline int head_start(const int head)
{
    return head * HIDDEN_SIZE + first_output(head) * (HIDDEN_DIM + 1);
}

/* A part of the weight gradient is kept as it is summed: tile by tile of a head's layers, COLUMNS
 * by COLUMNS of their inputs and bias, WEIGHT_ROWS sums a column. The last tile of a layer may
 * repeat rows of the one before. */
#define TILES_OF(rows) (((rows) + WEIGHT_ROWS - 1) / WEIGHT_ROWS)
#define COLUMN_TILES ((INPUT_DIM + COLUMNS) / COLUMNS)
#define SUMS (WEIGHT_ROWS * COLUMNS)
#define TILE_SUMS (COLUMN_TILES * SUMS)

/* Tiles of both layers of a head. */
static inline int head_tiles(const int head)
{
    return TILES_OF(HIDDEN_DIM) + TILES_OF(K_OFFSETS * slot_rows(head));
}

/* Tiles of the heads before one; of all heads for HEADS. */
static inline int tiles_before(const int head)
{
    int tiles = 0;
    for (int before = 0; before < head; ++before)
        tiles += head_tiles(before);
    return tiles;
}

static inline size_t part_size(void)
{
    return (size_t)tiles_before(HEADS) * TILE_SUMS;
}

#endif
