#include "arrays.h"

#include <string.h>

#include "clgs_codec.h"
#include "common/bytes.h"
#include "memory.h"

#define WRONG "the file's arrays are damaged; copy the file again"
#define POSITIONS 0x0250438Bu
#define LATTICE 0x0350438Bu
#define ATTRIBUTES 0x0241438Bu
#define POINTS 131072 /* per chunk of positions */
#define ROWS 65536
#define MAX_POINTS_PER_BYTE 32768

/* The octrees of `count` points, whose lengths are at byte `at` of `data`. */
static problem read_octrees(span data, size_t at, size_t count, int32_t *position)
{
    size_t chunks = (count + POINTS - 1) / POINTS, begin = at + 4 * chunks;
    if (chunks > data.size / 4 || begin + 4 > data.size)
        return WRONG;
    for (size_t i = 0; i < chunks; i++) {
        size_t length = clgs_load32(data.data + at + 4 * i), mark = memory_mark();
        size_t points = count - POINTS * i < POINTS ? count - POINTS * i : POINTS;
        if (length > data.size - 4 - begin || points > length * (uint64_t)MAX_POINTS_PER_BYTE)
            return WRONG;
        void *workspace = memory_take(clgs_octree_workspace(points));
        if (!workspace)
            return NO_MEMORY;
        if (clgs_octree_decode(data.data + begin, length, position + 3 * POINTS * i, points,
                               workspace))
            return WRONG;
        memory_release(mark);
        begin += length;
    }
    return begin + 4 == data.size ? NULL : WRONG;
}

static void find_least(const int32_t *position, size_t count, int32_t least[3])
{
    for (int axis = 0; axis < 3; axis++) {
        least[axis] = position[axis];
        for (size_t i = 1; i < count; i++)
            least[axis] = position[3 * i + (size_t)axis] < least[axis]
                              ? position[3 * i + (size_t)axis]
                              : least[axis];
    }
}

/* Sort codes, and the numbers that go with them, by bytes; both end where they began. */
static void sort_codes(uint64_t *code, uint32_t *number, uint64_t *spare, uint32_t *spare_number,
                       size_t count)
{
    for (int shift = 0; shift < 64; shift += 8) {
        size_t start[256] = {0}, sum = 0;
        for (size_t i = 0; i < count; i++)
            start[code[i] >> shift & 255]++;
        for (int digit = 0; digit < 256; digit++) {
            size_t here = start[digit];
            start[digit] = sum;
            sum += here;
        }
        for (size_t i = 0; i < count; i++) {
            size_t at = start[code[i] >> shift & 255]++;
            spare[at] = code[i];
            spare_number[at] = number[i];
        }
        memcpy(code, spare, 8 * count);
        memcpy(number, spare_number, 4 * count);
    }
}

/* Put positions in Morton order. */
static problem sort_positions(int32_t *position, size_t count)
{
    size_t mark = memory_mark();
    uint64_t *code = memory_take(16 * count);
    uint32_t *number = memory_take(8 * count);
    int32_t *copy = memory_take(12 * count), least[3];
    if (!code || !number || !copy)
        return NO_MEMORY;
    find_least(position, count, least);
    if (clgs_morton_encode(position, count, least, code))
        return WRONG;
    for (size_t i = 0; i < count; i++)
        number[i] = (uint32_t)i;
    sort_codes(code, number, code + count, number + count, count);
    memcpy(copy, position, 12 * count);
    for (size_t i = 0; i < count; i++)
        memcpy(position + 3 * i, copy + 3 * (size_t)number[i], 12);
    memory_release(mark);
    return NULL;
}

/* From a lattice with these factors back to positions. */
static problem grow(const uint8_t *factors, int32_t *position, size_t count)
{
    int32_t least[3];
    find_least(position, count, least);
    for (size_t i = 0; i < 3 * count; i++) {
        int64_t factor = clgs_load32(factors + 4 * (i % 3));
        int64_t value = least[i % 3] + factor * ((int64_t)position[i] - least[i % 3]);
        if (factor < 1 || value > INT32_MAX)
            return WRONG;
        position[i] = (int32_t)value;
    }
    return sort_positions(position, count);
}

problem positions_read(span data, size_t count, int32_t *position)
{
    if (data.size < 12 || clgs_load32(data.data + 4) != count)
        return WRONG;
    if (clgs_load32(data.data) == POSITIONS)
        return read_octrees(data, 8, count, position);
    if (clgs_load32(data.data) != LATTICE || data.size < 24 || count == 0)
        return WRONG;
    problem wrong = read_octrees(data, 20, count, position);
    return wrong ? wrong : grow(data.data + 8, position, count);
}

problem rows_open(span data, size_t count, size_t channels, rows *result)
{
    *result = (rows){.count = count, .chunks = (count + ROWS - 1) / ROWS};
    if (data.size < 18 || clgs_load32(data.data) != ATTRIBUTES ||
        clgs_load32(data.data + 4) != count || (clgs_load32(data.data + 8) & 0xFFFF) != channels)
        return WRONG;
    size_t header = clgs_load32(data.data + 10), most = data.size - 18;
    if (result->chunks > most / 4 || header > most - 4 * result->chunks)
        return WRONG;
    result->length = data.data + 14;
    result->at = result->length + 4 * result->chunks + header;
    result->left = most - 4 * result->chunks - header;
    return attributes_open((span){result->at - header, header}, channels, &result->model);
}

size_t rows_next(const rows *from)
{
    size_t rest = from->count - ROWS * from->chunk;
    return rest < ROWS ? rest : ROWS;
}

problem rows_read(rows *from, int32_t *value)
{
    size_t length = clgs_load32(from->length + 4 * from->chunk);
    if (length > from->left)
        return WRONG;
    problem wrong =
        attributes_read(&from->model, (span){from->at, length}, NULL, rows_next(from), value);
    from->at += length;
    from->left -= length;
    from->chunk++;
    return wrong;
}
