/* Chunks of attributes: literal bits, static symbols, then the decisions of mixed channels. */
#include "attributes.h"

#include <string.h>

#include "bytes.h"
#include "mixed.h"
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
        symbol[i] = clgs_symbol_of(zigzag);
        if (literals && zigzag >= CLGS_DIRECT)
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
    return 2 * (cells + CLGS_LANES) + cells;
}

static size_t mixed_channels(const clgs_channel *channel, size_t channels)
{
    size_t count = 0;
    for (size_t j = 0; j < channels; j++)
        count += channel[j].coder == CLGS_MIXED;
    return count;
}

size_t clgs_attributes_bound(const void *model, size_t rows, size_t channels)
{
    if (cell_count(rows, channels) == 0)
        return 0;
    size_t mixed = mixed_channels(model, channels);
    return PREFIX + STATES + 6 * rows * (channels - mixed) + 8 + CLGS_MIXED_MOST * rows * mixed +
           12;
}

/* Parts of the workspace; `words` and `cell` are an encoder's. */
typedef struct parts {
    void *tables;
    clgs_mixed *mixed;
    uint16_t *words, *words_end;
    uint8_t *cell;
} parts;

#define TABLES_SIZE (CLGS_RANS_ENCODER_SIZE + CLGS_RANS_DECODER_SIZE)

size_t clgs_attributes_workspace(size_t rows, size_t channels)
{
    if (cell_count(rows, channels) == 0)
        return 0;
    return clgs_columns_size(rows, channels) + TABLES_SIZE + clgs_mixed_size() +
           staging_size(rows * channels);
}

static parts place(clgs_columns *columns, void *workspace)
{
    uint8_t *next = clgs_columns_place(columns, workspace);
    size_t cells = columns->rows * columns->channels;
    parts p = {.tables = next, .mixed = (clgs_mixed *)(next + TABLES_SIZE)};
    p.words = (uint16_t *)(next + TABLES_SIZE + clgs_mixed_size());
    p.words_end = p.words + cells + CLGS_LANES;
    p.cell = (uint8_t *)p.words_end;
    return p;
}

