/* Matrices by the plain run-length coder of the paper: channels in threes, 31 probabilities. */
#include "runlength/matrix.h"

#define GROUP 3       /* channels coded together; those that are left over are coded alone */
#define RATE 5        /* a probability moves by 2^-RATE of the distance */
#define UNARY_RUN 3   /* runs below this are coded in unary */
#define PAIRED_RUN 11 /* runs below this: a decision for each two of them, and a raw bit */
#define MAX_ORDER 32  /* of an Exp-Golomb code: what it codes is below 2^34 */

/* 31 adaptive probabilities of a 1, in 1/65536. */
typedef struct contexts {
    uint16_t run[UNARY_RUN + 2];
    uint16_t above_zero[7], above_one[7]; /* by the magnitudes of the row that are known */
    uint16_t prefix[2][3], suffix[2][3];  /* of magnitudes from 2: first channel, the others */
} contexts;

typedef struct paper {
    clgs_matrix matrix; /* first; the centres are means */
    contexts contexts;
} paper;

/* An Exp-Golomb code: the first `count` prefix decisions have a probability each, those after them
 * share the last; so do suffix decisions from the lowest place; without `suffix` they are raw. */
typedef struct golomb {
    uint32_t order, count;
    uint16_t *prefix, *suffix;
} golomb;

static uint32_t code_bit(paper *stream, uint16_t *p, uint32_t bit)
{
    bit = clgs_range_code(&stream->matrix.coder, bit, *p);
    *p = (uint16_t)(bit ? *p + ((65536 - *p) >> RATE) : *p - (*p >> RATE));
    return bit;
}

static uint32_t code_raw(paper *stream, uint32_t bit)
{
    return clgs_range_code(&stream->matrix.coder, bit, 32768);
}

static uint64_t code_golomb(paper *stream, const golomb *code, uint64_t value)
{
    uint32_t order = code->order, last = code->count - 1;
    uint64_t base = 0, low = 0;
    for (; order < MAX_ORDER; order++) {
        uint32_t at = order - code->order;
        uint32_t more = value - base >= (uint64_t)1 << order;
        if (!code_bit(stream, code->prefix + (at < last ? at : last), more))
            break;
        base += (uint64_t)1 << order;
    }
    for (uint32_t place = order; place-- > 0;) {
        uint32_t bit = (value - base) >> place & 1;
        low = low << 1 |
              (code->suffix ? code_bit(stream, code->suffix + (place < last ? place : last), bit)
                            : code_raw(stream, bit));
    }
    return base + low;
}

/* Number of rows that equal the means, before one that does not or the end. */
static uint64_t code_run(paper *stream, uint64_t run)
{
    uint16_t *p = stream->contexts.run;
    uint64_t known = 0;
    for (; known < UNARY_RUN; known++, p++)
        if (!code_bit(stream, p, run > known))
            return known;
    for (; known < PAIRED_RUN; known += 2)
        if (!code_bit(stream, p, run > known + 1))
            return known + code_raw(stream, (run - known) & 1);
    const golomb code = {.order = 2, .count = 1, .prefix = p + 1};
    return known + code_golomb(stream, &code, run - known);
}

static uint64_t code_magnitude(paper *stream, uint64_t size, uint32_t zero, uint32_t one,
                               uint32_t other)
{
    contexts *c = &stream->contexts;
    const golomb code = {1, 3, c->prefix[other], c->suffix[other]};
    if (!code_bit(stream, c->above_zero + zero, size > 0))
        return 0;
    if (!code_bit(stream, c->above_one + one, size > 1))
        return 1;
    return 2 + code_golomb(stream, &code, size - 2);
}

/* Magnitudes of a row that is not all zero: the first channel last, which so is known not to be 0
 * where the others are. */
static void code_magnitudes(paper *stream, uint64_t *size, size_t group)
{
    uint32_t zero = 0, one = 0, known = group == 1;
    if (group == GROUP) {
        size[1] = code_magnitude(stream, size[1], 0, 0, 1);
        zero = size[1] == 0;
        one = size[1] <= 1;
        size[2] = code_magnitude(stream, size[2], 1 + zero, 1 + one, 1);
        known = zero && size[2] == 0;
        zero = 3 + 2 * zero + (size[2] == 0);
        one = 3 + 2 * one + (size[2] <= 1);
    }
    size[0] = known + code_magnitude(stream, size[0] - known, zero, one, 0);
}

