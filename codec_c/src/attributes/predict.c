#include "attributes/predict.h"

#include <string.h>

#define BLOCK 2048 /* rows of which terms are summed together */
#define SIDED_BITS (CLGS_SUM_BITS - 2)

static int32_t clamp(int32_t value)
{
    return value < -CLGS_TAP_CLAMP  ? -CLGS_TAP_CLAMP
           : value > CLGS_TAP_CLAMP ? CLGS_TAP_CLAMP
                                    : value;
}

int32_t clgs_columns_around(const clgs_columns *columns, const int32_t *value, size_t i)
{
    const int32_t *near = columns->near + CLGS_NEAR * i;
    int32_t sum = 0;
    for (size_t k = 0; k < CLGS_NEAR && k < i; k++)
        sum += clamp(value[near[k]]);
    return sum;
}

static int16_t *clamped_of(const clgs_columns *columns, size_t j)
{
    return columns->clamped + j * columns->pitch;
}

/* Sum over the rows near row i of a column; the first rows have fewer. */
static inline int32_t around_of(const int32_t *near, const int16_t *clamped, size_t i)
{
    int32_t sum = 0;
    near += CLGS_NEAR * i;
    if (i >= CLGS_NEAR)
        return clamped[near[0]] + clamped[near[1]] + clamped[near[2]] + clamped[near[3]];
    for (size_t k = 0; k < i; k++)
        sum += clamped[near[k]];
    return sum;
}

void clgs_columns_serve(clgs_columns *columns, size_t j)
{
    const int32_t *value = clgs_values(columns, j);
    int32_t *around = columns->around + j * columns->pitch;
    int16_t *clamped = clamped_of(columns, j);
    for (size_t i = 0; i < columns->rows && columns->served[j]; i++)
        clamped[i] = (int16_t)clamp(value[i]);
    for (size_t i = 0; i < columns->rows && columns->served[j] == CLGS_SERVES_NEAR; i++)
        around[i] = around_of(columns->near, clamped, i);
}

/* Add a term's part to the sums of rows [first, last); rows outside of the chunk count as 0. */
static void add_tap(clgs_columns *columns, const clgs_tap *tap, size_t first, size_t last)
{
    size_t back = tap->row < 0 ? (size_t)-tap->row : 0, ahead = tap->row > 0 ? (size_t)tap->row : 0;
    const int16_t *source = clamped_of(columns, (size_t)tap->channel);
    int16_t factor = (int16_t)(tap->factor * CLGS_NEAR);
    uint32_t *sum = clgs_columns_sums(columns);
    first = first < back ? back : first;
    if (last + ahead > columns->rows)
        last = columns->rows > ahead ? columns->rows - ahead : 0;
    for (size_t i = first; i < last; i++)
        sum[i] += (uint32_t)(factor * source[i - back + ahead]);
}

static void add_near_tap(clgs_columns *columns, const clgs_tap *tap, size_t first, size_t last)
{
    const int32_t *around = columns->around + (size_t)tap->channel * columns->pitch;
    uint32_t factor = (uint32_t)tap->factor, *sum = clgs_columns_sums(columns);
    for (size_t i = first; i < last; i++)
        sum[i] += factor * (uint32_t)around[i];
}

/* Sums of the terms of column j, those of the column itself only if `own`; some rows at a time, as
 * caches hold them. */
static void add_taps(clgs_columns *columns, size_t j, int own)
{
    const clgs_channel *channel = columns->channel + j;
    size_t rows = columns->rows;
    memset(columns->residual, 0, 4 * rows);
    for (size_t first = 0; first < rows; first += BLOCK)
        for (int32_t t = 0; t < channel->taps; t++) {
            const clgs_tap *tap = channel->tap + t;
            size_t last = first + BLOCK < rows ? first + BLOCK : rows;
            if (!own && (size_t)tap->channel == j)
                continue;
            if (tap->row == CLGS_TAP_NEAR)
                add_near_tap(columns, tap, first, last);
            else
                add_tap(columns, tap, first, last);
        }
}

