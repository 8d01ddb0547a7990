/* A batch: the samples of which the weight gradient is computed together, and its memory.
 *
 * Rows of BATCH_STRIDE numbers, one column per sample:
 *     inputs, and a row of ones (zero if a sample does not count),
 *     in the CPU form gradients by the features,
 *     of a head hidden values, gradients by the sums of the hidden layer, and by those of the
 * output layer: of all heads in the GPU form, of one at a time in the CPU form. The latter is
 * little enough to stay in a CPU's cache, over whose sets the stride spreads the rows.
 */
#ifndef CLGS_MLP_BATCH_H
#define CLGS_MLP_BATCH_H

#include "common/form.h"
#include "common/method.h"
#include "mlp/layout.h"
#include "mlp/slots.h"

/* BATCH divides CHUNK. The weight gradient is summed in PARTS parts, each of every PARTS-th batch;
 * both are the same for all devices. */
#ifndef BATCH
#define BATCH 512
#endif
#ifndef PARTS
#define PARTS 64
#endif

#define ONES_ROW INPUT_DIM
#define D_INPUT_ROW (INPUT_DIM + 1)
#if USE_LOCAL
#define HIDDEN_ROW(head) (D_INPUT_ROW + (head) * 2 * HIDDEN_DIM + first_output(head))
#define BATCH_ROWS (D_INPUT_ROW + HEADS * 2 * HIDDEN_DIM + OUTPUT_ROWS)
#else
#define HIDDEN_ROW(head) (D_INPUT_ROW + FEATURE_DIM)
#define BATCH_ROWS (D_OUTPUT_ROW(0) + 7 * K_OFFSETS)
#endif
#define D_HIDDEN_ROW(head) (HIDDEN_ROW(head) + HIDDEN_DIM)
#define D_OUTPUT_ROW(head) (D_HIDDEN_ROW(head) + HIDDEN_DIM)
#define BATCH_STRIDE (BATCH + 16)
#define BATCH_SIZE ((size_t)BATCH_ROWS * BATCH_STRIDE)

/* How many samples of a batch may have gradients other than zero; they are its first ones.
 * active: samples of each chunk that draw something. */
static inline int active_samples(const int batch, const int padded, __global const int *active)
{
    const int first = batch * BATCH;
    const int end = SKIP_OPACITY_FIRST ? active[first / CHUNK] + first / CHUNK * CHUNK : padded;
    return clamp(end - first, 0, BATCH);
}

#endif