/* One row of channels `j` and up; 0 if a decoded value is outside of int32. */
static int code_row(paper *stream, size_t i, size_t j, size_t group)
{
    uint64_t size[GROUP] = {0};
    uint32_t negative[GROUP] = {0};
    size_t at = i * stream->matrix.channels + j;
    for (size_t k = 0; k < group && stream->matrix.source; k++) {
        int64_t value = (int64_t)stream->matrix.source[at + k] - stream->matrix.centre[j + k];
        negative[k] = value < 0;
        size[k] = (uint64_t)(value < 0 ? -value : value);
    }
    code_magnitudes(stream, size, group);
    for (size_t k = 0; k < group; k++) {
        negative[k] = size[k] > 0 && code_raw(stream, negative[k]);
        int64_t value =
            stream->matrix.centre[j + k] + (negative[k] ? -(int64_t)size[k] : (int64_t)size[k]);
        if (value < INT32_MIN || value > INT32_MAX)
            return 0;
        if (stream->matrix.target)
            stream->matrix.target[at + k] = (int32_t)value;
    }
    return 1;
}

static uint64_t find_run(const paper *stream, size_t first, size_t j, size_t group)
{
    size_t i = first;
    while (i < stream->matrix.rows && clgs_matrix_is_centre(&stream->matrix, i, j, group))
        i++;
    return i - first;
}

static void fill_run(const paper *stream, size_t first, size_t end, size_t j, size_t group)
{
    for (size_t i = first; i < end && stream->matrix.target; i++)
        for (size_t k = j; k < j + group; k++)
            stream->matrix.target[i * stream->matrix.channels + k] = stream->matrix.centre[k];
}

static clgs_error code_group(paper *stream, size_t j, size_t group)
{
    uint16_t *p = (uint16_t *)&stream->contexts;
    for (size_t k = 0; k < sizeof stream->contexts / sizeof *p; k++)
        p[k] = 32768;
    for (size_t i = 0; i < stream->matrix.rows;) {
        uint64_t run = code_run(stream, stream->matrix.source ? find_run(stream, i, j, group) : 0);
        if (run > stream->matrix.rows - i)
            return CLGS_ERROR_CORRUPT;
        fill_run(stream, i, i + (size_t)run, j, group);
        i += (size_t)run;
        if (i < stream->matrix.rows && !code_row(stream, i++, j, group))
            return CLGS_ERROR_CORRUPT;
        if (stream->matrix.coder.failed)
            return CLGS_ERROR_TRUNCATED;
    }
    return CLGS_OK;
}

static clgs_error code_groups(clgs_matrix *matrix)
{
    clgs_error error = CLGS_OK;
    for (size_t j = 0, group; j < matrix->channels && !error; j += group) {
        group = matrix->channels - j >= GROUP ? GROUP : 1;
        error = code_group((paper *)matrix, j, group);
    }
    return error;
}

size_t clgs_paper_bound(size_t rows, size_t channels)
{
    return clgs_matrix_bound(rows, channels);
}

size_t clgs_paper_encode(const int32_t *value, size_t rows, size_t channels, uint8_t *out,
                         size_t capacity)
{
    paper stream = {.matrix = {.rows = rows, .channels = channels, .source = value}};
    if (clgs_matrix_bound(rows, channels) == 0)
        return 0;
    for (size_t j = 0; j < channels && rows > 0; j++)
        stream.matrix.centre[j] = clgs_matrix_mean(&stream.matrix, j);
    return clgs_matrix_encode(&stream.matrix, code_groups, out, capacity);
}

clgs_error clgs_paper_decode(const uint8_t *data, size_t size, int32_t *value, size_t rows,
                             size_t channels)
{
    paper stream = {.matrix = {.rows = rows, .channels = channels, .target = value}};
    return clgs_matrix_decode(&stream.matrix, code_groups, data, size);
}
