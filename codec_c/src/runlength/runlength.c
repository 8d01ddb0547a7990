/* Matrices as runs of equal rows, and rows of numbers in contexts of their neighbours. */
#include <string.h>

#include "runlength/matrix.h"
#include "entropy/symbol.h"

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
} channel;

typedef struct model {
    clgs_tables tables;
    uint32_t run[CLGS_NODES]; /* lengths of runs of zero rows */
    int32_t run_weight[CLGS_NODES];
    int32_t row[3][CLGS_MAX_CHANNELS + 2]; /* clamped, latest first, two zeros before each */
    channel channels[];
} model;

typedef struct runlength {
    clgs_matrix matrix; /* first */
    model *model;
} runlength;

static int64_t code_value(runlength *stream, size_t j, int64_t value)
{
    model *m = stream->model;
    channel *own = m->channels + j;
    const int32_t *row = m->row[0] + 2, *above = m->row[1] + 2, *higher = m->row[2] + 2;
    uint32_t space = clgs_signed_level(above[j] + higher[j]);
    uint32_t cross =
        clgs_signed_level(row[(ptrdiff_t)j - 1]) * 4 + clgs_small_level(row[(ptrdiff_t)j - 2]);
    clgs_symbol symbol = {
        .mix = {.coder = &stream->matrix.coder,
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
        .mix = {.coder = &stream->matrix.coder,
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
    const clgs_matrix *matrix = &stream->matrix;
    size_t i = first;
    while (i < matrix->rows && clgs_matrix_is_centre(matrix, i, 0, matrix->channels))
        i++;
    return i - first;
}

static int code_row(runlength *stream, size_t i)
{
    for (size_t j = 0; j < stream->matrix.channels; j++) {
        size_t at = i * stream->matrix.channels + j;
        int64_t centre = stream->matrix.centre[j];
        int64_t value = stream->matrix.source ? stream->matrix.source[at] - centre : 0;
        value = code_value(stream, j, value) + centre;
        if (value < INT32_MIN || value > INT32_MAX)
            return 0;
        if (stream->matrix.target)
            stream->matrix.target[at] = (int32_t)value;
    }
    next_row(stream);
    return 1;
}
static void skip_rows(runlength *stream, size_t first, size_t count)
{
    model *m = stream->model;
    for (size_t i = 0; i < count && stream->matrix.target; i++)
        for (size_t j = 0; j < stream->matrix.channels; j++)
            stream->matrix.target[(first + i) * stream->matrix.channels + j] =
                stream->matrix.centre[j];
    if (count > 0)
        memset(m->row[0], 0, sizeof m->row[0]);
    for (size_t i = 0; i < count && i < 2; i++)
        next_row(stream);
}

static clgs_error code_rows(clgs_matrix *matrix)
{
    runlength *stream = (runlength *)matrix;
    for (size_t i = 0; i < matrix->rows;) {
        size_t run = code_run(stream, matrix->source ? find_run(stream, i) : 0);
        if (run > matrix->rows - i)
            return CLGS_ERROR_CORRUPT;
        skip_rows(stream, i, run);
        i += run;
        if (i < matrix->rows && !code_row(stream, i++))
            return CLGS_ERROR_CORRUPT;
        if (matrix->coder.failed)
            return CLGS_ERROR_TRUNCATED;
    }
    return CLGS_OK;
}

/* 0 if a quarter of the values are 0, otherwise the mean. */
static int32_t find_centre(const clgs_matrix *matrix, size_t j)
{
    size_t zeros = 0;
    for (size_t i = 0; i < matrix->rows; i++)
        zeros += matrix->source[i * matrix->channels + j] == 0;
    return 4 * zeros >= matrix->rows ? 0 : clgs_matrix_mean(matrix, j);
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
    int fits = channels >= 1 && channels <= CLGS_MAX_CHANNELS;
    return fits ? sizeof(model) + channels * sizeof(channel) : 0;
}

size_t clgs_runlength_bound(size_t rows, size_t channels)
{
    return clgs_matrix_bound(rows, channels);
}

size_t clgs_runlength_encode(const int32_t *value, size_t rows, size_t channels, uint8_t *out,
                             size_t capacity, void *workspace)
{
    runlength stream = {.matrix = {.rows = rows, .channels = channels, .source = value},
                        .model = workspace};
    if (clgs_matrix_bound(rows, channels) == 0)
        return 0;
    model_init(stream.model, channels);
    for (size_t j = 0; j < channels && rows > 0; j++)
        stream.matrix.centre[j] = find_centre(&stream.matrix, j);
    return clgs_matrix_encode(&stream.matrix, code_rows, out, capacity);
}

clgs_error clgs_runlength_decode(const uint8_t *data, size_t size, int32_t *value, size_t rows,
                                 size_t channels, void *workspace)
{
    runlength stream = {.matrix = {.rows = rows, .channels = channels, .target = value},
                        .model = workspace};
    if (clgs_matrix_bound(rows, channels) == 0)
        return CLGS_ERROR_ARGUMENT;
    model_init(stream.model, channels);
    return clgs_matrix_decode(&stream.matrix, code_rows, data, size);
}
