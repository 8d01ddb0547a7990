#include "columns.h"

#include <string.h>

#define TILE 16 /* rows that are transposed together */

/* Activities from which on the next level holds: 4 * 2^(i / 4), rounded. */
static const uint16_t THRESHOLD[CLGS_LEVELS - 1] = {
    4,  5,  6,  7,   8,   10,  11,  13,  16,  19,  23,  27,  32,  38,  45,  54,
    64, 76, 91, 108, 128, 152, 181, 215, 256, 304, 362, 431, 512, 609, 724,
};

static size_t aligned(size_t size)
{
    return (size + 63) & ~(size_t)63;
}

size_t clgs_columns_size(size_t rows, size_t channels)
{
    size_t cells = rows * channels;
    return aligned(4 * cells) + aligned(cells) + 2 * aligned(4 * rows) + aligned(rows) +
           aligned(2 * (rows + 2)) + aligned(CLGS_MAX_ACTIVITY + 1);
}

static void *take(uint8_t **memory, size_t size)
{
    void *block = *memory;
    *memory += aligned(size);
    return block;
}

uint8_t *clgs_columns_place(clgs_columns *columns, void *memory)
{
    uint8_t *next = memory;
    size_t rows = columns->rows, cells = rows * columns->channels;
    columns->value = take(&next, 4 * cells);
    columns->symbol = take(&next, cells);
    columns->residual = take(&next, 4 * rows);
    columns->partial = take(&next, 4 * rows);
    columns->cell = take(&next, rows);
    columns->activity = (uint16_t *)take(&next, 2 * (rows + 2)) + 1;
    columns->level = take(&next, CLGS_MAX_ACTIVITY + 1);
    memset(columns->activity - 1, 0, 2 * (rows + 2));
    for (uint32_t activity = 0, level = 0; activity <= CLGS_MAX_ACTIVITY; activity++) {
        while (level < CLGS_LEVELS - 1 && THRESHOLD[level] <= activity)
            level++;
        columns->level[activity] = (uint8_t)level;
    }
    return next;
}

/* int32 of a difference or sum modulo 2^32, as a two's complement machine has it. */
static int32_t wrap(uint32_t value)
{
    int32_t result;
    memcpy(&result, &value, sizeof result);
    return result;
}

void clgs_columns_load(clgs_columns *columns, const int32_t *value)
{
    size_t rows = columns->rows, channels = columns->channels;
    for (size_t first = 0; first < rows; first += TILE) {
        size_t last = first + TILE < rows ? first + TILE : rows;
        for (size_t j = 0; j < channels; j++) {
            uint32_t centre = (uint32_t)columns->channel[j].centre;
            int32_t *column = columns->value + j * rows;
            for (size_t i = first; i < last; i++)
                column[i] = wrap((uint32_t)value[i * channels + j] - centre);
        }
    }
}

void clgs_columns_store(const clgs_columns *columns, int32_t *value)
{
    size_t rows = columns->rows, channels = columns->channels;
    for (size_t first = 0; first < rows; first += TILE) {
        size_t last = first + TILE < rows ? first + TILE : rows;
        for (size_t j = 0; j < channels; j++) {
            uint32_t centre = (uint32_t)columns->channel[j].centre;
            const int32_t *column = columns->value + j * rows;
            for (size_t i = first; i < last; i++)
                value[i * channels + j] = wrap((uint32_t)column[i] + centre);
        }
    }
}

static int32_t clamp(int32_t value)
{
    return value < -CLGS_TAP_CLAMP  ? -CLGS_TAP_CLAMP
           : value > CLGS_TAP_CLAMP ? CLGS_TAP_CLAMP
                                    : value;
}

/* Add a term's part to the sums in `residual`; rows outside of the chunk count as 0. */
static void add_tap(clgs_columns *columns, const clgs_tap *tap)
{
    size_t rows = columns->rows, back = tap->row < 0 ? (size_t)-tap->row : 0;
    size_t ahead = tap->row > 0 ? (size_t)tap->row : 0;
    const int32_t *source = columns->value + (size_t)tap->channel * rows;
    if (back + ahead >= rows)
        return;
    for (size_t i = 0; i < rows - back - ahead; i++)
        columns->residual[i + back] += tap->factor * clamp(source[i + ahead]);
}

/* Sums of the terms of column j, those of the column itself only where `own`. */
static void add_taps(clgs_columns *columns, size_t j, int own)
{
    const clgs_channel *channel = columns->channel + j;
    memset(columns->residual, 0, 4 * columns->rows);
    for (int32_t t = 0; t < channel->taps; t++)
        if (own || (size_t)channel->tap[t].channel != j)
            add_tap(columns, channel->tap + t);
}

