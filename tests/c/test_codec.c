/* Round trips, truncations, bit flips and random damage of every stream kind.
 *
 * Inputs and outputs lie in allocations of their exact size, so that the address sanitizer sees
 * the first byte outside. A damaged stream may decode to other values, but must end.
 */
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "clgs_codec.h"

#define CHECK(condition) check((condition) != 0, #condition, __LINE__)

#define ROUNDS 60     /* of random damage of a stream */
#define EVERY_BIT 512 /* flips: all of the first bits, then one of every byte */

typedef enum stream_part { OCTREE, RUNLENGTH, PAPER, PLANES, WEIGHTS } stream_part;

typedef struct stream {
    stream_part part;
    size_t rows, channels;
    int32_t *value;
    uint8_t *data;
    size_t size;
    void *workspace; /* of its exact size, too */
} stream;

static uint64_t random_state = 1;

static void check(int holds, const char *condition, int line)
{
    if (holds)
        return;
    fprintf(stderr, "test_codec.c:%d: %s\n", line, condition);
    exit(1);
}

static uint32_t random_u32(void)
{
    random_state = random_state * 6364136223846793005u + 1442695040888963407u;
    return (uint32_t)(random_state >> 32);
}

static void *allocate(size_t size)
{
    void *block = malloc(size > 0 ? size : 1);
    CHECK(block != NULL);
    return block;
}

static size_t words(const stream *s)
{
    return s->rows * s->channels;
}

/* The rows of a stream of weights, as one matrix. */
static clgs_layer layer_of(const stream *s)
{
    return (clgs_layer){(uint32_t)s->rows, (uint32_t)s->channels};
}

static size_t workspace_size(const stream *s)
{
    clgs_layer layer = layer_of(s);
    if (s->part == WEIGHTS)
        return clgs_weights_workspace(&layer, 1);
    if (s->part == OCTREE)
        return clgs_octree_workspace(s->rows);
    if (s->part == PAPER)
        return 0;
    return s->part == RUNLENGTH ? clgs_runlength_workspace(s->channels) : clgs_planes_workspace();
}

static size_t bound(const stream *s)
{
    clgs_layer layer = layer_of(s);
    if (s->part == WEIGHTS)
        return clgs_weights_bound(&layer, 1);
    if (s->part == OCTREE)
        return clgs_octree_bound(s->rows);
    if (s->part == PAPER)
        return clgs_paper_bound(s->rows, s->channels);
    return s->part == RUNLENGTH ? clgs_runlength_bound(s->rows, s->channels)
                                : clgs_planes_bound(s->rows);
}

static void find_least(const stream *s, int32_t least[3])
{
    memcpy(least, s->value, 3 * sizeof least[0]);
    for (size_t i = 0; i < 3 * s->rows; i++)
        if (s->value[i] < least[i % 3])
            least[i % 3] = s->value[i];
}

static size_t encode(const stream *s, uint8_t *out, size_t capacity)
{
    size_t size;
    int32_t origin[3];
    clgs_layer layer = layer_of(s);
    if (s->part == OCTREE) {
        find_least(s, origin);
        size = clgs_octree_encode(s->value, s->rows, origin, out, capacity, s->workspace);
    } else if (s->part == RUNLENGTH)
        size = clgs_runlength_encode(s->value, s->rows, s->channels, out, capacity, s->workspace);
    else if (s->part == PAPER)
        size = clgs_paper_encode(s->value, s->rows, s->channels, out, capacity);
    else if (s->part == WEIGHTS)
        size = clgs_weights_encode((uint32_t *)s->value, &layer, 1, out, capacity, s->workspace);
    else
        size = clgs_planes_encode((uint32_t *)s->value, s->rows, out, capacity, s->workspace);
    return size;
}

static clgs_error decode(const stream *s, const uint8_t *data, size_t size, int32_t *value)
{
    uint8_t *exact = allocate(size);
    clgs_layer layer = layer_of(s);
    clgs_error error;
    if (size > 0)
        memcpy(exact, data, size);
    if (s->part == OCTREE)
        error = clgs_octree_decode(exact, size, value, s->rows, s->workspace);
    else if (s->part == RUNLENGTH)
        error = clgs_runlength_decode(exact, size, value, s->rows, s->channels, s->workspace);
    else if (s->part == PAPER)
        error = clgs_paper_decode(exact, size, value, s->rows, s->channels);
    else if (s->part == WEIGHTS)
        error = clgs_weights_decode(exact, size, (uint32_t *)value, &layer, 1, s->workspace);
    else
        error = clgs_planes_decode(exact, size, (uint32_t *)value, s->rows, s->workspace);
    free(exact);
    return error;
}

