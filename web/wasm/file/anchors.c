#include "anchors.h"

#include <string.h>

#include "clgs_codec.h"
#include "common/bytes.h"
#include "memory.h"

#define WRONG "the file's anchors are damaged; copy the file again"
#define HEAD_SIZE (2 + 3 * CLGS_MAX_VARINT)

const size_t COLUMNS_OF[CODED] = {3, 3 * OFFSETS, FEATURES, SCALINGS};

static const clgs_layer LAYERS[] = {{50, 53}, {50, 1}, {10, 50}, {10, 1}, {50, 53}, {50, 1},
                                    {30, 50}, {30, 1}, {50, 53}, {50, 1}, {70, 50}, {70, 1}};

/* Q of position, offset, feature, scaling. */
static double scale_of(const anchors *a, int part)
{
    return load_double(a->file->section[META].data + 16 + 8 * part);
}

problem anchors_open(const container *file, anchors *result)
{
    *result = (anchors){.file = file};
    problem wrong = directory_read(file, &result->list);
    if (wrong)
        return wrong;
    for (int i = 0; i < CODED; i++) {
        double scale = scale_of(result, i);
        if (!(scale >= 0x1p-64 && scale <= 0x1p64))
            return WRONG;
        result->array[i].integer = memory_take(4 * COLUMNS_OF[i] * result->list.anchors + 4);
        if (!result->array[i].integer)
            return NO_MEMORY;
        if (i > 0)
            wrong = attributes_open(result->list.header[i], COLUMNS_OF[i], &result->model[i]);
        if (wrong)
            return wrong;
    }
    result->weight = memory_take(4 * WEIGHTS);
    result->taken = memory_take(result->list.chunks + 1);
    if (!result->weight || !result->taken)
        return NO_MEMORY;
    memset(result->taken, 0, result->list.chunks + 1);
    return NULL;
}

size_t anchors_layers(const anchors *a, size_t bytes)
{
    size_t count = 0;
    while (count < a->list.layers && a->list.layer[count].bytes <= bytes)
        count++;
    return count;
}

size_t anchors_left(const anchors *a, size_t layers)
{
    if (layers <= a->layer)
        return 0;
    size_t chunks = a->list.layer[layers - 1].chunks - a->chunk;
    return !a->read + CODED * chunks - a->part + layers - a->layer;
}

/* What a stream that leaves out its corner and depth would begin with; returns the bytes. */
static size_t write_head(const chunk *c, uint8_t head[HEAD_SIZE])
{
    uint8_t *at = head;
    *at++ = 2;
    *at++ = (uint8_t)c->depth;
    for (int axis = 0; axis < 3; axis++)
        at = clgs_store_varint(at, c->corner[axis]);
    return (size_t)(at - head);
}

static problem read_positions(const chunk *c, int32_t *position)
{
    size_t mark = memory_mark(), size = c->part[0].size, head = 0;
    const uint8_t *data = c->part[0].data;
    uint8_t *copy = memory_take(size + HEAD_SIZE);
    void *workspace = memory_take(clgs_octree_workspace(c->rows));
    if (!copy || !workspace)
        return NO_MEMORY;
    if (size > 0 && data[0] == 3) {
        head = write_head(c, copy);
        memcpy(copy + head, data + 1, size - 1);
        data = copy;
        size += head - 1;
    }
    clgs_error error = clgs_octree_decode(data, size, position, c->rows, workspace);
    memory_release(mark);
    return error ? WRONG : NULL;
}

/* The near rows of a chunk; they stay until the chunk is complete. */
static problem find_near(anchors *a, const chunk *c, const int32_t *position)
{
    a->near = memory_take(4 * CLGS_NEAR * c->rows);
    size_t mark = memory_mark();
    void *workspace = memory_take(clgs_near_workspace(c->rows));
    if (!a->near || !workspace)
        return NO_MEMORY;
    clgs_error error = clgs_near(position, c->rows, a->near, workspace);
    memory_release(mark);
    return error ? WRONG : NULL;
}

/* Integers to the floats that are rendered, which may take the same memory. */
static void to_floats(const int32_t *integer, size_t count, double scale, void *to)
{
    for (size_t i = 0; i < count; i++) {
        float value = (float)(integer[i] / scale);
        memcpy((char *)to + sizeof value * i, &value, sizeof value);
    }
}

/* What chunks have to what the scene has without details. */
static problem multiply(int32_t *value, size_t count, uint32_t step)
{
    for (size_t i = 0; i < count && step > 1; i++) {
        int64_t product = value[i] * (int64_t)step;
        if (product < INT32_MIN || product > INT32_MAX)
            return WRONG;
        value[i] = (int32_t)product;
    }
    return NULL;
}

/* A part of a chunk that comes for the first time. */
static problem read_integers(anchors *a, const chunk *c, size_t part)
{
    int32_t *rows = a->array[part].integer + COLUMNS_OF[part] * c->first;
    problem wrong = part == 0
                        ? read_positions(c, rows)
                        : attributes_read(&a->model[part], c->part[part], a->near, c->rows, rows);
    if (wrong)
        return wrong;
    return part == 0 ? find_near(a, c, rows)
                     : multiply(rows, COLUMNS_OF[part] * c->rows, a->list.details.step);
}

/* Positions once more, for the near rows: the floats are not exactly what they were. */
static problem begin_details(anchors *a, const chunk *c)
{
    int32_t *position = memory_take(12 * c->rows);
    if (!position)
        return NO_MEMORY;
    problem wrong = details_verify(&a->list.details, (size_t)(c - a->list.chunk));
    if (!wrong)
        wrong = read_positions(c, position);
    return wrong ? wrong : find_near(a, c, position);
}

