/* Chunks of attributes: literal bits, then the static symbols of all channels. */
#include "attributes.h"

#include <string.h>

#include "bytes.h"
#include "rans.h"

#define PREFIX 8 /* lengths of the literals in bytes, and of the words */
#define STATES (4 * CLGS_LANES)

/* Bits packed from the lowest up. */
typedef struct bits {
    uint64_t held;
    uint32_t count;
    uint8_t *out;            /* writer */
    const uint8_t *at, *end; /* reader */
} bits;

static void put_bits(bits *b, uint32_t value, uint32_t count)
{
    b->held |= (uint64_t)(value & ((uint32_t)(((uint64_t)1 << count) - 1))) << b->count;
    for (b->count += count; b->count >= 8; b->count -= 8) {
        *b->out++ = (uint8_t)b->held;
        b->held >>= 8;
    }
}

/* The next bits, or zeros and `failed` where there are too few. */
static uint32_t get_bits(bits *b, uint32_t count, int *failed)
{
    while (b->count < count) {
        if (b->end - b->at < 1) {
            *failed = 1;
            return 0;
        }
        b->held |= (uint64_t)*b->at++ << b->count;
        b->count += 8;
    }
    uint32_t value = (uint32_t)(b->held & (((uint64_t)1 << count) - 1));
    b->held >>= count;
    b->count -= count;
    return value;
}

/* Symbol of a large zigzag number: the octave and the two bits below the top one. */
static uint32_t large_symbol(uint32_t zigzag)
{
    uint32_t top = 31;
    while (!(zigzag >> top))
        top--;
    return CLGS_DIRECT + (top - 7) * 4 + (zigzag >> (top - 2) & 3);
}

static uint32_t large_zigzag(uint32_t symbol, uint32_t literal)
{
    return (4 + (symbol - CLGS_DIRECT) % 4) << clgs_literal_bits(symbol) | literal;
}

/* Symbols of column j, and the literal bits where `literals` is not NULL. */
static void split(clgs_columns *columns, size_t j, bits *literals)
{
    uint8_t *symbol = clgs_symbols(columns, j);
    const int32_t *residual = columns->residual;
    if (!columns->apart[j])
        return;
    clgs_columns_predict(columns, j);
    for (size_t i = 0; i < columns->rows; i++) {
        uint32_t zigzag = clgs_zigzag(residual[i]);
        symbol[i] = (uint8_t)zigzag;
        if (zigzag < CLGS_DIRECT)
            continue;
        symbol[i] = (uint8_t)large_symbol(zigzag);
        if (literals)
            put_bits(literals, zigzag, clgs_literal_bits(symbol[i]));
    }
}

static int has_literals(const clgs_channel *channel)
{
    uint32_t sum = 0;
    for (int32_t k = 0; k < channel->classes; k++)
        for (uint32_t s = CLGS_DIRECT; s < CLGS_ALPHABET; s++)
            sum += channel->frequency[k][s];
    return sum > 0;
}

/* Residuals of column j, from symbols and literal bits, to where its values will be. */
static void join(clgs_columns *columns, size_t j, bits *literals, int *failed)
{
    const uint8_t *symbol = clgs_symbols(columns, j);
    int32_t *value = clgs_values(columns, j);
    columns->apart[j] |= (uint8_t)has_literals(columns->channel + j);
    if (!columns->apart[j])
        return;
    for (size_t i = 0; i < columns->rows; i++) {
        uint32_t zigzag = symbol[i];
        if (zigzag >= CLGS_DIRECT)
            zigzag = large_zigzag(zigzag, get_bits(literals, clgs_literal_bits(zigzag), failed));
        value[i] = clgs_signed(zigzag & 1 ? ~(zigzag >> 1) : zigzag >> 1);
    }
}

static size_t cell_count(size_t rows, size_t channels)
{
    int fits = rows <= CLGS_MAX_POINTS && channels >= 1 && channels <= CLGS_MAX_CHANNELS;
    return fits ? rows * channels : 0;
}

