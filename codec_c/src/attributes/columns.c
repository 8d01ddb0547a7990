#include "attributes/columns.h"

#include <string.h>

#include "attributes/predict.h"
#include "common/bytes.h"

#define TILE 64 /* rows that are transposed together, a multiple of 8 */

/* Activities from which on the next level holds: 4 * 2^(i / 4), rounded. */
static const uint16_t THRESHOLD[CLGS_LEVELS - 1] = {
    4,  5,  6,  7,   8,   10,  11,  13,  16,  19,  23,  27,  32,  38,  45,  54,
    64, 76, 91, 108, 128, 152, 181, 215, 256, 304, 362, 431, 512, 609, 724,
};

static size_t aligned(size_t size)
{
    return (size + 63) & ~(size_t)63;
}

/* Bytes from row to row of a tile. */
static size_t stride(size_t channels)
{
    return (channels + 7) & ~(size_t)7;
}

size_t clgs_pitch(size_t rows)
{
    return (rows + 63) / 64 * 64 | 64;
}

size_t clgs_columns_size(size_t rows, size_t channels)
{
    size_t cells = clgs_pitch(rows) * channels;
    return 2 * aligned(4 * cells) + aligned(2 * cells) + aligned(cells) + 2 * aligned(4 * rows) +
           aligned(rows) + aligned(4 * CLGS_NEAR * rows) + aligned(2 * (rows + 2)) +
           aligned(CLGS_MAX_ACTIVITY + 1) + TILE * stride(channels);
}

static void *take(uint8_t **memory, size_t size)
{
    void *block = *memory;
    *memory += aligned(size);
    return block;
}

/* Columns whose values are needed: those with a prediction, and those that serve one. */
static void find_apart(clgs_columns *columns)
{
    memset(columns->apart, 0, sizeof columns->apart);
    memset(columns->served, 0, sizeof columns->served);
    for (size_t j = 0; j < columns->channels; j++) {
        const clgs_channel *channel = columns->channel + j;
        columns->apart[j] |= channel->taps > 0 || channel->coder == CLGS_MIXED;
        for (int32_t t = 0; t < channel->taps; t++) {
            const clgs_tap *tap = channel->tap + t;
            columns->apart[tap->channel] = 1;
            columns->served[tap->channel] |=
                tap->row == CLGS_TAP_NEAR ? CLGS_SERVES_NEAR : CLGS_SERVES;
        }
    }
}

/* The rows before each row as its near ones. */
static void fill_rows_before(int32_t *near, size_t rows)
{
    for (size_t i = 0; i < rows; i++)
        for (size_t k = 0; k < CLGS_NEAR; k++)
            near[CLGS_NEAR * i + k] = (int32_t)i - (int32_t)k - 1;
}

/* Whether all near rows are earlier ones; the first rows have as many as there are. */
static int near_valid(const int32_t *near, size_t rows)
{
    uint32_t wrong = 0;
    for (size_t i = 1; i < rows; i++)
        for (size_t k = 0; k < CLGS_NEAR; k++)
            wrong |= k < i && (uint32_t)near[CLGS_NEAR * i + k] >= i;
    return !wrong;
}

static int looks_near(const clgs_columns *columns)
{
    for (size_t j = 0; j < columns->channels; j++)
        for (int32_t t = 0; t < columns->channel[j].taps; t++)
            if (columns->channel[j].tap[t].row == CLGS_TAP_NEAR)
                return 1;
    return 0;
}

