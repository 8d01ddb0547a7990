/* Seeded arrays through every coder: a line per stream with its size, the hash of its bytes and
 * the hash of what it decodes to. The same on every machine, with every compiler.
 *
 *   vectors             prints the lines (tests/c/vectors.txt is this output)
 *   vectors FILE        compares them with those of FILE; exit code 1 if they differ
 */
#include <inttypes.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "attributes/model.h"
#include "clgs_codec.h"

#define MAX_LINE 100

static uint64_t random_state;
static FILE *expected;
static int differences;

static uint32_t random_u32(void)
{
    random_state = random_state * 6364136223846793005u + 1442695040888963407u;
    return (uint32_t)(random_state >> 32);
}

static void *allocate(size_t size)
{
    void *block = calloc(size > 0 ? size : 1, 1);
    if (!block)
        exit(2);
    return block;
}

/* XXH64 of words as little-endian bytes. */
static uint64_t hash_words(const int32_t *word, size_t count)
{
    uint8_t *bytes = allocate(4 * count);
    for (size_t i = 0; i < 4 * count; i++)
        bytes[i] = (uint8_t)((uint32_t)word[i / 4] >> 8 * (i % 4));
    uint64_t hash = clgs_xxh64(bytes, 4 * count);
    free(bytes);
    return hash;
}

static void report(const char *kind, const char *name, const uint8_t *data, size_t size,
                   uint64_t decoded)
{
    char line[MAX_LINE], other[MAX_LINE];
    snprintf(line, sizeof line, "%-10s %-20s %8lu %016" PRIx64 " %016" PRIx64 "\n", kind, name,
             (unsigned long)size, clgs_xxh64(data, size), decoded);
    if (!expected) {
        fputs(line, stdout);
    } else if (!fgets(other, sizeof other, expected) || strcmp(line, other) != 0) {
        printf("is %s", line);
        differences++;
    }
}

static void fail(const char *kind, const char *name)
{
    fprintf(stderr, "vectors: %s %s does not come back\n", kind, name);
    exit(1);
}

static void points(const char *name, const int32_t *position, size_t count, const int32_t origin[3])
{
    size_t bound = clgs_octree_bound(count);
    uint8_t *out = allocate(bound);
    int32_t *decoded = allocate(12 * count);
    void *workspace = allocate(clgs_octree_workspace(count));
    size_t size = clgs_octree_encode(position, count, origin, out, bound, workspace);
    if (size == 0 || clgs_octree_decode(out, size, decoded, count, workspace) != CLGS_OK ||
        memcmp(position, decoded, 12 * count) != 0)
        fail("octree", name);
    report("octree", name, out, size, hash_words(decoded, 3 * count));
    free(workspace);
    free(decoded);
    free(out);
}

/* Cells of a cube with edges of 2^depth cells, in Morton order, each kept with chance `keep` in
 * 2^16. */
static void cube(const char *name, uint32_t depth, uint32_t keep, uint32_t step)
{
    const int32_t origin[3] = {-7, INT32_MIN, 100};
    size_t count = 0, cells = (size_t)1 << 3 * depth;
    int32_t *position = allocate(12 * cells);
    for (uint32_t code = 0; code < cells; code++) {
        uint32_t cell[3] = {0, 0, 0};
        if (random_u32() >> 16 >= keep && code > 0)
            continue;
        for (uint32_t bit = 0; bit < 3 * depth; bit++)
            cell[2 - bit % 3] |= (code >> bit & 1) << bit / 3;
        for (size_t axis = 0; axis < 3; axis++)
            position[3 * count + axis] = origin[axis] + (int32_t)(cell[axis] * step);
        count++;
    }
    points(name, position, count, origin);
    free(position);
}

static void octrees(void)
{
    char name[32];
    const int32_t one[3] = {5, -2, 7}, corner[3] = {INT32_MAX, INT32_MIN, 0};
    points("one", one, 1, one);
    points("corner", corner, 1, corner);
    for (int depth = 1; depth <= CLGS_MAX_DEPTH; depth++) {
        const int32_t origin[3] = {0, 0, 0};
        int32_t far[6] = {0, 0, 0};
        far[3] = far[4] = far[5] = (int32_t)((1u << depth) - 1);
        snprintf(name, sizeof name, "two, depth %d", depth);
        points(name, far, 2, origin);
    }
    cube("full", 3, 65536, 1);
    cube("half", 4, 32768, 1);
    cube("thin", 5, 1500, 1);
    cube("spread", 4, 3000, 65536);
    cube("lonely", 4, 300, 131072);
}