static void test_round_trip(stream *s, int32_t *value)
{
    size_t capacity = bound(s);
    uint8_t *out = allocate(capacity);
    s->size = encode(s, out, capacity);
    CHECK(s->size > 0 && s->size <= capacity);
    s->data = allocate(s->size);
    memcpy(s->data, out, s->size);
    CHECK(encode(s, out, capacity) == s->size && memcmp(out, s->data, s->size) == 0);
    CHECK(encode(s, out, capacity - 1) == 0);
    free(out);
    CHECK(decode(s, s->data, s->size, value) == CLGS_OK);
    CHECK(memcmp(value, s->value, 4 * words(s)) == 0);
}

/* Cut by a byte or two, one stream in some hundreds is the whole stream of other values. */
static void test_lengths(const stream *s, int32_t *value)
{
    for (size_t size = 0; size < s->size; size++)
        CHECK(decode(s, s->data, size, value) < 0 ||
              (size + 2 >= s->size && memcmp(value, s->value, 4 * words(s)) != 0));
    uint8_t *longer = allocate(s->size + 16);
    memcpy(longer, s->data, s->size);
    memset(longer + s->size, 0, 16);
    for (size_t more = 1; more <= 16; more++)
        CHECK(decode(s, longer, s->size + more, value) < 0);
    free(longer);
}

static void test_damage(const stream *s, int32_t *value)
{
    uint8_t *damaged = allocate(s->size);
    for (size_t bit = 0; bit < 8 * s->size; bit += bit < EVERY_BIT ? 1 : 9) {
        memcpy(damaged, s->data, s->size);
        damaged[bit / 8] ^= (uint8_t)(1u << (bit & 7));
        CHECK(clgs_error_text(decode(s, damaged, s->size, value)) != NULL);
    }
    for (int round = 0; round < ROUNDS; round++) {
        memcpy(damaged, s->data, s->size);
        for (uint32_t n = random_u32() % 8 + 1; n > 0; n--)
            damaged[random_u32() % s->size] = (uint8_t)random_u32();
        CHECK(clgs_error_text(decode(s, damaged, s->size, value)) != NULL);
    }
    for (int round = 0; round < ROUNDS; round++) {
        for (size_t i = 2; i < s->size; i++)
            damaged[i] = (uint8_t)random_u32();
        damaged[0] = s->part == WEIGHTS || s->part == OCTREE ? 2 : 1; /* coded, not raw */
        if (s->size > 1)
            damaged[1] = (uint8_t)(random_u32() % 22);
        CHECK(clgs_error_text(decode(s, damaged, s->size, value)) != NULL);
    }
    free(damaged);
}

static void test_stream(stream_part part, size_t rows, size_t channels, const int32_t *source)
{
    stream s = {.part = part, .rows = rows, .channels = channels};
    size_t size = 4 * rows * channels;
    int32_t *value = allocate(size);
    s.value = allocate(size);
    memcpy(s.value, source, size);
    s.workspace = allocate(workspace_size(&s));
    test_round_trip(&s, value);
    test_lengths(&s, value);
    test_damage(&s, value);
    free(value);
    free(s.value);
    free(s.data);
    free(s.workspace);
}

/* A box with edges of `edge` cells, in Morton order, each cell kept with chance `keep` / 256. */
static size_t fill_box(int32_t *position, uint32_t edge, uint32_t keep, int32_t scale)
{
    size_t count = 0;
    for (uint32_t code = 0; code < edge * edge * edge; code++) {
        int32_t cell[3] = {0, 0, 0};
        if (random_u32() % 256 >= keep)
            continue;
        for (uint32_t bit = 0; bit < 30; bit++)
            cell[2 - bit % 3] |= (int32_t)((code >> bit & 1) << bit / 3);
        for (int axis = 0; axis < 3; axis++)
            position[3 * count + (size_t)axis] = cell[axis] * scale - 1000;
        count++;
    }
    return count;
}

