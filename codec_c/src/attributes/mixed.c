#include "attributes/mixed.h"

#include <string.h>

#include "attributes/predict.h"
#include "common/bytes.h"
#include "entropy/symbol.h"

#define QUICK_LIMIT 30
#define LIMIT 250
#define SLOW_LIMIT 1000
#define SHIFT 14
#define FIRST_WEIGHT (CLGS_WEIGHT_ONE * 16 / 100)
#define WEIGHT_SETS 4
#define NEAR 32  /* expected values within this of the centre have contexts of their own */
#define DRIFT 16 /* and averages within this of the expected value */

enum { PLAIN, QUICK, CELL, EXPECTED, OWN, CROSS, AROUND, JOINT, TREND, INPUTS };

_Static_assert(INPUTS <= CLGS_MAX_INPUTS, "a mix holds all inputs");

/* Contexts of each input, and where the first one's states are. */
static const uint16_t FIRST[INPUTS + 1] = {0, 1, 9, 73, 137, 201, 265, 329, 1353, 2377};

struct clgs_mixed {
    clgs_tables tables;
    uint32_t state[2377][CLGS_NODES];
    int32_t weight[WEIGHT_SETS][CLGS_NODES * INPUTS];
    uint16_t curve[CLGS_NODES][CLGS_CURVE_KNOTS];
};

/* A column while it is coded, and its neighbourhood. */
typedef struct walk {
    const clgs_channel *channel;
    clgs_columns *columns;
    const uint8_t *left, *further; /* symbols of the two columns before, or NULL */
    uint8_t *symbol;
    int32_t *value;
    uint32_t own[CLGS_OWN];             /* factors by row */
    int32_t before[CLGS_TAP_REACH + 1]; /* values by row */
    int32_t quick, slow;                /* averages, in 1/256 */
} walk;

size_t clgs_mixed_size(void)
{
    return sizeof(clgs_mixed);
}

void clgs_mixed_init(clgs_mixed *m)
{
    clgs_tables_init(&m->tables);
}

static void reset(clgs_mixed *m)
{
    clgs_states_init(m->state[0], sizeof m->state / sizeof m->state[0][0]);
    for (size_t set = 0; set < WEIGHT_SETS; set++)
        for (size_t i = 0; i < CLGS_NODES * INPUTS; i++)
            m->weight[set][i] = FIRST_WEIGHT;
    clgs_curves_init(m->curve[0], (size_t)CLGS_NODES * CLGS_CURVE_KNOTS, &m->tables);
}

static int32_t signed_symbol(const uint8_t *symbol, size_t i)
{
    int32_t half = symbol[i] >> 1;
    return symbol[i] & 1 ? -half - 1 : half;
}

/* `value` in [-limit, limit - 1] as a number from 0. */
static uint32_t place(int32_t value, int32_t limit)
{
    return (uint32_t)(clgs_clamp(value, -limit, limit - 1) + limit);
}

/* The contexts of row i; `expected` is what the value is likely near. */
static void find_contexts(const walk *w, size_t i, int32_t expected, uint32_t cell,
                          uint32_t context[INPUTS])
{
    size_t rows = w->columns->rows;
    int32_t one = i > 0 ? signed_symbol(w->symbol, i - 1) : 0;
    int32_t two = i > 1 ? signed_symbol(w->symbol, i - 2) : 0;
    int32_t left = w->left ? signed_symbol(w->left, i) : 0;
    int32_t further = w->further ? signed_symbol(w->further, i) : 0;
    int32_t above = w->left && i > 0 ? signed_symbol(w->left, i - 1) : 0;
    int32_t below = w->left && i + 1 < rows ? signed_symbol(w->left, i + 1) : 0;
    context[PLAIN] = 0;
    context[CELL] = cell;
    context[EXPECTED] = place(expected, NEAR);
    context[OWN] = clgs_signed_level(one) * 4 + clgs_small_level(two);
    context[CROSS] = clgs_signed_level(left) * 4 + clgs_small_level(further);
    context[AROUND] = clgs_signed_level(above + below) * 4 + clgs_small_level(one);
    context[JOINT] = context[EXPECTED] * 16 + cell % CLGS_LEVELS / 2;
    context[TREND] = place((w->quick >> 8) - expected, DRIFT) * 2 * DRIFT +
                     place((w->slow >> 8) - expected, DRIFT);
}

