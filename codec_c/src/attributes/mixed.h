/* Adaptive coding of a column's residuals: each decision's probability is mixed from nine contexts.
 */
#ifndef CLGS_ATTRIBUTES_MIXED_H
#define CLGS_ATTRIBUTES_MIXED_H

#include "attributes/columns.h"
#include "entropy/range.h"

#define CLGS_MIXED_MOST 62 /* bytes of one residual: 38 decisions of 12 bits, 26 of one */

typedef struct clgs_mixed clgs_mixed;

size_t clgs_mixed_size(void);

/* Prepare what all columns share. */
void clgs_mixed_init(clgs_mixed *mixed);

/* Code column j in the direction of `coder`. An encoder reads its values, a decoder sets values
 * and symbols. All earlier columns must be known, and their activity summed. */
void clgs_mixed_code(clgs_mixed *mixed, clgs_range *coder, clgs_columns *columns, size_t j);

#endif
