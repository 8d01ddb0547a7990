/* Chunks of attributes: literal bits, static symbols, then the decisions of mixed channels. */
#include "attributes/model.h"

#include <string.h>

#include "common/bytes.h"
#include "attributes/literals.h"
#include "attributes/mixed.h"
#include "attributes/predict.h"
#include "attributes/rans.h"

#define PREFIX (2 * CLGS_MAX_VARINT) /* lengths of the literals and of the words, at most */
#define STATES (4 * CLGS_LANES)
#define MAX_CELLS ((size_t)1 << 28)

/* Values of a chunk, or 0 if they are too many: then lengths in bytes would not fit. */
static size_t cell_count(size_t rows, size_t channels)
{
    int fits = rows <= CLGS_MAX_POINTS && channels >= 1 && channels <= CLGS_MAX_CHANNELS &&
               rows * channels <= MAX_CELLS;
    return fits ? rows * channels : 0;
}

/* Words of the coder and cells of all columns, which follow the columns. */
static size_t staging_size(size_t cells)
{
    return 2 * (cells + CLGS_LANES) + cells;
}

static size_t channels_with(const clgs_channel *channel, size_t channels, int32_t coder)
{
    size_t count = 0;
    for (size_t j = 0; j < channels; j++)
        count += channel[j].coder == coder;
    return count;
}

static size_t channels_with_tables(const clgs_channel *channel, size_t channels)
{
    size_t count = 0;
    for (size_t j = 0; j < channels; j++)
        if (clgs_has_tables(channel + j))
            count++;
    return count;
}

size_t clgs_attributes_bound(const void *model, size_t rows, size_t channels)
{
    if (cell_count(rows, channels) == 0)
        return 0;
    size_t mixed = channels_with(model, channels, CLGS_MIXED);
    return PREFIX + STATES + 6 * rows * (channels - mixed) + 8 + CLGS_MIXED_MOST * rows * mixed + 8;
}

/* Parts of the workspace; `words` and `cell` are an encoder's. Without tables: bad near rows. */
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
    if (!next)
        return (parts){.tables = NULL};
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
    clgs_literals literals = {.out = out};
    for (size_t j = 0; j < columns->channels; j++) {
        clgs_literals_split(columns, j, clgs_has_tables(columns->channel + j) ? &literals : NULL);
        if (columns->channel[j].classes > 1) {
            clgs_columns_cells(columns, j);
            memcpy(cells + j * columns->rows, columns->cell, columns->rows);
        }
        clgs_columns_activate(columns, j);
    }
    clgs_literals_end(&literals);
    return (size_t)(literals.out - out);
}

static int any_literals(const clgs_columns *columns)
{
    int any = 0;
    for (size_t j = 0; j < columns->channels && !any; j++)
        any = clgs_has_literals(columns->channel + j);
    return any;
}

/* After their length, which is left out if no table has any; returns their end. */
static uint8_t *encode_literals(clgs_columns *columns, uint8_t *cells, uint8_t *out)
{
    size_t size = stage(columns, cells, out + CLGS_MAX_VARINT);
    uint8_t *at = any_literals(columns) ? clgs_store_varint(out, (int32_t)size) : out;
    memmove(at, out + CLGS_MAX_VARINT, size);
    return at + size;
}

/* States and words of all static columns, after their length if more follows. Returns their
 * end, or NULL if a symbol has no frequency. */
static uint8_t *encode_static(const clgs_columns *columns, const parts *p, int more, uint8_t *out)
{
    clgs_rans_encoder coder;
    clgs_rans_begin_encode(&coder, columns->lanes, p->tables, p->words_end);
    for (size_t j = columns->channels; j-- > 0;) {
        const clgs_channel *channel = columns->channel + j;
        const uint8_t *cell = channel->classes > 1 ? p->cell + j * columns->rows : NULL;
        if (clgs_has_tables(channel) && !clgs_rans_encode(&coder, columns, j, cell))
            return NULL;
    }
    if (more)
        out = clgs_store_varint(out, (int32_t)clgs_rans_size(&coder));
    return clgs_rans_end_encode(&coder, out);
}

/* Decisions of all mixed columns; returns their end. */
static uint8_t *encode_mixed(clgs_columns *columns, clgs_mixed *mixed, uint8_t *out, uint8_t *end)
{
    clgs_range coder;
    clgs_range_begin_encode(&coder, out, (size_t)(end - out));
    clgs_mixed_init(mixed);
    memset(columns->activity - 1, 0, 2 * (columns->rows + 2));
    for (size_t j = 0; j < columns->channels; j++) {
        if (columns->channel[j].coder == CLGS_MIXED)
            clgs_mixed_code(mixed, &coder, columns, j);
        clgs_columns_activate(columns, j);
    }
    clgs_range_end_encode(&coder);
    return coder.out;
}