void clgs_columns_add_taps(clgs_columns *columns, size_t j)
{
    add_taps(columns, j, 0);
}

void clgs_columns_own_factors(const clgs_columns *columns, size_t j, uint32_t own[CLGS_OWN])
{
    const clgs_channel *channel = columns->channel + j;
    memset(own, 0, CLGS_OWN * sizeof own[0]);
    for (int32_t t = 0; t < channel->taps; t++) {
        const clgs_tap *tap = channel->tap + t;
        if ((size_t)tap->channel == j)
            own[-tap->row] += (uint32_t)tap->factor * (tap->row == CLGS_TAP_NEAR ? 1 : CLGS_NEAR);
    }
}

void clgs_columns_predict(clgs_columns *columns, size_t j)
{
    const int32_t *value = clgs_values(columns, j);
    if (columns->channel[j].taps == 0) {
        memcpy(columns->residual, value, 4 * columns->rows);
        return;
    }
    add_taps(columns, j, 1);
    const uint32_t *sum = clgs_columns_sums(columns);
    int sided = columns->channel[j].coder == CLGS_SIDED;
    for (size_t i = 0; i < columns->rows; i++)
        columns->residual[i] =
            sided ? clgs_sided(value[i], sum[i]) : clgs_tap_residual(value[i], sum[i]);
}

void clgs_columns_add_levels(clgs_columns *columns, size_t j)
{
    clgs_columns_add_taps(columns, j);
    for (size_t i = 0; i < columns->rows; i++) {
        uint32_t sum = clgs_columns_sums(columns)[i];
        uint32_t level = (clgs_signed(sum) < 0 ? 0 - sum : sum) >> SIDED_BITS;
        columns->cell[i] |= (uint8_t)(level < CLGS_LEVELS ? level : CLGS_LEVELS - 1);
    }
}

/* Values of column j, whose own terms look at near rows at most. */
static void restore_near(clgs_columns *columns, size_t j, uint32_t factor)
{
    int32_t *value = clgs_values(columns, j);
    int16_t *clamped = clamped_of(columns, j);
    const uint32_t *sum = clgs_columns_sums(columns);
    for (size_t i = 0; i < columns->rows && !factor; i++)
        value[i] = clgs_tap_value(value[i], sum[i]);
    for (size_t i = 0; i < columns->rows && factor; i++) {
        uint32_t own = factor * (uint32_t)around_of(columns->near, clamped, i);
        value[i] = clgs_tap_value(value[i], sum[i] + own);
        clamped[i] = (int16_t)clamp(value[i]);
    }
}

void clgs_columns_restore(clgs_columns *columns, size_t j)
{
    int32_t *value = clgs_values(columns, j);
    uint32_t own[CLGS_OWN], before[CLGS_TAP_REACH + 1] = {0};
    if (columns->channel[j].taps == 0)
        return;
    clgs_columns_add_taps(columns, j);
    if (columns->channel[j].coder == CLGS_SIDED) {
        for (size_t i = 0; i < columns->rows; i++)
            value[i] = clgs_sided(value[i], clgs_columns_sums(columns)[i]);
        return;
    }
    clgs_columns_own_factors(columns, j, own);
    if (!own[1] && !own[2] && !own[3]) {
        restore_near(columns, j, own[-CLGS_TAP_NEAR]);
        return;
    }
    for (size_t i = 0; i < columns->rows; i++) {
        uint32_t sum = clgs_columns_sums(columns)[i];
        for (int back = 1; back <= CLGS_TAP_REACH; back++)
            sum += own[back] * before[back];
        if (own[-CLGS_TAP_NEAR])
            sum += own[-CLGS_TAP_NEAR] * (uint32_t)clgs_columns_around(columns, value, i);
        value[i] = clgs_tap_value(value[i], sum);
        for (int back = CLGS_TAP_REACH; back > 1; back--)
            before[back] = before[back - 1];
        before[1] = (uint32_t)clamp(value[i]);
    }
}