static void rows(const char *name, const int32_t *value, size_t count, size_t channels)
{
    size_t bound = clgs_runlength_bound(count, channels);
    uint8_t *out = allocate(bound);
    int32_t *decoded = allocate(4 * count * channels);
    void *workspace = allocate(clgs_runlength_workspace(channels));
    size_t size = clgs_runlength_encode(value, count, channels, out, bound, workspace);
    if (clgs_runlength_decode(out, size, decoded, count, channels, workspace) != CLGS_OK)
        fail("runlength", name);
    report("runlength", name, out, size, hash_words(decoded, count * channels));
    size = clgs_paper_encode(value, count, channels, out, bound);
    if (clgs_paper_decode(out, size, decoded, count, channels) != CLGS_OK)
        fail("paper", name);
    report("paper", name, out, size, hash_words(decoded, count * channels));
    free(workspace);
    free(decoded);
    free(out);
}

/* A model as the encoder's search makes them: terms of predictions, activity, tables by counts. */
static void make_model(clgs_channel *model, const int32_t *value, const int32_t *near, size_t count,
                       size_t channels)
{
    size_t counts = CLGS_CELLS * CLGS_TABLE * channels;
    uint32_t *counted = allocate(4 * counts);
    uint64_t *cost = allocate(8 * channels);
    void *workspace = allocate(clgs_attributes_workspace(count, channels));
    void *chooser = allocate(clgs_attributes_choose_workspace());
    for (size_t j = 0; j < channels; j++) {
        clgs_channel *c = model + j;
        c->centre = value[j];
        c->taps = j % 3 > 0;
        c->tap[0] = (clgs_tap){(int32_t)j, j % 3 > 1 ? CLGS_TAP_NEAR : -1, 128};
        c->gain = 64;
        c->weight[0] = 1365;
        c->weight[1] = j > 0 ? 4096 / (int32_t)j : 0;
        c->span = j > 1 ? 2 : 0;
        c->classes = 1;
        c->frequency[0][0] = CLGS_SCALE;
    }
    if (clgs_attributes_count(model, value, near, count, channels, counted, workspace) ||
        clgs_attributes_choose(model, channels, counted, 256, cost, chooser))
        fail("attributes", "model");
    free(chooser);
    free(workspace);
    free(cost);
    free(counted);
}

/* Near rows of points on a bent sheet. */
static int32_t *near_rows(size_t count)
{
    int32_t *position = allocate(12 * count), *near = allocate(4 * CLGS_NEAR * count);
    void *workspace = allocate(clgs_near_workspace(count));
    for (size_t i = 0; i < count; i++) {
        int32_t x = (int32_t)(i / 7), y = (int32_t)(i % 7);
        position[3 * i] = x;
        position[3 * i + 1] = y * 3;
        position[3 * i + 2] = x * y / 2;
    }
    if (clgs_near(position, count, near, workspace) != CLGS_OK)
        fail("near", "rows");
    free(workspace);
    free(position);
    return near;
}

static void attributes(const char *name, const int32_t *value, size_t count, size_t channels)
{
    int32_t *near = near_rows(count);
    size_t model_size = clgs_attributes_model_size(channels);
    size_t room = clgs_attributes_header_bound(channels);
    clgs_channel *model = allocate(model_size), *read = allocate(model_size);
    uint8_t *header = allocate(room);
    int32_t *decoded = allocate(4 * count * channels);
    void *work = allocate(clgs_attributes_workspace(count, channels));
    void *header_work = allocate(clgs_attributes_header_workspace());
    make_model(model, value, near, count, channels);
    size_t length = clgs_attributes_header_write(model, channels, header, room, header_work);
    if (clgs_attributes_header_read(header, length, read, channels, header_work) != CLGS_OK)
        fail("header", name);
    report("header", name, header, length, 0);
    size_t bound = clgs_attributes_bound(read, count, channels);
    uint8_t *out = allocate(bound);
    size_t size = clgs_attributes_encode(read, value, near, count, channels, out, bound, work);
    if (clgs_attributes_decode(read, out, size, decoded, near, count, channels, work) != CLGS_OK)
        fail("attributes", name);
    report("attributes", name, out, size, hash_words(decoded, count * channels));
    free(header_work);
    free(work);
    free(decoded);
    free(header);
    free(out);
    free(read);
    free(model);
    free(near);
}