/* Words of the coder and cells of all columns, behind the columns. */
static size_t staging_size(size_t cells)
{
    return 2 * cells + cells + 2 * STATES;
}

size_t clgs_attributes_bound(size_t rows, size_t channels)
{
    return PREFIX + STATES + 6 * cell_count(rows, channels) + 8;
}

size_t clgs_attributes_workspace(size_t rows, size_t channels)
{
    if (cell_count(rows, channels) == 0 && rows > 0)
        return 0;
    return clgs_columns_size(rows, channels) + staging_size(rows * channels) +
           CLGS_RANS_ENCODER_SIZE + CLGS_RANS_DECODER_SIZE;
}

/* Symbols, cells and literals of all columns; returns the bytes of literals. */
static size_t stage(clgs_columns *columns, uint8_t *cells, uint8_t *out)
{
    bits literals = {.out = out};
    for (size_t j = 0; j < columns->channels; j++) {
        split(columns, j, &literals);
        if (columns->channel[j].classes > 1) {
            clgs_columns_cells(columns, j);
            memcpy(cells + j * columns->rows, columns->cell, columns->rows);
        }
        clgs_columns_activate(columns, j);
    }
    put_bits(&literals, 0, (8 - literals.count) % 8);
    return (size_t)(literals.out - out);
}

static void store_words(uint8_t *out, const uint16_t *word, size_t words)
{
    for (size_t i = 0; i < words; i++) {
        out[2 * i] = (uint8_t)word[i];
        out[2 * i + 1] = (uint8_t)(word[i] >> 8);
    }
}

size_t clgs_attributes_encode(const void *model, const int32_t *value, size_t rows, size_t channels,
                              uint8_t *out, size_t capacity, void *workspace)
{
    clgs_columns columns = {.channel = model, .rows = rows, .channels = channels};
    clgs_rans_encoder coder;
    size_t cells = cell_count(rows, channels);
    if (cells == 0 || capacity < clgs_attributes_bound(rows, channels) ||
        !clgs_model_valid(model, channels))
        return 0;
    coder.table = (clgs_rans_symbol *)clgs_columns_place(&columns, workspace);
    uint16_t *first = (uint16_t *)((uint8_t *)coder.table + CLGS_RANS_ENCODER_SIZE);
    uint16_t *last = first + cells + CLGS_LANES;
    uint8_t *cell = (uint8_t *)last;
    clgs_columns_load(&columns, value);
    size_t literals = stage(&columns, cell, out + PREFIX);
    coder.word = last;
    for (size_t lane = 0; lane < CLGS_LANES; lane++)
        coder.state[lane] = CLGS_RANS_LOW;
    for (size_t j = channels; j-- > 0;)
        if (!clgs_rans_encode(&coder, &columns, j,
                              columns.channel[j].classes > 1 ? cell + j * rows : NULL))
            return 0;
    size_t words = (size_t)(last - coder.word);
    clgs_store32(out, (uint32_t)literals);
    clgs_store32(out + 4, (uint32_t)words);
    uint8_t *at = out + PREFIX + literals;
    for (size_t lane = 0; lane < CLGS_LANES; lane++)
        clgs_store32(at + 4 * lane, coder.state[lane]);
    store_words(at + STATES, coder.word, words);
    return PREFIX + literals + STATES + 2 * words;
}

static clgs_error finish(const clgs_rans_decoder *coder, const bits *literals, int failed)
{
    if (coder->failed || failed)
        return CLGS_ERROR_TRUNCATED;
    if (coder->word != coder->end || literals->at != literals->end)
        return CLGS_ERROR_TRAILING;
    uint32_t wrong = literals->held != 0;
    for (size_t lane = 0; lane < CLGS_LANES; lane++)
        wrong |= coder->state[lane] ^ CLGS_RANS_LOW;
    return wrong ? CLGS_ERROR_CORRUPT : CLGS_OK;
}

