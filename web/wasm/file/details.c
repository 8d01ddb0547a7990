#include "details.h"

#include "clgs_codec.h"
#include "common/bytes.h"
#include "memory.h"

#define WRONG "the file's details are damaged; copy the file again"
#define HEAD 28 /* bytes: the step, then length and CRC of each header */
#define MAX_STEP 255

/* The next `size` bytes of BODY, which has `*rest` more. */
static problem place(uint64_t size, const uint8_t **at, uint64_t *rest, span *result)
{
    if (size > *rest)
        return WRONG;
    *result = (span){*at, (size_t)size};
    *at += size;
    *rest -= size;
    return NULL;
}

/* The details of all chunks from `at` on, whose lengths are `coded`; they end with BODY. */
static problem place_parts(details *d, span coded, size_t chunks, const uint8_t *at, uint64_t rest)
{
    size_t mark = memory_mark(), count = DETAILED * chunks;
    int32_t *size = memory_take(4 * count + 4);
    void *workspace = memory_take(clgs_runlength_workspace(DETAILED));
    if (!size || !workspace)
        return NO_MEMORY;
    if (clgs_runlength_decode(coded.data, coded.size, size, chunks, DETAILED, workspace))
        return WRONG;
    for (size_t i = 0; i < count; i++)
        if (size[i] < 0 || place((uint64_t)size[i], &at, &rest, d->part + i))
            return WRONG;
    memory_release(mark);
    return rest == 0 ? NULL : WRONG;
}

problem details_read(const container *file, size_t chunks, size_t begin, details *result)
{
    span list = file->section[DETL];
    *result = (details){.step = 1, .list = list.data};
    if (!file->details)
        return NULL;
    if (list.size < HEAD || chunks > (list.size - HEAD) / 4)
        return WRONG;
    result->step = clgs_load32(list.data);
    if (result->step % 2 == 0 || result->step > MAX_STEP)
        return WRONG;
    const uint8_t *at = file->section[BODY].data + begin;
    uint64_t rest = file->body_size - begin;
    for (size_t i = 0; i < DETAILED; i++)
        if (place(clgs_load32(list.data + 4 + 8 * i), &at, &rest, &result->header[i]))
            return WRONG;
    result->part = memory_take((DETAILED * chunks + 1) * sizeof *result->part);
    if (!result->part)
        return NO_MEMORY;
    size_t known = HEAD + 4 * chunks;
    span coded = {list.data + known, list.size - known};
    return place_parts(result, coded, chunks, at, rest);
}

problem details_open(details *d, const size_t columns[DETAILED])
{
    for (size_t i = 0; i < DETAILED; i++) {
        span header = d->header[i];
        if (clgs_crc32c(header.data, header.size) != clgs_load32(d->list + 8 + 8 * i))
            return WRONG;
        problem wrong = attributes_open_details(header, 2 * columns[i], &d->model[i]);
        if (wrong)
            return wrong;
    }
    return NULL;
}

problem details_verify(const details *d, size_t chunk)
{
    const span *part = d->part + DETAILED * chunk;
    size_t size = 0;
    for (size_t i = 0; i < DETAILED; i++)
        size += part[i].size;
    uint32_t crc = clgs_load32(d->list + HEAD + 4 * chunk);
    return clgs_crc32c(part[0].data, size) == crc ? NULL : WRONG;
}

problem details_add(const details *d, size_t chunk, size_t part, const int32_t *near, size_t rows,
                    int32_t *value)
{
    const attributes *model = &d->model[part];
    size_t mark = memory_mark(), count = model->channels / 2 * rows;
    int32_t *pair = memory_take(8 * count); /* what the chunk has, and what must be added */
    if (!pair)
        return NO_MEMORY;
    for (size_t i = 0; i < count; i++) {
        pair[2 * i] = value[i];
        pair[2 * i + 1] = 0;
    }
    problem wrong = attributes_read(model, d->part[DETAILED * chunk + part], near, rows, pair);
    for (size_t i = 0; i < count; i++)
        value[i] = clgs_signed(d->step * (uint32_t)value[i] + (uint32_t)pair[2 * i + 1]);
    memory_release(mark);
    return wrong;
}
