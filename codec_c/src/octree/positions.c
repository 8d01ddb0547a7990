/* Positions as a stream: its first bytes, then the levels of an octree or, if that is longer, plain
 * Morton codes. */
#include "common/bytes.h"
#include "octree/morton.h"
#include "octree/tree.h"

/* The first byte of a stream. A chunk of a scene has 3 for an octree without depth and origin,
 * which its caller knows and puts back. */
#define MODE_RAW 0                              /* Morton codes as they are */
#define MODE_OCTREE 2                           /* coded level by level */
#define RAW_HEADER 14                           /* mode, depth, origin as words */
#define OCTREE_HEADER (2 + 3 * CLGS_MAX_VARINT) /* mode, depth, origin as varints, at most */

typedef struct header {
    uint32_t mode, depth;
    int32_t origin[3];
    size_t size;
} header;

clgs_error clgs_morton_encode(const int32_t *position, size_t count, const int32_t origin[3],
                              uint64_t *code)
{
    for (size_t i = 0; i < count; i++) {
        uint64_t interleaved = 0;
        for (int axis = 0; axis < 3; axis++) {
            int64_t cell = (int64_t)position[3 * i + (size_t)axis] - origin[axis];
            if (cell < 0 || cell >= (int64_t)1 << CLGS_MAX_DEPTH)
                return CLGS_ERROR_ARGUMENT;
            interleaved |= clgs_spread((uint64_t)cell) << (2 - axis);
        }
        code[i] = interleaved;
    }
    return CLGS_OK;
}

size_t clgs_octree_bound(size_t count)
{
    return count > CLGS_MAX_POINTS ? 0 : OCTREE_HEADER + 8 * count;
}

size_t clgs_octree_workspace(size_t count)
{
    if (count > CLGS_MAX_POINTS || count > SIZE_MAX / 512)
        return 0;
    return clgs_align(8 * count) + clgs_tree_size(count);
}

/* Levels below the root that hold every code; codes must ascend. Returns 0 if they do not. */
static int find_depth(const uint64_t *code, size_t count, uint32_t *depth)
{
    uint64_t all = 0;
    for (size_t i = 0; i < count; i++) {
        if (i > 0 && code[i] <= code[i - 1])
            return 0;
        all |= code[i];
    }
    for (*depth = 0; *depth < CLGS_MAX_DEPTH && all >> (3 * *depth);)
        ++*depth;
    return 1;
}

static void begin_header(uint8_t *out, uint32_t mode, uint32_t depth)
{
    out[0] = (uint8_t)mode;
    out[1] = (uint8_t)depth;
}

static size_t encode_raw(const header *head, const uint64_t *code, size_t count, uint8_t *out)
{
    begin_header(out, MODE_RAW, head->depth);
    for (int axis = 0; axis < 3; axis++)
        clgs_store32(out + 2 + 4 * axis, (uint32_t)head->origin[axis]);
    for (size_t i = 0; i < 2 * count; i++)
        clgs_store32(out + RAW_HEADER + 4 * i, (uint32_t)(code[i / 2] >> 32 * (i & 1)));
    return RAW_HEADER + 8 * count;
}

size_t clgs_octree_encode(const int32_t *position, size_t count, const int32_t origin[3],
                          uint8_t *out, size_t capacity, void *workspace)
{
    header head = {.origin = {origin[0], origin[1], origin[2]}};
    uint64_t *code = workspace;
    uint8_t *at = out + 2;
    if (count == 0 || count > CLGS_MAX_POINTS || capacity < clgs_octree_bound(count))
        return 0;
    if (clgs_morton_encode(position, count, origin, code) != CLGS_OK)
        return 0;
    if (!find_depth(code, count, &head.depth))
        return 0;
    begin_header(out, MODE_OCTREE, head.depth);
    for (int axis = 0; axis < 3; axis++)
        at = clgs_store_varint(at, origin[axis]);
    size_t first = (size_t)(at - out);
    size_t size = clgs_tree_encode(code, count, head.depth, at, RAW_HEADER + 8 * count - first,
                                   (uint8_t *)workspace + clgs_align(8 * count));
    return size > 0 ? first + size : encode_raw(&head, code, count, out);
}

static clgs_error decode_raw(const uint8_t *data, size_t size, uint64_t *code, size_t count,
                             uint32_t depth)
{
    if (size != 8 * count)
        return size < 8 * count ? CLGS_ERROR_TRUNCATED : CLGS_ERROR_TRAILING;
    for (size_t i = 0; i < count; i++) {
        code[i] = clgs_load32(data + 8 * i) | (uint64_t)clgs_load32(data + 8 * i + 4) << 32;
        if (code[i] >> 3 * depth || (i > 0 && code[i] <= code[i - 1]))
            return CLGS_ERROR_CORRUPT;
    }
    return CLGS_OK;
}

static clgs_error store_positions(const uint64_t *code, size_t count, const int32_t origin[3],
                                  int32_t *position)
{
    int64_t most = 0;
    for (size_t i = 0; i < count; i++)
        for (uint32_t axis = 0; axis < 3; axis++) {
            int64_t cell = (int64_t)origin[axis] + clgs_gather(code[i] >> (2 - axis));
            most = cell > most ? cell : most;
            position[3 * i + axis] = (int32_t)(uint32_t)cell;
        }
    return most > INT32_MAX ? CLGS_ERROR_CORRUPT : CLGS_OK;
}

static clgs_error read_raw_header(const uint8_t *data, size_t size, header *head)
{
    if (size < RAW_HEADER)
        return CLGS_ERROR_TRUNCATED;
    for (int axis = 0; axis < 3; axis++)
        head->origin[axis] = clgs_signed(clgs_load32(data + 2 + 4 * axis));
    head->size = RAW_HEADER;
    return CLGS_OK;
}

static clgs_error read_octree_header(const uint8_t *data, size_t size, header *head)
{
    const uint8_t *at = data + 2, *end = data + size;
    for (int axis = 0; axis < 3; axis++) {
        const uint8_t *start = at;
        at = clgs_load_varint(at, end, head->origin + axis);
        if (!at || (at > start + 1 && at[-1] == 0)) /* cut, or longer than an encoder writes it */
            return CLGS_ERROR_CORRUPT;
    }
    head->size = (size_t)(at - data);
    return CLGS_OK;
}

static clgs_error read_header(const uint8_t *data, size_t size, header *head)
{
    if (size < 2)
        return CLGS_ERROR_TRUNCATED;
    *head = (header){.mode = data[0], .depth = data[1]};
    if (head->depth > CLGS_MAX_DEPTH)
        return CLGS_ERROR_CORRUPT;
    if (head->mode == MODE_RAW)
        return read_raw_header(data, size, head);
    return head->mode == MODE_OCTREE ? read_octree_header(data, size, head) : CLGS_ERROR_CORRUPT;
}

clgs_error clgs_octree_decode(const uint8_t *data, size_t size, int32_t *position, size_t count,
                              void *workspace)
{
    header head;
    if (count == 0 || count > CLGS_MAX_POINTS)
        return CLGS_ERROR_ARGUMENT;
    clgs_error error = read_header(data, size, &head);
    if (error)
        return error;
    uint64_t *code = workspace;
    uint8_t *memory = (uint8_t *)workspace + clgs_align(8 * count);
    data += head.size;
    size -= head.size;
    if (head.mode == MODE_RAW)
        error = decode_raw(data, size, code, count, head.depth);
    else
        error = clgs_tree_decode(data, size, code, count, head.depth, memory);
    return error ? error : store_positions(code, count, head.origin, position);
}
