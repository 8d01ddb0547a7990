/* Predictions of columns: sums of terms, residuals, and what terms need of the columns they look
 * at.
 */
#ifndef CLGS_ATTRIBUTES_PREDICT_H
#define CLGS_ATTRIBUTES_PREDICT_H

#include "attributes/columns.h"
#include "common/bytes.h"

/* Residuals of column j from its values, and the reverse. */
void clgs_columns_predict(clgs_columns *columns, size_t j);
void clgs_columns_restore(clgs_columns *columns, size_t j);

static inline uint32_t *clgs_columns_sums(const clgs_columns *columns)
{
    return (uint32_t *)columns->residual;
}

/* The parts of a prediction: sums over other columns, to `residual`; factors of own rows, by how
 * far back, and of own near rows at -CLGS_TAP_NEAR. Sums are in 1 / (CLGS_NEAR << FACTOR_BITS), and
 * modulo 2^32. */
#define CLGS_OWN (1 - CLGS_TAP_NEAR)
#define CLGS_SUM_BITS (CLGS_FACTOR_BITS + 2)
_Static_assert(CLGS_NEAR << CLGS_FACTOR_BITS == 1 << CLGS_SUM_BITS, "sums of near rows are means");

void clgs_columns_add_taps(clgs_columns *columns, size_t j);
void clgs_columns_own_factors(const clgs_columns *columns, size_t j, uint32_t own[CLGS_OWN]);

/* Levels of a sided column's cells: its terms in quarters. */
void clgs_columns_add_levels(clgs_columns *columns, size_t j);

/* Prepare column j, whose values must be known, for the terms that look at it. */
void clgs_columns_serve(clgs_columns *columns, size_t j);

/* Sum of the values of the rows near row i of a column. */
int32_t clgs_columns_around(const clgs_columns *columns, const int32_t *value, size_t i);

/* The prediction: a sum rounded, halves up. */
static inline int32_t clgs_tap_rounded(uint32_t sum)
{
    return clgs_signed(sum + (1 << (CLGS_SUM_BITS - 1))) >> CLGS_SUM_BITS;
}

/* What was rounded off, in eighths from -4 to 3, plus 4. */
static inline uint32_t clgs_tap_fraction(uint32_t sum)
{
    return (sum + (1 << (CLGS_SUM_BITS - 1))) >> (CLGS_SUM_BITS - 3) & 7;
}

static inline int clgs_tap_rounds_up(uint32_t sum)
{
    return !((sum + (1 << (CLGS_SUM_BITS - 1))) >> (CLGS_SUM_BITS - 1) & 1);
}

/* Of channels with tables: a value minus its prediction, or the reverse if that was rounded up: so
 * the residual's likelier sign is plus. */
static inline int32_t clgs_tap_residual(int32_t value, uint32_t sum)
{
    uint32_t off = (uint32_t)value - (uint32_t)clgs_tap_rounded(sum);
    return clgs_signed(clgs_tap_rounds_up(sum) ? 0 - off : off);
}

/* Of sided channels: the residual of a value, or the reverse. */
static inline int32_t clgs_sided(int32_t value, uint32_t sum)
{
    return clgs_signed(clgs_signed(sum) < 0 ? 0 - (uint32_t)value : (uint32_t)value);
}

/* The value of such a residual. */
static inline int32_t clgs_tap_value(int32_t residual, uint32_t sum)
{
    uint32_t off = clgs_tap_rounds_up(sum) ? 0 - (uint32_t)residual : (uint32_t)residual;
    return clgs_signed(off + (uint32_t)clgs_tap_rounded(sum));
}

#endif
