/* Sizes of the MLPs and of their register tiles, and the layout of weights and outputs.
 *
 * Weights are packed as in clgs/scene/mlps.py: for each head (opacity, color, covariance) hidden
 * weight, hidden bias, output weight, output bias; row-major, (outputs, inputs). Outputs have one
 * row per output and one column per sample: K opacities, 3 K colors, 7 K covariance numbers.
 */
#ifndef CLGS_MLP_LAYOUT_H
#define CLGS_MLP_LAYOUT_H

#include "common/form.h"
#include "common/method.h"
#include "common/real.h"

#ifndef HIDDEN_DIM
#define HIDDEN_DIM 50
#endif

/* Samples that are sorted together. */
#ifndef CHUNK
#define CHUNK 512
#endif

/* A work-item computes a block of BLOCK samples, TILE rows of a layer at a time: TILE x VECTORS
 * sums stay in registers. TILE divides the rows of every layer. */
#ifndef TILE
#define TILE (USE_LOCAL ? 10 : 5)
#endif
#ifndef VECTORS
#define VECTORS (USE_LOCAL ? 1 : 2)
#endif
#define BLOCK (VEC * VECTORS)

/* Work-items of a group that share local memory, in the GPU form. */
#ifndef GROUP_SIZE
#define GROUP_SIZE 64
#endif

#define INPUT_DIM (FEATURE_DIM + 3)
#define HIDDEN_SIZE (HIDDEN_DIM * (INPUT_DIM + 1))

#define OPACITY 0
#define COLOR 1
#define COVARIANCE 2
#define HEADS 3

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

#endif