/* Attributes once more, with their details, as floats in the place of those without. */
static problem add_details(anchors *a, const chunk *c, size_t part)
{
    size_t mark = memory_mark(), count = COLUMNS_OF[part] * c->rows;
    int32_t *value = memory_take(4 * count);
    if (!value)
        return NO_MEMORY;
    problem wrong = attributes_read(&a->model[part], c->part[part], a->near, c->rows, value);
    if (!wrong)
        wrong = details_add(&a->list.details, (size_t)(c - a->list.chunk), part - 1, a->near,
                            c->rows, value);
    if (wrong)
        return wrong;
    to_floats(value, count, scale_of(a, (int)part),
              a->array[part].value + COLUMNS_OF[part] * c->first);
    memory_release(mark);
    return NULL;
}

static problem read_details(anchors *a, const chunk *c, size_t part)
{
    return part == 0 ? begin_details(a, c) : add_details(a, c, part);
}

/* The next part of the present chunk. */
static problem read_part(anchors *a)
{
    size_t chunks = a->list.chunks;
    int again = a->chunk >= chunks;
    const chunk *c = a->list.chunk + (again ? a->chunk - chunks : a->chunk);
    if (a->chunk == chunks && a->part == 0) {
        problem wrong = details_open(&a->list.details, COLUMNS_OF + 1);
        if (wrong)
            return wrong;
    }
    if (a->part == 0)
        a->chunk_mark = memory_mark();
    problem wrong = again ? read_details(a, c, a->part) : read_integers(a, c, a->part);
    if (++a->part == CODED) {
        a->part = 0;
        a->chunk++;
        memory_release(a->chunk_mark);
    }
    return wrong;
}

static problem read_weights(anchors *a)
{
    size_t mark = memory_mark(), layers = sizeof LAYERS / sizeof LAYERS[0];
    span data = a->file->section[MLPS];
    void *workspace = memory_take(clgs_weights_workspace(LAYERS, layers));
    uint32_t *word = memory_take(4 * WEIGHTS);
    if (!workspace || !word)
        return NO_MEMORY;
    if (clgs_weights_decode(data.data, data.size, word, LAYERS, layers, workspace))
        return WRONG;
    for (size_t i = 0; i < WEIGHTS; i++)
        if ((word[i] >> 23 & 255) == 255)
            return WRONG; /* not finite */
    memcpy(a->weight, word, 4 * WEIGHTS);
    memory_release(mark);
    return NULL;
}

/* The hash of the integers from row a->rows to `end`. */
static problem compare_hash(anchors *a, size_t end)
{
    uint8_t joined[8 * (CODED + 1)];
    for (int i = 0; i <= CODED; i++) {
        const void *array = a->weight;
        size_t count = WEIGHTS;
        if (i < CODED) {
            array = a->array[i].integer + COLUMNS_OF[i] * a->rows;
            count = COLUMNS_OF[i] * (end - a->rows);
        }
        uint64_t hash = clgs_xxh64(array, 4 * count); /* wasm is little-endian, as the hash is */
        clgs_store32(joined + 8 * i, (uint32_t)hash);
        clgs_store32(joined + 8 * i + 4, (uint32_t)(hash >> 32));
    }
    a->hash = clgs_xxh64(joined, sizeof joined);
    a->expected_hash = a->list.layer[a->layer].hash;
    return a->hash == a->expected_hash ? NULL
                                       : "the decoded integers do not match their hash; copy the "
                                         "file again";
}

/* Integers from row a->rows to `end` to the floats that are rendered, in place. */
static void dequantize(anchors *a, size_t end)
{
    for (int i = 0; i < CODED; i++) {
        int32_t *first = a->array[i].integer + COLUMNS_OF[i] * a->rows;
        to_floats(first, COLUMNS_OF[i] * (end - a->rows), scale_of(a, i), first);
    }
}

problem anchors_step(anchors *a)
{
    if (!a->read) {
        a->read = 1;
        return read_weights(a);
    }
    const layer *next = a->list.layer + a->layer;
    if (a->chunk < next->chunks)
        return read_part(a);
    if (next->chunks <= a->list.chunks) { /* a layer of anchors */
        problem wrong = compare_hash(a, next->rows);
        if (wrong)
            return wrong;
        dequantize(a, next->rows);
    }
    a->rows = next->rows;
    a->layer++;
    return NULL;
}

static problem verify_chunk(const chunk *c)
{
    size_t others = 0;
    for (int i = 1; i < CODED; i++)
        others += c->part[i].size;
    int same = clgs_crc32c(c->part[0].data, c->part[0].size) == c->crc[0] &&
               clgs_crc32c(c->part[1].data, others) == c->crc[1];
    return same ? NULL : WRONG;
}

/* Count the chunks that follow each other from the first on, and the layers that they complete. */
static void count_taken(anchors *a)
{
    const layer *layers = a->list.layer;
    while (a->chunk < a->list.chunks && a->taken[a->chunk])
        a->chunk++;
    while (a->layer < a->list.layers && layers[a->layer].chunks <= a->chunk) {
        a->rows = layers[a->layer].rows;
        a->layer++;
    }
}

problem anchors_take(anchors *a, size_t index)
{
    const chunk *c = a->list.chunk + index;
    size_t mark = memory_mark();
    problem wrong = verify_chunk(c);
    for (size_t part = 0; part < CODED && !wrong; part++)
        wrong = read_integers(a, c, part);
    if (wrong)
        return wrong;
    for (int i = 0; i < CODED; i++) {
        int32_t *first = a->array[i].integer + COLUMNS_OF[i] * c->first;
        to_floats(first, COLUMNS_OF[i] * c->rows, scale_of(a, i), first);
    }
    memory_release(mark);
    a->taken[index] = 1;
    count_taken(a);
    return NULL;
}