static clgs_error decode_columns(clgs_columns *columns, clgs_rans_decoder *coder, bits *literals)
{
    int failed = 0;
    for (size_t j = 0; j < columns->channels; j++) {
        const clgs_channel *channel = columns->channel + j;
        if (channel->classes > 1 && channel->weight[0])
            clgs_columns_partial(columns, j);
        else if (channel->classes > 1)
            clgs_columns_cells(columns, j);
        clgs_rans_decode(coder, columns, j);
        join(columns, j, literals, &failed);
        if (coder->failed || failed)
            return CLGS_ERROR_TRUNCATED;
        clgs_columns_restore(columns, j);
        clgs_columns_activate(columns, j);
    }
    return finish(coder, literals, failed);
}

clgs_error clgs_attributes_decode(const void *model, const uint8_t *data, size_t size,
                                  int32_t *value, size_t rows, size_t channels, void *workspace)
{
    clgs_columns columns = {.channel = model, .rows = rows, .channels = channels};
    clgs_rans_decoder coder = {.failed = 0};
    if (cell_count(rows, channels) == 0 || !clgs_model_valid(model, channels))
        return CLGS_ERROR_ARGUMENT;
    if (size < PREFIX + STATES)
        return CLGS_ERROR_TRUNCATED;
    size_t literals = clgs_load32(data), words = clgs_load32(data + 4);
    size_t left = size - PREFIX - STATES;
    if (literals > left || words > (left - literals) / 2)
        return CLGS_ERROR_TRUNCATED;
    if (literals + 2 * words != left)
        return CLGS_ERROR_TRAILING;
    const uint8_t *states = data + PREFIX + literals;
    for (size_t lane = 0; lane < CLGS_LANES; lane++) {
        coder.state[lane] = clgs_load32(states + 4 * lane);
        if (coder.state[lane] < CLGS_RANS_LOW)
            return CLGS_ERROR_CORRUPT;
    }
    bits reader = {.at = data + PREFIX, .end = states};
    coder.word = states + STATES;
    coder.end = coder.word + 2 * words;
    coder.table = (uint32_t *)clgs_columns_place(&columns, workspace);
    clgs_error error = decode_columns(&columns, &coder, &reader);
    if (error == CLGS_OK)
        clgs_columns_store(&columns, value);
    return error;
}

/* Count symbols alone; four tables in turn, because a counter cannot grow every cycle. */
static void count_symbols(const uint8_t *symbol, size_t rows, uint32_t *count)
{
    uint32_t part[4][CLGS_TABLE] = {{0}};
    for (size_t i = 0; i < rows; i++)
        part[i & 3][symbol[i]]++;
    for (size_t s = 0; s < CLGS_TABLE; s++)
        count[s] += part[0][s] + part[1][s] + part[2][s] + part[3][s];
}

clgs_error clgs_attributes_count(const void *model, const int32_t *value, size_t rows,
                                 size_t channels, uint32_t *count, void *workspace)
{
    clgs_columns columns = {.channel = model, .rows = rows, .channels = channels};
    if (cell_count(rows, channels) == 0 || !clgs_model_valid(model, channels))
        return CLGS_ERROR_ARGUMENT;
    clgs_columns_place(&columns, workspace);
    clgs_columns_load(&columns, value);
    for (size_t j = 0; j < channels; j++) {
        const clgs_channel *channel = columns.channel + j;
        const uint8_t *symbol = clgs_symbols(&columns, j);
        uint32_t *own = count + j * CLGS_CELLS * CLGS_TABLE;
        split(&columns, j, NULL);
        if (!clgs_has_cells(channel)) {
            count_symbols(symbol, rows, own);
        } else {
            clgs_columns_cells(&columns, j);
            for (size_t i = 0; i < rows; i++)
                own[columns.cell[i] * CLGS_TABLE + symbol[i]]++;
        }
        clgs_columns_activate(&columns, j);
    }
    return CLGS_OK;
}