static void fill(int32_t *value, size_t count, uint32_t shift)
{
    for (size_t i = 0; i < count; i++) {
        uint32_t drawn = random_u32();
        uint32_t bits = drawn >> (shift + random_u32() % (32 - shift));
        value[i] = random_u32() & 1 ? (int32_t)(bits >> 1) : -(int32_t)(bits >> 1) - 1;
        if (i / 60 % 3 == 0)
            value[i] = 0;
    }
}

static void matrices(void)
{
    enum { COUNT = 1 << 20 };
    static const uint8_t channels[] = {1, 2, 3, 4, 5, 6, 7, 8, 16, 30, 50, 63, 64};
    const int32_t extremes[12] = {INT32_MIN, INT32_MAX, 0, 1, INT32_MAX, INT32_MIN,
                                  -1,        0,         7, 0, INT32_MIN, INT32_MIN};
    int32_t *value = allocate(4 * COUNT);
    char name[32];
    rows("none", value, 0, 3);
    rows("extremes", extremes, 4, 3);
    attributes("extremes", extremes, 4, 3);
    for (size_t i = 0; i < sizeof channels; i++) {
        fill(value, 40 * (size_t)channels[i], 26);
        snprintf(name, sizeof name, "%d channels", channels[i]);
        rows(name, value, 40, channels[i]);
        attributes(name, value, 40, channels[i]);
    }
    fill(value, 3000, 0);
    rows("wide", value, 500, 6);
    attributes("wide", value, 500, 6);
    memset(value, 0, 4 * COUNT);
    for (size_t run = 1; run < COUNT; run *= 2) {
        value[run] = 1;
        snprintf(name, sizeof name, "run of %lu", (unsigned long)run);
        rows(name, value, run + 1, 1);
        value[run] = 0;
    }
    free(value);
}

static void words(const char *name, const int32_t *word, const clgs_layer *layer)
{
    size_t count = (size_t)layer->rows * layer->columns;
    size_t bound = clgs_weights_bound(layer, 1), size = clgs_planes_bound(count);
    uint8_t *out = allocate(bound > size ? bound : size);
    uint32_t *decoded = allocate(4 * count);
    void *workspace = allocate(clgs_planes_workspace());
    size = clgs_planes_encode((const uint32_t *)word, count, out, size, workspace);
    if (clgs_planes_decode(out, size, decoded, count, workspace) != CLGS_OK)
        fail("planes", name);
    report("planes", name, out, size, hash_words((int32_t *)decoded, count));
    free(workspace);
    workspace = allocate(clgs_weights_workspace(layer, 1));
    size = clgs_weights_encode((const uint32_t *)word, layer, 1, out, bound, workspace);
    if (clgs_weights_decode(out, size, decoded, layer, 1, workspace) != CLGS_OK)
        fail("weights", name);
    report("weights", name, out, size, hash_words((int32_t *)decoded, count));
    free(workspace);
    free(decoded);
    free(out);
}

static void weights(void)
{
    const clgs_layer layer = {20, 15};
    int32_t word[300];
    for (size_t i = 0; i < 300; i++) { /* multiples of 2^-10 in [-1/2, 1/2) */
        float value = (float)(random_u32() % 1024) / 1024.0f - 0.5f;
        memcpy(word + i, &value, 4);
    }
    words("multiples", word, &layer);
    fill(word, 300, 0);
    for (size_t i = 0; i < 300; i++)
        word[i] = word[i] & 0x3FFFFFFF;
    words("noise", word, &layer);
    memset(word, 0, sizeof word);
    words("zeros", word, &layer);
}

int main(int argc, char **argv)
{
    if (argc > 1 && !(expected = fopen(argv[1], "r"))) {
        fprintf(stderr, "vectors: %s cannot be read\n", argv[1]);
        return 2;
    }
    octrees();
    matrices();
    weights();
    char rest[MAX_LINE];
    if (expected && (differences > 0 || fgets(rest, sizeof rest, expected))) {
        printf("vectors: %d lines differ from %s; write it again if the encoder was changed\n",
               differences, argv[1]);
        return 1;
    }
    return 0;
}
