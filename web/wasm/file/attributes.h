/* Chunks of attributes (codec_c/FORMAT.md, part 7). */
#ifndef CLGS_WEB_ATTRIBUTES_H
#define CLGS_WEB_ATTRIBUTES_H

#include "container.h"

typedef struct attributes {
    enum { RAW, TABLES, PLAIN } mode;
    size_t channels;
    void *model; /* of TABLES */
} attributes;

/* The model of a shared header, in memory that is taken. It has no known channels, whose values
 * would be read before they are set. */
problem attributes_open(span header, size_t channels, attributes *result);

/* The same of details, whose channels are pairs of a known one and another. */
problem attributes_open_details(span header, size_t channels, attributes *result);

/* The rows of a chunk, to (rows, channels) of `value`, which has known channels already, and zeros
 * in the others of details; `near` as of clgs_attributes_decode. */
problem attributes_read(const attributes *from, span data, const int32_t *near, size_t rows,
                        int32_t *value);

#endif
