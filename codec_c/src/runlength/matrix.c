#include "runlength/matrix.h"

#include "common/bytes.h"

#define MODE_RAW 0
#define MODE_CODED 1

size_t clgs_matrix_bound(size_t rows, size_t channels)
{
    int fits = rows <= CLGS_MAX_POINTS && channels >= 1 && channels <= CLGS_MAX_CHANNELS;
    return fits ? 1 + 4 * rows * channels : 0;
}

int32_t clgs_matrix_mean(const clgs_matrix *matrix, size_t channel)
{
    int64_t sum = 0, count = (int64_t)matrix->rows;
    for (size_t i = 0; i < matrix->rows; i++)
        sum += matrix->source[i * matrix->channels + channel];
    int64_t twice = 2 * sum + count, half = twice / (2 * count);
    return (int32_t)(half - (twice % (2 * count) < 0));
}

int clgs_matrix_is_centre(const clgs_matrix *matrix, size_t i, size_t channel, size_t count)
{
    const int32_t *row = matrix->source + i * matrix->channels;
    for (size_t j = channel; j < channel + count; j++)
        if (row[j] != matrix->centre[j])
            return 0;
    return 1;
}

static size_t encode_coded(clgs_matrix *matrix, clgs_matrix_rows *code, uint8_t *out,
                           size_t capacity)
{
    uint8_t *at = out;
    if (matrix->rows == 0 || capacity < 1 + CLGS_MAX_VARINT * matrix->channels)
        return 0;
    *at++ = MODE_CODED;
    for (size_t j = 0; j < matrix->channels; j++)
        at = clgs_store_varint(at, matrix->centre[j]);
    clgs_range_begin_encode(&matrix->coder, at, capacity - (size_t)(at - out));
    if (code(matrix) != CLGS_OK)
        return 0;
    clgs_range_end_encode(&matrix->coder);
    return matrix->coder.failed ? 0 : (size_t)(matrix->coder.out - out);
}

size_t clgs_matrix_encode(clgs_matrix *matrix, clgs_matrix_rows *code, uint8_t *out,
                          size_t capacity)
{
    size_t bound = clgs_matrix_bound(matrix->rows, matrix->channels);
    if (bound == 0 || capacity < bound)
        return 0;
    size_t size = encode_coded(matrix, code, out, bound);
    if (size > 0)
        return size;
    out[0] = MODE_RAW;
    for (size_t i = 0; i < matrix->rows * matrix->channels; i++)
        clgs_store32(out + 1 + 4 * i, (uint32_t)matrix->source[i]);
    return bound;
}

static clgs_error decode_coded(clgs_matrix *matrix, clgs_matrix_rows *code, const uint8_t *at,
                               const uint8_t *end)
{
    for (size_t j = 0; j < matrix->channels; j++) {
        at = clgs_load_varint(at, end, matrix->centre + j);
        if (!at)
            return CLGS_ERROR_CORRUPT;
    }
    clgs_range_begin_decode(&matrix->coder, at, (size_t)(end - at));
    clgs_error error = code(matrix);
    return error ? error : clgs_range_end_decode(&matrix->coder);
}

clgs_error clgs_matrix_decode(clgs_matrix *matrix, clgs_matrix_rows *code, const uint8_t *data,
                              size_t size)
{
    size_t bound = clgs_matrix_bound(matrix->rows, matrix->channels);
    if (bound == 0)
        return CLGS_ERROR_ARGUMENT;
    if (size < 1)
        return CLGS_ERROR_TRUNCATED;
    if (data[0] == MODE_CODED && matrix->rows > 0)
        return decode_coded(matrix, code, data + 1, data + size);
    if (data[0] != MODE_RAW)
        return CLGS_ERROR_CORRUPT;
    if (size != bound)
        return size < bound ? CLGS_ERROR_TRUNCATED : CLGS_ERROR_TRAILING;
    for (size_t i = 0; i < matrix->rows * matrix->channels; i++)
        matrix->target[i] = clgs_signed(clgs_load32(data + 1 + 4 * i));
    return CLGS_OK;
}
