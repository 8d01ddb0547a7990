#include "attributes.h"

#include <string.h>

#include "clgs_codec.h"
#include "common/bytes.h"
#include "memory.h"

#define WRONG "the file's attributes are damaged; copy the file again"

/* The model of a header of tables; `known`: what clgs_attributes_known must say of it. */
static problem open_tables(span header, size_t channels, int known, attributes *result)
{
    *result = (attributes){.mode = TABLES, .channels = channels};
    size_t size = clgs_attributes_model_size(channels);
    result->model = memory_take(size);
    size_t mark = memory_mark();
    void *workspace = memory_take(clgs_attributes_header_workspace());
    if (!result->model || !workspace)
        return NO_MEMORY;
    memset(result->model, 0, size);
    clgs_error error =
        clgs_attributes_header_read(header.data, header.size, result->model, channels, workspace);
    memory_release(mark);
    return error || clgs_attributes_known(result->model, channels) != known ? WRONG : NULL;
}

problem attributes_open(span header, size_t channels, attributes *result)
{
    if (header.size == 1 && (header.data[0] == 0 || header.data[0] == 2)) {
        *result = (attributes){.mode = header.data[0] == 0 ? RAW : PLAIN, .channels = channels};
        return NULL;
    }
    return open_tables(header, channels, 0, result);
}

problem attributes_open_details(span header, size_t channels, attributes *result)
{
    return open_tables(header, channels, 1, result);
}

static problem read_raw(span data, size_t count, int32_t *value)
{
    if (data.size != 4 * count)
        return WRONG;
    for (size_t i = 0; i < count; i++)
        value[i] = clgs_signed(clgs_load32(data.data + 4 * i));
    return NULL;
}

problem attributes_read(const attributes *from, span data, const int32_t *near, size_t rows,
                        int32_t *value)
{
    size_t mark = memory_mark(), channels = from->channels;
    if (from->mode == RAW)
        return read_raw(data, rows * channels, value);
    if (from->mode == PLAIN)
        return clgs_paper_decode(data.data, data.size, value, rows, channels) ? WRONG : NULL;
    void *workspace = memory_take(clgs_attributes_workspace(rows, channels));
    if (!workspace)
        return NO_MEMORY;
    clgs_error error = clgs_attributes_decode(from->model, data.data, data.size, value, near, rows,
                                              channels, workspace);
    memory_release(mark);
    return error ? WRONG : NULL;
}
