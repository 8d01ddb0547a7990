/* Static rANS: 32-bit states, one per lane, 12-bit frequencies, 16-bit words.
 *
 * Several states begin at CLGS_RANS_LOW and take four bytes each. A single one begins at 1, stays
 * small until there is a first word, and takes the bytes that it has: a short stream is all
 * content.
 */
#ifndef CLGS_ATTRIBUTES_RANS_H
#define CLGS_ATTRIBUTES_RANS_H

#include "attributes/columns.h"

#define CLGS_RANS_LOW ((uint32_t)1 << 16) /* states are at least this once there are words */

/* How to code one symbol: x -> x + start + (x / frequency) * complement. */
typedef struct clgs_rans_symbol {
    uint64_t reciprocal; /* x / frequency = x * reciprocal >> CLGS_RANS_SHIFT; 0: no such symbol */
    uint32_t most;       /* larger states give up a word first */
    uint16_t complement; /* SCALE - frequency */
    uint16_t start;
} clgs_rans_symbol;

/* Bytes for the tables of one channel. */
#define CLGS_RANS_ENCODER_SIZE (CLGS_CLASSES * CLGS_TABLE * sizeof(clgs_rans_symbol))
#define CLGS_RANS_DECODER_SIZE (CLGS_CLASSES * CLGS_SCALE * sizeof(uint32_t))

typedef struct clgs_rans_encoder {
    size_t lanes;
    uint32_t state[CLGS_LANES];
    uint16_t *word, *end; /* the last one written; they are written from the end */
    clgs_rans_symbol *table;
} clgs_rans_encoder;

typedef struct clgs_rans_decoder {
    size_t lanes;
    uint32_t state[CLGS_LANES];
    const uint8_t *word, *end; /* two bytes each, little-endian */
    uint32_t *table;
    int failed;
} clgs_rans_decoder;

/* `table` and `end`: memory for tables, and the end of that for words. */
void clgs_rans_begin_encode(clgs_rans_encoder *coder, size_t lanes, clgs_rans_symbol *table,
                            uint16_t *end);

/* Bytes of states and words. */
size_t clgs_rans_size(const clgs_rans_encoder *coder);

/* Write states and words; returns their end. */
uint8_t *clgs_rans_end_encode(const clgs_rans_encoder *coder, uint8_t *out);

/* Find states and words, which are all that lies in [at, end). */
clgs_error clgs_rans_begin_decode(clgs_rans_decoder *coder, size_t lanes, const uint8_t *at,
                                  const uint8_t *end);

/* Whether the states are those that an encoder begins with. */
int clgs_rans_finished(const clgs_rans_decoder *coder);

/* Code the symbols of column j in reverse order. `cell` is NULL if there is one class.
 * Returns 0 if a symbol has no frequency. */
int clgs_rans_encode(clgs_rans_encoder *coder, const clgs_columns *columns, size_t j,
                     const uint8_t *cell);

/* Decode the symbols of column j; classes from `columns->cell` and, if the channel weighs its
 * own column, from the symbols before. Sets `failed` if words are lacking. */
void clgs_rans_decode(clgs_rans_decoder *coder, clgs_columns *columns, size_t j);

#endif
