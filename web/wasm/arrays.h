/* Positions and attributes as bytes of their own (codec_c/FORMAT.md, part 10). */
#ifndef CLGS_WEB_ARRAYS_H
#define CLGS_WEB_ARRAYS_H

#include "attributes.h"

/* The positions of `data`, which must be `count`, to (count, 3), in Morton order. */
problem positions_read(span data, size_t count, int32_t *position);

typedef struct rows {
    size_t count, chunks;
    attributes model;
    const uint8_t *length; /* of the chunks, u32 each */
    const uint8_t *at;     /* the next chunk */
    size_t left;           /* bytes from there on */
    size_t chunk;
} rows;

/* Attributes of which there must be `count` rows of `channels`. */
problem rows_open(span data, size_t count, size_t channels, rows *result);

/* Rows of the next chunk. */
size_t rows_next(const rows *from);

/* The next chunk, to (rows_next, channels) of `value`. */
problem rows_read(rows *from, int32_t *value);

#endif
