/* Outputs of the MLPs for VEC visible anchors. */
#ifndef CLGS_OUTPUT_ROWS_H
#define CLGS_OUTPUT_ROWS_H

#include "common/method.h"
#include "common/prefetch.h"
#include "common/real.h"

/* First rows of the heads: K opacities, 3 K colors, 7 K covariance numbers, which are for each slot
 * three scale logits and a quaternion w x y z. */
#define COLOR_ROW K_OFFSETS
#define COVARIANCE_ROW (4 * K_OFFSETS)

/* Row of number i of slot j: its opacity, three colors, seven covariance numbers. */
#define SLOT_ROWS 11
static inline size_t slot_row(const size_t j, const size_t i)
{
    return i == 0 ? j : i < 4 ? COLOR_ROW + 3 * j + i - 1 : COVARIANCE_ROW + 7 * j + i - 4;
}

/* Number (row, lane) is at[row * stride + lane]. Vectors have a private copy: rows are more than a
 * CPU's own prefetchers follow, and its cache misses overlap if all are copied at once. */
#if VEC == 1
#define ROW_SPACE __global
#else
#define ROW_SPACE __private
#endif
typedef struct {
    ROW_SPACE const float *at;
    size_t stride;
} OutputRows;

/* Declares `rows` for the columns v to v + VEC - 1 of output (OUTPUT_ROWS, stride): its rows of the
 * given slots, one per bit, from `first_row` on. */
#if VEC == 1
#define DECLARE_OUTPUT_ROWS(rows, output, stride, v, slots, first_row)                             \
    const OutputRows rows = {(output) + (v), stride}
#else
#define DECLARE_OUTPUT_ROWS(rows, output, stride, v, slots, first_row)                             \
    float rows##_copy[OUTPUT_ROWS * VEC];                                                          \
    copy_rows((output) + (v), stride, slots, first_row, rows##_copy);                              \
    const OutputRows rows = {rows##_copy, VEC}

static inline void copy_rows(__global const float *output, const size_t stride, const int slots,
                             const size_t first_row, float *copy)
{
    for (size_t j = 0; j < K_OFFSETS; ++j) {
        for (size_t i = 0; (slots >> j & 1) && i < SLOT_ROWS; ++i) {
            const size_t row = slot_row(j, i);
            if (row < first_row)
                continue;
            PREFETCH(output + row * stride + LINE);
            STORE_V(LOAD_V(0, output + row * stride), row, copy);
        }
    }
}
#endif

#endif