static uint32_t rounded(int32_t sum)
{
    return (uint32_t)((sum + (1 << (CLGS_FACTOR_BITS - 1))) >> CLGS_FACTOR_BITS);
}

void clgs_columns_predict(clgs_columns *columns, size_t j)
{
    const int32_t *value = columns->value + j * columns->rows;
    if (columns->channel[j].taps == 0) {
        memcpy(columns->residual, value, 4 * columns->rows);
        return;
    }
    add_taps(columns, j, 1);
    for (size_t i = 0; i < columns->rows; i++)
        columns->residual[i] = wrap((uint32_t)value[i] - rounded(columns->residual[i]));
}

void clgs_columns_restore(clgs_columns *columns, size_t j)
{
    const clgs_channel *channel = columns->channel + j;
    int32_t *value = columns->value + j * columns->rows, own[CLGS_TAP_REACH + 1] = {0};
    int32_t before[CLGS_TAP_REACH + 1] = {0};
    if (channel->taps == 0)
        return;
    add_taps(columns, j, 0);
    for (int32_t t = 0; t < channel->taps; t++)
        if ((size_t)channel->tap[t].channel == j)
            own[-channel->tap[t].row] += channel->tap[t].factor;
    for (size_t i = 0; i < columns->rows; i++) {
        int32_t sum = columns->residual[i];
        for (int back = 1; back <= CLGS_TAP_REACH; back++)
            sum += own[back] * before[back];
        value[i] = wrap((uint32_t)value[i] + rounded(sum));
        for (int back = CLGS_TAP_REACH; back > 1; back--)
            before[back] = before[back - 1];
        before[1] = clamp(value[i]);
    }
}

void clgs_columns_partial(clgs_columns *columns, size_t j)
{
    const clgs_channel *channel = columns->channel + j;
    size_t rows = columns->rows;
    const uint16_t *activity = columns->activity;
    const uint8_t *symbol = columns->symbol + j * rows;
    uint32_t here = (uint32_t)channel->weight[1], beside = (uint32_t)channel->weight[2];
    for (size_t i = 0; i < rows; i++)
        columns->partial[i] =
            activity[i] * here + ((uint32_t)activity[(ptrdiff_t)i - 1] + activity[i + 1]) * beside;
    memset(columns->cell, 0, rows);
    for (size_t back = 1; back <= (size_t)channel->span; back++)
        for (size_t i = 0; i < rows; i++)
            columns->cell[i] |= symbol[(ptrdiff_t)i - (ptrdiff_t)(back * rows)] ? CLGS_LEVELS : 0;
}

/* Cells of rows [first, last): their own part looks no further back than `first`. */
static void own_cells(clgs_columns *columns, size_t j, size_t first, size_t last)
{
    const clgs_channel *channel = columns->channel + j;
    const uint8_t *symbol = columns->symbol + j * columns->rows;
    uint32_t weight = (uint32_t)channel->weight[0], gain = (uint32_t)channel->gain;
    uint32_t one = 0, two = 0;
    for (size_t i = first; i < last; i++) {
        columns->cell[i] |= clgs_level_of(columns, columns->partial[i] + weight * (2 * one + two));
        two = one;
        one = clgs_magnitude(symbol[i], gain);
    }
}

void clgs_columns_cells(clgs_columns *columns, size_t j)
{
    const int32_t *weight = columns->channel[j].weight;
    clgs_columns_partial(columns, j);
    if (weight[0])
        for (size_t lane = 0; lane < CLGS_LANES; lane++)
            own_cells(columns, j, clgs_lane_start(columns->rows, lane),
                      clgs_lane_start(columns->rows, lane + 1));
    else if (weight[1] || weight[2])
        for (size_t i = 0; i < columns->rows; i++)
            columns->cell[i] |= clgs_level_of(columns, columns->partial[i]);
}

void clgs_columns_activate(clgs_columns *columns, size_t j)
{
    const uint8_t *symbol = columns->symbol + j * columns->rows;
    uint32_t gain = (uint32_t)columns->channel[j].gain;
    uint8_t magnitude[CLGS_TABLE];
    if (gain == 0)
        return;
    for (uint32_t s = 0; s < CLGS_TABLE; s++)
        magnitude[s] = (uint8_t)clgs_magnitude(s, gain);
    for (size_t i = 0; i < columns->rows; i++)
        columns->activity[i] = (uint16_t)(columns->activity[i] + magnitude[symbol[i]]);
}