uint8_t *clgs_columns_place(clgs_columns *columns, void *memory)
{
    uint8_t *next = memory;
    size_t rows = columns->rows, cells = clgs_pitch(rows) * columns->channels;
    columns->lanes = rows < CLGS_LONG_ROWS ? 1 : CLGS_LANES;
    columns->pitch = clgs_pitch(rows);
    columns->value = take(&next, 4 * cells);
    columns->around = take(&next, 4 * cells);
    columns->clamped = take(&next, 2 * cells);
    columns->symbol = take(&next, cells);
    columns->residual = take(&next, 4 * rows);
    columns->partial = take(&next, 4 * rows);
    columns->cell = take(&next, rows);
    columns->rows_before = take(&next, 4 * CLGS_NEAR * rows);
    columns->activity = (uint16_t *)take(&next, 2 * (rows + 2)) + 1;
    columns->level = take(&next, CLGS_MAX_ACTIVITY + 1);
    columns->tile = take(&next, TILE * stride(columns->channels));
    find_apart(columns);
    if (looks_near(columns)) {
        if (!columns->near)
            fill_rows_before(columns->rows_before, rows);
        else if (!near_valid(columns->near, rows))
            return NULL;
        columns->near = columns->near ? columns->near : columns->rows_before;
    }
    memset(columns->activity - 1, 0, 2 * (rows + 2));
    for (uint32_t activity = 0, level = 0; activity <= CLGS_MAX_ACTIVITY; activity++) {
        while (level < CLGS_LEVELS - 1 && THRESHOLD[level] <= activity)
            level++;
        columns->level[activity] = (uint8_t)level;
    }
    return next;
}

static uint64_t load64(const uint8_t *at)
{
    return (uint64_t)clgs_load32(at) | (uint64_t)clgs_load32(at + 4) << 32;
}

static void store64(uint8_t *at, uint64_t value)
{
    clgs_store32(at, (uint32_t)value);
    clgs_store32(at + 4, (uint32_t)(value >> 32));
}

/* Swap the parts of a and b that `mask` marks, those of a `shift` bits higher. */
static void swap_parts(uint64_t *a, uint64_t *b, uint32_t shift, uint64_t mask)
{
    uint64_t both = (*a >> shift ^ *b) & mask;
    *a ^= both << shift;
    *b ^= both;
}

/* An 8 x 8 block of bytes, rows `from_stride` apart, to its transpose. */
static void transpose8(const uint8_t *from, size_t from_stride, uint8_t *to, size_t to_stride)
{
    uint64_t row[8];
    for (size_t i = 0; i < 8; i++)
        row[i] = load64(from + i * from_stride);
    for (size_t i = 0; i < 4; i++)
        swap_parts(row + i, row + i + 4, 32, 0x00000000FFFFFFFFu);
    for (size_t i = 0; i < 8; i += i % 2 ? 3 : 1)
        swap_parts(row + i, row + i + 2, 16, 0x0000FFFF0000FFFFu);
    for (size_t i = 0; i < 8; i += 2)
        swap_parts(row + i, row + i + 1, 8, 0x00FF00FF00FF00FFu);
    for (size_t i = 0; i < 8; i++)
        store64(to + i * to_stride, row[i]);
}

/* Transpose bytes (rows, columns) between matrices of the given strides. */
static void transpose(const uint8_t *from, size_t from_stride, uint8_t *to, size_t to_stride,
                      size_t rows, size_t columns)
{
    for (size_t j = 0; j < columns; j += 8)
        for (size_t i = 0; i < rows; i += 8) {
            const uint8_t *block = from + i * from_stride + j;
            uint8_t *target = to + j * to_stride + i;
            if (i + 8 <= rows && j + 8 <= columns) {
                transpose8(block, from_stride, target, to_stride);
                continue;
            }
            for (size_t r = i; r < rows && r < i + 8; r++)
                for (size_t c = j; c < columns && c < j + 8; c++)
                    to[c * to_stride + r] = from[r * from_stride + c];
        }
}

/* Zigzag numbers of a row to bytes; their bits to `all`. */
static void load_row(const int32_t *value, const int32_t *centre, size_t channels, uint8_t *symbol,
                     uint32_t *all)
{
    for (size_t j = 0; j < channels; j++) {
        uint32_t zigzag = clgs_zigzag(clgs_signed((uint32_t)value[j] - (uint32_t)centre[j]));
        symbol[j] = (uint8_t)zigzag;
        all[j] |= zigzag;
    }
}

static void load_column(clgs_columns *columns, size_t j)
{
    int32_t *column = clgs_values(columns, j);
    uint32_t centre = (uint32_t)columns->channel[j].centre;
    for (size_t i = 0; i < columns->rows; i++)
        column[i] = clgs_signed((uint32_t)columns->source[i * columns->channels + j] - centre);
}

