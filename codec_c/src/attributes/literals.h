/* Residuals of a column as symbols, and what large ones add: literal bits, outside of any model. */
#ifndef CLGS_ATTRIBUTES_LITERALS_H
#define CLGS_ATTRIBUTES_LITERALS_H

#include "attributes/columns.h"

/* Bits packed from the lowest up. */
typedef struct clgs_literals {
    uint64_t held;
    uint32_t count;
    uint8_t *out;            /* writer */
    const uint8_t *at, *end; /* reader */
    int failed;              /* reader: there were too few */
} clgs_literals;

/* Fill the last byte up with zeros. */
void clgs_literals_end(clgs_literals *literals);

/* Whether a channel of tables has large symbols. */
int clgs_has_literals(const clgs_channel *channel);

/* Symbols of column j from its values, and the literal bits if `literals` is not NULL. */
void clgs_literals_split(clgs_columns *columns, size_t j, clgs_literals *literals);

/* Residuals of column j, from symbols and literal bits, in the place of its values. */
void clgs_literals_join(clgs_columns *columns, size_t j, clgs_literals *literals);

#endif
