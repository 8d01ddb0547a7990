#include <string.h>

#include "bytes.h"
#include "symbol.h"

#define MODE_RAW 0
#define MODE_CODED 1

#define INPUTS 3
#define SPACE 16       /* contexts from the two rows before */
#define CROSS (16 * 4) /* contexts from the two channels before */
#define SLOW_LIMIT 1000
#define FAST_LIMIT 250
#define WEIGHT_SHIFT 14
#define CLAMP 255

/* States and weights of one channel. */
typedef struct channel {
    uint32_t plain[CLGS_NODES];
    uint32_t space[SPACE][CLGS_NODES];
    uint32_t cross[CROSS][CLGS_NODES];
    int32_t weight[CLGS_NODES * INPUTS];
    int32_t centre;
} channel;

typedef struct model {
    clgs_tables tables;
    uint32_t run[CLGS_NODES]; /* lengths of runs of zero rows */
    int32_t run_weight[CLGS_NODES];
    int32_t row[3][CLGS_MAX_CHANNELS + 2]; /* clamped, latest first, two zeros before each */
    channel channels[];
} model;

typedef struct runlength {
    clgs_range coder;
    model *model;
    size_t rows, channels;
    const int32_t *source; /* encoder */
    int32_t *target;       /* decoder */
} runlength;

/* Signed level of a neighbour: 0, 1, 2, 3-4, 5-8, 9-16, 17-32, more; 8 and up where negative. */
static uint32_t level(int32_t value)
{
    uint32_t size = (uint32_t)(value < 0 ? -value : value), step = 0;
    for (uint32_t limit = 1; step < 7 && size >= limit;
         limit = limit < 3 ? limit + 1 : 2 * limit - 1)
        step++;
    return value < 0 ? 8 + step : step;
}

static uint32_t small_level(int32_t value)
{
    uint32_t size = (uint32_t)(value < 0 ? -value : value);
    return size == 0 ? 0 : size <= 2 ? 1 : size <= 8 ? 2 : 3;
}

static int64_t code_value(runlength *stream, size_t j, int64_t value)
{
    model *m = stream->model;
    channel *own = m->channels + j;
    const int32_t *row = m->row[0] + 2, *above = m->row[1] + 2, *higher = m->row[2] + 2;
    uint32_t space = level(above[j] + higher[j]);
    uint32_t cross = level(row[(ptrdiff_t)j - 1]) * 4 + small_level(row[(ptrdiff_t)j - 2]);
    clgs_symbol symbol = {
        .mix = {.coder = &stream->coder,
                .tables = &m->tables,
                .inputs = INPUTS,
                .limit = {SLOW_LIMIT, FAST_LIMIT, FAST_LIMIT},
                .shift = WEIGHT_SHIFT},
        .base = {own->plain, own->space[space], own->cross[cross]},
        .weight = own->weight,
    };
    value = clgs_symbol_value(&symbol, value);
    m->row[0][2 + j] = (int32_t)(value < -CLAMP ? -CLAMP : value > CLAMP ? CLAMP : value);
    return value;
}

static size_t code_run(runlength *stream, size_t length)
{
    model *m = stream->model;
    clgs_symbol symbol = {
        .mix = {.coder = &stream->coder,
                .tables = &m->tables,
                .inputs = 1,
                .limit = {FAST_LIMIT},
                .shift = WEIGHT_SHIFT},
        .base = {m->run},
        .weight = m->run_weight,
    };
    return clgs_symbol_size(&symbol, (uint32_t)length + 1) - 1;
}

static void next_row(runlength *stream)
{
    model *m = stream->model;
    memcpy(m->row[2], m->row[1], sizeof m->row[0]);
    memcpy(m->row[1], m->row[0], sizeof m->row[0]);
}

/* Length of the run of rows from `first` that equal the centres. */
static size_t find_run(const runlength *stream, size_t first)
{
    for (size_t i = first; i < stream->rows; i++)
        for (size_t j = 0; j < stream->channels; j++)
            if (stream->source[i * stream->channels + j] != stream->model->channels[j].centre)
                return i - first;
    return stream->rows - first;
}

static int code_row(runlength *stream, size_t i)
{
    for (size_t j = 0; j < stream->channels; j++) {
        size_t at = i * stream->channels + j;
        int64_t centre = stream->model->channels[j].centre;
        int64_t value = stream->source ? stream->source[at] - centre : 0;
        value = code_value(stream, j, value) + centre;
        if (value < INT32_MIN || value > INT32_MAX)
            return 0;
        if (stream->target)
            stream->target[at] = (int32_t)value;
    }
    next_row(stream);
    return 1;
}
static void skip_rows(runlength *stream, size_t first, size_t count)
{
    model *m = stream->model;
    for (size_t i = 0; i < count && stream->target; i++)
        for (size_t j = 0; j < stream->channels; j++)
            stream->target[(first + i) * stream->channels + j] = m->channels[j].centre;
    if (count > 0)
        memset(m->row[0], 0, sizeof m->row[0]);
    for (size_t i = 0; i < count && i < 2; i++)
        next_row(stream);
}