/* The cell of row i, from the magnitudes of the two rows before. */
static uint32_t find_cell(const walk *w, size_t i)
{
    uint32_t gain = (uint32_t)w->channel->gain;
    uint32_t one = i > 0 ? clgs_magnitude(w->symbol[i - 1], gain) : 0;
    uint32_t two = i > 1 ? clgs_magnitude(w->symbol[i - 2], gain) : 0;
    uint32_t own = (uint32_t)w->channel->weight[0] * (2 * one + two);
    return w->columns->cell[i] | clgs_level_of(w->columns, w->columns->partial[i] + own);
}

static void code_row(walk *w, clgs_mixed *m, clgs_symbol *symbol, size_t i)
{
    uint32_t context[INPUTS], cell = find_cell(w, i);
    uint32_t sum = clgs_columns_sums(w->columns)[i];
    for (int back = 1; back <= CLGS_TAP_REACH; back++)
        sum += w->own[back] * (uint32_t)w->before[back];
    if (w->own[-CLGS_TAP_NEAR])
        sum += w->own[-CLGS_TAP_NEAR] * (uint32_t)clgs_columns_around(w->columns, w->value, i);
    int32_t predicted = clgs_tap_rounded(sum);
    find_contexts(w, i, w->channel->taps > 0 ? predicted : (w->before[1] + w->before[2]) >> 1, cell,
                  context);
    context[QUICK] = clgs_tap_fraction(sum);
    for (size_t k = 0; k < INPUTS; k++)
        symbol->base[k] = m->state[FIRST[k] + context[k]];
    symbol->weight = m->weight[cell % CLGS_LEVELS / 8];
    int32_t residual = 0; /* what a decoder finds out */
    if (!symbol->mix.coder->decoding)
        residual = clgs_signed((uint32_t)w->value[i] - (uint32_t)predicted);
    residual = clgs_signed((uint32_t)clgs_symbol_value(symbol, residual));
    w->value[i] = clgs_signed((uint32_t)residual + (uint32_t)predicted);
    w->symbol[i] = clgs_symbol_of(clgs_zigzag(residual));
    w->before[3] = w->before[2];
    w->before[2] = w->before[1];
    w->before[1] = clgs_clamp(w->value[i], -CLGS_TAP_CLAMP, CLGS_TAP_CLAMP);
    w->quick += (w->before[1] * 256 - w->quick) >> 3;
    w->slow += (w->before[1] * 256 - w->slow) >> 6;
}

void clgs_mixed_code(clgs_mixed *m, clgs_range *coder, clgs_columns *columns, size_t j)
{
    const clgs_channel *channel = columns->channel + j;
    walk w = {.channel = channel,
              .columns = columns,
              .left = j > 0 ? clgs_symbols(columns, j - 1) : NULL,
              .further = j > 1 ? clgs_symbols(columns, j - 2) : NULL,
              .symbol = clgs_symbols(columns, j),
              .value = clgs_values(columns, j)};
    clgs_symbol symbol = {.mix = {.coder = coder,
                                  .tables = &m->tables,
                                  .inputs = INPUTS,
                                  .limit = {SLOW_LIMIT, QUICK_LIMIT},
                                  .shift = SHIFT},
                          .curve = m->curve[0]};
    for (size_t k = CELL; k < INPUTS; k++)
        symbol.mix.limit[k] = LIMIT;
    reset(m);
    clgs_columns_own_factors(columns, j, w.own);
    clgs_columns_add_taps(columns, j);
    clgs_columns_partial(columns, j);
    for (size_t i = 0; i < columns->rows; i++)
        code_row(&w, m, &symbol, i);
}