/* Symbols, cells and literals of all columns; returns the bytes of literals. */
static size_t stage(clgs_columns *columns, uint8_t *cells, uint8_t *out)
{
    bits literals = {.out = out};
    for (size_t j = 0; j < columns->channels; j++) {
        split(columns, j, columns->channel[j].coder == CLGS_STATIC ? &literals : NULL);
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

/* States and words of all static columns; the bytes, or 0 where a symbol has no frequency. */
static size_t encode_static(const clgs_columns *columns, const parts *p, uint8_t *out,
                            uint32_t *words)
{
    clgs_rans_encoder coder = {.word = p->words_end, .table = p->tables};
    for (size_t lane = 0; lane < CLGS_LANES; lane++)
        coder.state[lane] = CLGS_RANS_LOW;
    for (size_t j = columns->channels; j-- > 0;) {
        const clgs_channel *channel = columns->channel + j;
        const uint8_t *cell = channel->classes > 1 ? p->cell + j * columns->rows : NULL;
        if (channel->coder == CLGS_STATIC && !clgs_rans_encode(&coder, columns, j, cell))
            return 0;
    }
    for (size_t lane = 0; lane < CLGS_LANES; lane++)
        clgs_store32(out + 4 * lane, coder.state[lane]);
    *words = (uint32_t)(p->words_end - coder.word);
    store_words(out + STATES, coder.word, *words);
    return STATES + 2 * (size_t)*words;
}

/* Decisions of all mixed columns, behind their length; the bytes. */
static size_t encode_mixed(clgs_columns *columns, clgs_mixed *mixed, uint8_t *out, uint8_t *end)
{
    clgs_range coder;
    clgs_range_begin_encode(&coder, out + 4, (size_t)(end - out) - 4);
    clgs_mixed_init(mixed);
    memset(columns->activity - 1, 0, 2 * (columns->rows + 2));
    for (size_t j = 0; j < columns->channels; j++) {
        if (columns->channel[j].coder == CLGS_MIXED)
            clgs_mixed_code(mixed, &coder, columns, j);
        clgs_columns_activate(columns, j);
    }
    clgs_range_end_encode(&coder);
    clgs_store32(out, (uint32_t)(coder.out - out - 4));
    return (size_t)(coder.out - out);
}

size_t clgs_attributes_encode(const void *model, const int32_t *value, size_t rows, size_t channels,
                              uint8_t *out, size_t capacity, void *workspace)
{
    clgs_columns columns = {.channel = model, .rows = rows, .channels = channels};
    uint32_t words = 0;
    if (cell_count(rows, channels) == 0 || !clgs_model_valid(model, channels) ||
        capacity < clgs_attributes_bound(model, rows, channels))
        return 0;
    parts p = place(&columns, workspace);
    clgs_columns_load(&columns, value);
    size_t literals = stage(&columns, p.cell, out + PREFIX);
    uint8_t *at = out + PREFIX + literals;
    size_t coded = encode_static(&columns, &p, at, &words);
    if (coded == 0)
        return 0;
    at += coded;
    clgs_store32(out, (uint32_t)literals);
    clgs_store32(out + 4, words);
    if (mixed_channels(model, channels) > 0)
        at += encode_mixed(&columns, p.mixed, at, out + capacity);
    return (size_t)(at - out);
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

/* The coders of a chunk. */
typedef struct decoder {
    clgs_rans_decoder rans;
    clgs_range range;
    clgs_mixed *mixed;
    bits literals;
} decoder;

static int decode_static(clgs_columns *columns, decoder *d, size_t j)
{
    const clgs_channel *channel = columns->channel + j;
    int failed = 0;
    if (channel->classes > 1 && channel->weight[0])
        clgs_columns_partial(columns, j);
    else if (channel->classes > 1)
        clgs_columns_cells(columns, j);
    clgs_rans_decode(&d->rans, columns, j);
    join(columns, j, &d->literals, &failed);
    clgs_columns_restore(columns, j);
    return !d->rans.failed && !failed;
}

static clgs_error decode_columns(clgs_columns *columns, decoder *d)
{
    size_t mixed = mixed_channels(columns->channel, columns->channels);
    if (mixed > 0)
        clgs_mixed_init(d->mixed);
    for (size_t j = 0; j < columns->channels; j++) {
        int fine = 1;
        if (columns->channel[j].coder == CLGS_STATIC) {
            fine = decode_static(columns, d, j);
        } else {
            clgs_mixed_code(d->mixed, &d->range, columns, j);
            fine = !d->range.failed;
        }
        if (!fine)
            return CLGS_ERROR_TRUNCATED;
        clgs_columns_activate(columns, j);
    }
    clgs_error error = mixed > 0 ? clgs_range_end_decode(&d->range) : CLGS_OK;
    return error ? error : finish(&d->rans, &d->literals, 0);
}

/* Find the parts of a chunk, and begin to decode them. */
static clgs_error open_chunk(decoder *d, const clgs_columns *columns, const uint8_t *data,
                             size_t size)
{
    if (size < PREFIX + STATES)
        return CLGS_ERROR_TRUNCATED;
    size_t literals = clgs_load32(data), words = clgs_load32(data + 4);
    size_t left = size - PREFIX - STATES;
    if (literals > left || words > (left - literals) / 2)
        return CLGS_ERROR_TRUNCATED;
    left -= literals + 2 * words;
    const uint8_t *states = data + PREFIX + literals, *end = states + STATES + 2 * words;
    if (mixed_channels(columns->channel, columns->channels) > 0) {
        if (left < 4 || clgs_load32(end) > left - 4)
            return CLGS_ERROR_TRUNCATED;
        clgs_range_begin_decode(&d->range, end + 4, left - 4);
        left -= 4 + clgs_load32(end);
    }
    if (left > 0)
        return CLGS_ERROR_TRAILING;
    for (size_t lane = 0; lane < CLGS_LANES; lane++) {
        d->rans.state[lane] = clgs_load32(states + 4 * lane);
        if (d->rans.state[lane] < CLGS_RANS_LOW)
            return CLGS_ERROR_CORRUPT;
    }
    d->literals = (bits){.at = data + PREFIX, .end = states};
    d->rans.word = states + STATES;
    d->rans.end = end;
    return CLGS_OK;
}

clgs_error clgs_attributes_decode(const void *model, const uint8_t *data, size_t size,
                                  int32_t *value, size_t rows, size_t channels, void *workspace)
{
    clgs_columns columns = {.channel = model, .rows = rows, .channels = channels};
    decoder d = {.rans = {.failed = 0}};
    if (cell_count(rows, channels) == 0 || !clgs_model_valid(model, channels))
        return CLGS_ERROR_ARGUMENT;
    parts p = place(&columns, workspace);
    d.rans.table = p.tables;
    d.mixed = p.mixed;
    clgs_error error = open_chunk(&d, &columns, data, size);
    if (error == CLGS_OK)
        error = decode_columns(&columns, &d);
    if (error == CLGS_OK)
        clgs_columns_store(&columns, value);
    return error;
}

size_t clgs_attributes_measure_bound(size_t rows)
{
    return CLGS_MIXED_MOST * rows + 8;
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

clgs_error clgs_attributes_measure(const void *model, const int32_t *value, size_t rows,
                                   size_t channels, uint64_t *bytes, uint8_t *out, void *workspace)
{
    clgs_columns columns = {.channel = model, .rows = rows, .channels = channels};
    if (cell_count(rows, channels) == 0 || !clgs_model_valid(model, channels))
        return CLGS_ERROR_ARGUMENT;
    parts p = place(&columns, workspace);
    clgs_columns_load(&columns, value);
    clgs_mixed_init(p.mixed);
    for (size_t j = 0; j < channels; j++) {
        split(&columns, j, NULL);
        if (columns.channel[j].coder == CLGS_MIXED) {
            clgs_range coder;
            clgs_range_begin_encode(&coder, out, clgs_attributes_measure_bound(rows));
            clgs_mixed_code(p.mixed, &coder, &columns, j);
            clgs_range_end_encode(&coder);
            bytes[j] += (uint64_t)(coder.out - out);
        }
        clgs_columns_activate(&columns, j);
    }
    return CLGS_OK;
}
