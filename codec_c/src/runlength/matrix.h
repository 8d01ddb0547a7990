/* What the two coders of whole matrices share: a mode, a centre per channel, then decisions; or,
 * if these are longer, the numbers as they are.
 */
#ifndef CLGS_RUNLENGTH_MATRIX_H
#define CLGS_RUNLENGTH_MATRIX_H

#include "entropy/range.h"

/* One stream; a coder's own struct begins with it. */
typedef struct clgs_matrix {
    clgs_range coder;
    size_t rows, channels;
    const int32_t *source; /* encoder */
    int32_t *target;       /* decoder */
    int32_t centre[CLGS_MAX_CHANNELS];
} clgs_matrix;

/* Codes all rows in the direction of the coder. */
typedef clgs_error clgs_matrix_rows(clgs_matrix *matrix);

/* Bytes that always suffice, or 0 if the shape is out of range. */
size_t clgs_matrix_bound(size_t rows, size_t channels);

/* The mean of a channel of the source, halves rounded up. */
int32_t clgs_matrix_mean(const clgs_matrix *matrix, size_t channel);

/* Whether row i of `count` channels from `channel` on equals the centres. */
int clgs_matrix_is_centre(const clgs_matrix *matrix, size_t i, size_t channel, size_t count);

/* `centre` is set; returns the bytes written, or 0 if `capacity` is too small. */
size_t clgs_matrix_encode(clgs_matrix *matrix, clgs_matrix_rows *code, uint8_t *out,
                          size_t capacity);

clgs_error clgs_matrix_decode(clgs_matrix *matrix, clgs_matrix_rows *code, const uint8_t *data,
                              size_t size);

#endif