size_t clgs_attributes_encode(const void *model, const int32_t *value, const int32_t *near,
                              size_t rows, size_t channels, uint8_t *out, size_t capacity,
                              void *workspace)
{
    clgs_columns columns = {.channel = model, .rows = rows, .channels = channels, .near = near};
    if (cell_count(rows, channels) == 0 || !clgs_model_valid(model, channels) ||
        capacity < clgs_attributes_bound(model, rows, channels))
        return 0;
    size_t mixed = channels_with(model, channels, CLGS_MIXED);
    parts p = place(&columns, workspace);
    if (!p.tables)
        return 0;
    clgs_columns_load(&columns, value);
    uint8_t *at = encode_literals(&columns, p.cell, out);
    if (channels_with_tables(model, channels) > 0)
        at = encode_static(&columns, &p, mixed > 0, at);
    if (at && mixed > 0)
        at = encode_mixed(&columns, p.mixed, at, out + capacity);
    return at ? (size_t)(at - out) : 0;
}

static clgs_error finish(const clgs_rans_decoder *coder, const clgs_literals *literals)
{
    if (coder->failed || literals->failed)
        return CLGS_ERROR_TRUNCATED;
    if (coder->word != coder->end || literals->at != literals->end)
        return CLGS_ERROR_TRAILING;
    return literals->held != 0 || !clgs_rans_finished(coder) ? CLGS_ERROR_CORRUPT : CLGS_OK;
}

/* The coders of a chunk. */
typedef struct decoder {
    clgs_rans_decoder rans;
    clgs_range range;
    clgs_mixed *mixed;
    clgs_literals literals;
} decoder;

static int decode_static(clgs_columns *columns, decoder *d, size_t j)
{
    const clgs_channel *channel = columns->channel + j;
    if (channel->classes > 1 && channel->weight[0])
        clgs_columns_partial(columns, j);
    else if (channel->classes > 1)
        clgs_columns_cells(columns, j);
    clgs_rans_decode(&d->rans, columns, j);
    clgs_literals_join(columns, j, &d->literals);
    clgs_columns_restore(columns, j);
    return !d->rans.failed && !d->literals.failed;
}

static clgs_error decode_columns(clgs_columns *columns, decoder *d)
{
    size_t mixed = channels_with(columns->channel, columns->channels, CLGS_MIXED);
    if (mixed > 0)
        clgs_mixed_init(d->mixed);
    for (size_t j = 0; j < columns->channels; j++) {
        int fine = 1;
        if (clgs_has_tables(columns->channel + j)) {
            fine = decode_static(columns, d, j);
        } else if (columns->channel[j].coder == CLGS_KNOWN) {
            clgs_literals_split(columns, j, NULL);
        } else {
            clgs_mixed_code(d->mixed, &d->range, columns, j);
            fine = !d->range.failed;
        }
        if (!fine)
            return CLGS_ERROR_TRUNCATED;
        clgs_columns_serve(columns, j);
        clgs_columns_activate(columns, j);
    }
    clgs_error error = mixed > 0 ? clgs_range_end_decode(&d->range) : CLGS_OK;
    size_t tables = channels_with_tables(columns->channel, columns->channels);
    return error || tables == 0 ? error : finish(&d->rans, &d->literals);
}

/* A number of bytes that end before `end`; NULL if they do not. */
static const uint8_t *load_size(const uint8_t *at, const uint8_t *end, size_t *size)
{
    int32_t number;
    at = clgs_load_varint(at, end, &number);
    if (!at || number < 0 || number > end - at)
        return NULL;
    *size = (size_t)number;
    return at;
}

/* Find the parts of a chunk, and begin to decode them. */
static clgs_error open_chunk(decoder *d, const clgs_columns *columns, const uint8_t *at,
                             const uint8_t *end)
{
    size_t mixed = channels_with(columns->channel, columns->channels, CLGS_MIXED), size = 0;
    clgs_error error = CLGS_OK;
    if (any_literals(columns) && !(at = load_size(at, end, &size)))
        return CLGS_ERROR_TRUNCATED;
    d->literals = (clgs_literals){.at = at, .end = at + size};
    at += size;
    size = (size_t)(end - at);
    if (channels_with_tables(columns->channel, columns->channels) > 0) {
        if (mixed > 0 && !(at = load_size(at, end, &size)))
            return CLGS_ERROR_TRUNCATED;
        error = clgs_rans_begin_decode(&d->rans, columns->lanes, at, at + size);
        at += size;
    }
    if (mixed == 0 && at != end)
        error = CLGS_ERROR_TRAILING;
    if (mixed > 0)
        clgs_range_begin_decode(&d->range, at, (size_t)(end - at));
    return error;
}

clgs_error clgs_attributes_decode(const void *model, const uint8_t *data, size_t size,
                                  int32_t *value, const int32_t *near, size_t rows, size_t channels,
                                  void *workspace)
{
    clgs_columns columns = {.channel = model, .rows = rows, .channels = channels, .near = near};
    decoder d = {.literals = {.failed = 0}};
    if (cell_count(rows, channels) == 0 || !clgs_model_valid(model, channels))
        return CLGS_ERROR_ARGUMENT;
    parts p = place(&columns, workspace);
    if (!p.tables)
        return CLGS_ERROR_ARGUMENT;
    d.rans.table = p.tables;
    d.mixed = p.mixed;
    if (channels_with(model, channels, CLGS_KNOWN) > 0)
        clgs_columns_load(&columns, value);
    clgs_error error = open_chunk(&d, &columns, data, data + size);
    if (error == CLGS_OK)
        error = decode_columns(&columns, &d);
    if (error == CLGS_OK)
        clgs_columns_store(&columns, value);
    return error;
}