/* Points with no others near: they are coded whole. */
static size_t fill_line(int32_t *position, size_t count)
{
    for (size_t i = 0; i < 3 * count; i++)
        position[i] = (int32_t)(i / 3 * 5003);
    return count;
}

static void test_octrees(void)
{
    int32_t position[3 * 512];
    const int32_t far_apart[6] = {INT32_MAX - 0x1FFFFF, 0, -5, INT32_MAX, 0x1FFFFF, 0x1FFFFF - 5};
    const int32_t too_wide[6] = {0, 0, 0, 0x200000, 0, 0};
    const int32_t twins[6] = {1, 2, 3, 1, 2, 3};
    const int32_t unsorted[6] = {1, 0, 0, 0, 0, 0};
    uint8_t out[64];
    stream bad = {.part = OCTREE, .rows = 2, .channels = 3};
    test_stream(OCTREE, fill_box(position, 4, 256, 1), 3, position);
    test_stream(OCTREE, fill_box(position, 8, 60, 1), 3, position);
    test_stream(OCTREE, fill_box(position, 8, 30, 262144), 3, position);
    test_stream(OCTREE, 2, 3, far_apart);
    test_stream(OCTREE, 1, 3, far_apart);
    test_stream(OCTREE, fill_line(position, 200), 3, position);
    bad.workspace = allocate(workspace_size(&bad));
    bad.value = (int32_t *)too_wide;
    CHECK(encode(&bad, out, sizeof out) == 0);
    bad.value = (int32_t *)twins;
    CHECK(encode(&bad, out, sizeof out) == 0);
    bad.value = (int32_t *)unsorted;
    CHECK(encode(&bad, out, sizeof out) == 0);
    free(bad.workspace);
}

/* What the header promises for shapes out of range. */
static void test_shapes_out_of_range(void)
{
    const int32_t origin[3] = {0, 0, 0};
    const clgs_layer wide = {1, CLGS_MAX_COLUMNS + 1}, one = {1, 1};
    uint32_t word[1] = {0};
    int32_t value[3] = {0, 0, 0};
    uint8_t data[64] = {0};
    size_t many = CLGS_MAX_POINTS + 1;
    void *workspace = allocate(clgs_octree_workspace(1));
    CHECK(clgs_octree_bound(many) == 0 && clgs_octree_workspace(many) == 0);
    CHECK(clgs_octree_encode(value, 0, origin, data, sizeof data, workspace) == 0);
    CHECK(clgs_octree_encode(value, many, origin, data, sizeof data, workspace) == 0);
    CHECK(clgs_octree_decode(data, 1, value, 0, workspace) == CLGS_ERROR_ARGUMENT);
    CHECK(clgs_octree_decode(data, 1, value, many, workspace) == CLGS_ERROR_ARGUMENT);
    CHECK(clgs_planes_encode(word, many, data, sizeof data, workspace) == 0);
    CHECK(clgs_planes_decode(data, 1, word, many, workspace) == CLGS_ERROR_ARGUMENT);
    CHECK(clgs_runlength_encode(value, 1, 0, data, sizeof data, workspace) == 0);
    CHECK(clgs_runlength_decode(data, 1, value, 1, 0, workspace) == CLGS_ERROR_ARGUMENT);
    CHECK(clgs_paper_encode(value, many, 1, data, sizeof data) == 0);
    CHECK(clgs_paper_decode(data, 1, value, 1, 257) == CLGS_ERROR_ARGUMENT);
    CHECK(clgs_weights_encode(word, &wide, 1, data, sizeof data, workspace) == 0);
    CHECK(clgs_weights_encode(word, &one, 1, data, 4, workspace) == 0);
    CHECK(clgs_weights_decode(data, 1, word, &wide, 1, workspace) == CLGS_ERROR_ARGUMENT);
    free(workspace);
}

static void test_error_texts(void)
{
    for (int error = CLGS_ERROR_CORRUPT - 1; error <= CLGS_OK; error++)
        CHECK(strlen(clgs_error_text((clgs_error)error)) > 7);
    CHECK(strcmp(clgs_error_text(CLGS_ERROR_TRUNCATED), clgs_error_text(CLGS_OK)) != 0);
}