void clgs_columns_load(clgs_columns *columns, const int32_t *value)
{
    size_t rows = columns->rows, channels = columns->channels, step = stride(channels);
    int32_t centre[CLGS_MAX_CHANNELS];
    columns->source = value;
    memset(columns->zigzag, 0, sizeof columns->zigzag);
    for (size_t j = 0; j < channels; j++)
        centre[j] = columns->channel[j].centre;
    for (size_t first = 0; first < rows; first += TILE) {
        size_t count = first + TILE < rows ? TILE : rows - first;
        for (size_t i = 0; i < count; i++)
            load_row(value + (first + i) * channels, centre, channels, columns->tile + i * step,
                     columns->zigzag);
        transpose(columns->tile, step, columns->symbol + first, columns->pitch, count, channels);
    }
    for (size_t j = 0; j < channels; j++) {
        columns->apart[j] |= columns->zigzag[j] >= CLGS_DIRECT;
        if (columns->apart[j])
            load_column(columns, j);
    }
}

static void store_row(const uint8_t *symbol, const int32_t *centre, size_t channels, int32_t *value)
{
    for (size_t j = 0; j < channels; j++) {
        uint32_t s = symbol[j];
        value[j] = clgs_signed((uint32_t)centre[j] + (s >> 1 ^ (0u - (s & 1))));
    }
}

void clgs_columns_store(const clgs_columns *columns, int32_t *value)
{
    size_t rows = columns->rows, channels = columns->channels, step = stride(channels);
    int32_t centre[CLGS_MAX_CHANNELS];
    for (size_t j = 0; j < channels; j++)
        centre[j] = columns->channel[j].centre;
    for (size_t first = 0; first < rows; first += TILE) {
        size_t count = first + TILE < rows ? TILE : rows - first;
        transpose(columns->symbol + first, columns->pitch, columns->tile, step, channels, count);
        for (size_t i = 0; i < count; i++)
            store_row(columns->tile + i * step, centre, channels, value + (first + i) * channels);
    }
    for (size_t j = 0; j < channels; j++)
        for (size_t i = 0; i < rows && columns->apart[j]; i++)
            value[i * channels + j] =
                clgs_signed((uint32_t)clgs_values(columns, j)[i] + (uint32_t)centre[j]);
}

void clgs_columns_partial(clgs_columns *columns, size_t j)
{
    const clgs_channel *channel = columns->channel + j;
    size_t rows = columns->rows;
    const uint16_t *activity = columns->activity;
    uint32_t here = (uint32_t)channel->weight[1], around = (uint32_t)channel->weight[2];
    for (size_t i = 0; i < rows; i++)
        columns->partial[i] =
            activity[i] * here + ((uint32_t)activity[(ptrdiff_t)i - 1] + activity[i + 1]) * around;
    memset(columns->cell, 0, rows);
    for (size_t back = 1; back <= (size_t)channel->span; back++) {
        const uint8_t *symbol = clgs_symbols(columns, j - back);
        for (size_t i = 0; i < rows; i++)
            columns->cell[i] |= symbol[i] ? CLGS_LEVELS : 0;
    }
}

/* Cells of rows [first, last): their own part looks no further back than `first`. */
static void own_cells(clgs_columns *columns, size_t j, size_t first, size_t last)
{
    const clgs_channel *channel = columns->channel + j;
    const uint8_t *symbol = clgs_symbols(columns, j);
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
    if (columns->channel[j].coder == CLGS_SIDED)
        clgs_columns_add_levels(columns, j);
    else if (weight[0])
        for (size_t lane = 0; lane < columns->lanes; lane++)
            own_cells(columns, j, clgs_lane_start(columns, lane),
                      clgs_lane_start(columns, lane + 1));
    else if (weight[1] || weight[2])
        for (size_t i = 0; i < columns->rows; i++)
            columns->cell[i] |= clgs_level_of(columns, columns->partial[i]);
}

void clgs_columns_activate(clgs_columns *columns, size_t j)
{
    const uint8_t *symbol = clgs_symbols(columns, j);
    uint32_t gain = (uint32_t)columns->channel[j].gain;
    uint8_t magnitude[CLGS_TABLE];
    if (gain == 0)
        return;
    for (uint32_t s = 0; s < CLGS_TABLE; s++)
        magnitude[s] = (uint8_t)clgs_magnitude(s, gain);
    for (size_t i = 0; i < columns->rows; i++)
        columns->activity[i] = (uint16_t)(columns->activity[i] + magnitude[symbol[i]]);
}