static clgs_error code_rows(runlength *stream)
{
    for (size_t i = 0; i < stream->rows;) {
        size_t run = code_run(stream, stream->source ? find_run(stream, i) : 0);
        if (run > stream->rows - i)
            return CLGS_ERROR_CORRUPT;
        skip_rows(stream, i, run);
        i += run;
        if (i < stream->rows && !code_row(stream, i++))
            return CLGS_ERROR_CORRUPT;
        if (stream->coder.failed)
            return CLGS_ERROR_TRUNCATED;
    }
    return CLGS_OK;
}

/* 0 where a quarter of the values are 0, otherwise the mean rounded to nearest, halves up. */
static int32_t find_centre(const int32_t *value, size_t rows, size_t channels)
{
    int64_t sum = 0, count = (int64_t)rows;
    size_t zeros = 0;
    for (size_t i = 0; i < rows; i++) {
        sum += value[i * channels];
        zeros += value[i * channels] == 0;
    }
    if (4 * zeros >= rows)
        return 0;
    int64_t twice = 2 * sum + count, half = twice / (2 * count);
    return (int32_t)(half - (twice % (2 * count) < 0));
}

static void model_init(model *m, size_t channels)
{
    clgs_tables_init(&m->tables);
    clgs_states_init(m->run, CLGS_NODES);
    clgs_weights_init(m->run_weight, CLGS_NODES, 1);
    memset(m->row, 0, sizeof m->row);
    for (size_t j = 0; j < channels; j++) {
        channel *own = m->channels + j;
        clgs_states_init(own->plain, CLGS_NODES);
        clgs_states_init(own->space[0], SPACE * CLGS_NODES);
        clgs_states_init(own->cross[0], CROSS * CLGS_NODES);
        clgs_weights_init(own->weight, CLGS_NODES * INPUTS, INPUTS);
    }
}

size_t clgs_runlength_workspace(size_t channels)
{
    return channels > CLGS_MAX_CHANNELS ? 0 : sizeof(model) + channels * sizeof(channel);
}

size_t clgs_runlength_bound(size_t rows, size_t channels)
{
    int fits = rows <= CLGS_MAX_POINTS && channels >= 1 && channels <= CLGS_MAX_CHANNELS;
    return fits ? 1 + 4 * rows * channels : 0;
}

static size_t encode_coded(runlength *stream, uint8_t *out, size_t capacity)
{
    uint8_t *at = out;
    if (capacity < 1 + CLGS_MAX_VARINT * stream->channels)
        return 0;
    *at++ = MODE_CODED;
    for (size_t j = 0; j < stream->channels; j++) {
        int32_t centre = find_centre(stream->source + j, stream->rows, stream->channels);
        stream->model->channels[j].centre = centre;
        at = clgs_store_varint(at, centre);
    }
    clgs_range_begin_encode(&stream->coder, at, capacity - (size_t)(at - out));
    if (code_rows(stream) != CLGS_OK)
        return 0;
    clgs_range_end_encode(&stream->coder);
    return stream->coder.failed ? 0 : (size_t)(stream->coder.out - out);
}

size_t clgs_runlength_encode(const int32_t *value, size_t rows, size_t channels, uint8_t *out,
                             size_t capacity, void *workspace)
{
    runlength stream = {.model = workspace, .rows = rows, .channels = channels, .source = value};
    size_t bound = clgs_runlength_bound(rows, channels);
    if (bound == 0 || capacity < bound)
        return 0;
    model_init(stream.model, channels);
    size_t size = rows > 0 ? encode_coded(&stream, out, bound) : 0;
    if (size > 0)
        return size;
    out[0] = MODE_RAW;
    for (size_t i = 0; i < rows * channels; i++)
        clgs_store32(out + 1 + 4 * i, (uint32_t)value[i]);
    return bound;
}

static clgs_error decode_coded(runlength *stream, const uint8_t *at, const uint8_t *end)
{
    for (size_t j = 0; j < stream->channels; j++) {
        at = clgs_load_varint(at, end, &stream->model->channels[j].centre);
        if (!at)
            return CLGS_ERROR_CORRUPT;
    }
    clgs_range_begin_decode(&stream->coder, at, (size_t)(end - at));
    clgs_error error = code_rows(stream);
    return error ? error : clgs_range_end_decode(&stream->coder);
}

clgs_error clgs_runlength_decode(const uint8_t *data, size_t size, int32_t *value, size_t rows,
                                 size_t channels, void *workspace)
{
    runlength stream = {.model = workspace, .rows = rows, .channels = channels, .target = value};
    size_t bound = clgs_runlength_bound(rows, channels);
    if (bound == 0)
        return CLGS_ERROR_ARGUMENT;
    if (size < 1)
        return CLGS_ERROR_TRUNCATED;
    if (data[0] == MODE_CODED && rows > 0) {
        model_init(stream.model, channels);
        return decode_coded(&stream, data + 1, data + size);
    }
    if (data[0] != MODE_RAW)
        return CLGS_ERROR_CORRUPT;
    if (size != bound)
        return size < bound ? CLGS_ERROR_TRUNCATED : CLGS_ERROR_TRAILING;
    for (size_t i = 0; i < rows * channels; i++)
        value[i] = clgs_signed(clgs_load32(data + 1 + 4 * i));
    return CLGS_OK;
}