static void fill_values(int32_t *value, size_t count, uint32_t shift)
{
    for (size_t i = 0; i < count; i++) {
        uint32_t bits = random_u32() >> (shift + random_u32() % (32 - shift));
        value[i] = random_u32() & 1 ? (int32_t)(bits >> 1) : -(int32_t)(bits >> 1) - 1;
        if (i / 60 % 3 == 0)
            value[i] = 0;
    }
}

static void test_rows(stream_part part)
{
    int32_t value[600];
    fill_values(value, 600, 27);
    test_stream(part, 100, 6, value);
    test_stream(part, 2, 256, value);
    fill_values(value, 600, 0);
    test_stream(part, 60, 5, value);
    memset(value, 0, sizeof value);
    test_stream(part, 300, 2, value);
    CHECK(clgs_runlength_bound(1, 0) == 0 && clgs_runlength_bound(1, 257) == 0);
    CHECK(clgs_runlength_bound(CLGS_MAX_POINTS + 1, 1) == 0);
    CHECK(clgs_runlength_workspace(0) == 0 && clgs_runlength_workspace(257) == 0);
    CHECK(clgs_paper_bound(1, 0) == 0 && clgs_paper_bound(1, 257) == 0);
    CHECK(clgs_paper_bound(CLGS_MAX_POINTS + 1, 1) == 0);
}

static void test_planes(void)
{
    int32_t word[200];
    for (size_t i = 0; i < 200; i++)
        word[i] = (int32_t)((random_u32() & 0x80FFF000u) | 0x3C000000u);
    test_stream(PLANES, 200, 1, word);
    fill_values(word, 200, 0);
    test_stream(PLANES, 50, 1, word);
    test_stream(PLANES, 0, 1, word);
}

static uint32_t word_of(float value)
{
    uint32_t word;
    memcpy(&word, &value, sizeof word);
    return word;
}

static void test_weights(void)
{
    const clgs_layer wide = {1, CLGS_MAX_COLUMNS + 1}, long_one = {CLGS_MAX_ROWS + 1, 1};
    int32_t word[200];
    for (size_t i = 0; i < 200; i++)
        word[i] = (int32_t)word_of((float)(random_u32() % 2048) / 1024.0f - 0.5f);
    test_stream(WEIGHTS, 20, 10, word);
    for (size_t i = 0; i < 200; i++)
        word[i] = (int32_t)(random_u32() >> 8 & ~(uint32_t)0 << random_u32() % 24);
    test_stream(WEIGHTS, 50, 4, word);
    fill_values(word, 200, 0);
    test_stream(WEIGHTS, 10, 5, word);
    memset(word, 0, sizeof word);
    test_stream(WEIGHTS, 10, 20, word);
    CHECK(clgs_weights_bound(&wide, 1) == 0 && clgs_weights_bound(&long_one, 1) == 0);
    CHECK(clgs_weights_bound(&wide, CLGS_MAX_LAYERS + 1) == 0);
    CHECK(clgs_weights_workspace(&wide, 1) == 0);
}

static void test_checksums(void)
{
    uint8_t noise[1100];
    CHECK(clgs_crc32c((const uint8_t *)"123456789", 9) == 0xE3069283u);
    CHECK(clgs_crc32c_portable((const uint8_t *)"123456789", 9) == 0xE3069283u);
    CHECK(clgs_xxh64(noise, 0) == 0xEF46DB3751D8E999u);
    CHECK(clgs_xxh64((const uint8_t *)"abc", 3) == 0x44BC2CF5AD770999u);
    for (size_t i = 0; i < sizeof noise; i++)
        noise[i] = (uint8_t)((uint32_t)i * 2654435761u >> 24);
    for (size_t size = 0; size <= sizeof noise; size++) {
        uint8_t *exact = allocate(size);
        memcpy(exact, noise, size);
        CHECK(clgs_crc32c(exact, size) == clgs_crc32c_portable(exact, size));
        free(exact);
    }
}

int main(void)
{
    test_checksums();
    test_error_texts();
    test_shapes_out_of_range();
    test_octrees();
    test_rows(RUNLENGTH);
    test_rows(PAPER);
    test_planes();
    test_weights();
    puts("codec: all tests passed");
    return 0;
}
