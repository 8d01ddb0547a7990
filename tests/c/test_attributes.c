/* Round trips, truncations, bit flips and random damage of attribute headers and chunks.
 *
 * Inputs and outputs lie in allocations of their exact size, so that the address sanitizer sees
 * the first byte outside. Damage may decode to other values, but must end.
 */
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "attributes/model.h"
#include "attributes/columns.h"

#define CHECK(condition) check((condition) != 0, #condition, __LINE__)
#define COUNTS (CLGS_CELLS * CLGS_TABLE)

#define EVERY_BIT 512 /* flips: all of the first bits, then one of every byte */

typedef struct stream {
    size_t rows, channels;
    int32_t *value, *near;
    clgs_channel *model;
    void *workspace;
    uint8_t *header, *data;
    size_t header_size, size;
} stream;

static uint64_t random_state = 1;

static void check(int holds, const char *condition, int line)
{
    if (holds)
        return;
    fprintf(stderr, "test_attributes.c:%d: %s\n", line, condition);
    exit(1);
}

static uint32_t random_u32(void)
{
    random_state = random_state * 6364136223846793005u + 1442695040888963407u;
    return (uint32_t)(random_state >> 32);
}

static void *allocate(size_t size)
{
    void *block = calloc(size > 0 ? size : 1, 1);
    CHECK(block != NULL);
    return block;
}

/* Geometric sizes, in channels that are off together, of which some follow others. */
static void fill_values(stream *s, uint32_t shift)
{
    for (size_t i = 0; i < s->rows; i++) {
        uint32_t off = random_u32() & 1;
        for (size_t j = 0; j < s->channels; j++) {
            uint32_t bits = random_u32() >> (shift + random_u32() % (32 - shift));
            int32_t value = random_u32() & 1 ? (int32_t)(bits >> 1) : -(int32_t)(bits >> 1) - 1;
            s->value[i * s->channels + j] = off && j < 3 ? 0 : value;
        }
    }
}

/* A model that uses all that a header can say, tables from counts; every second coder is `other`.
 */
static void make_model(stream *s, int32_t other)
{
    uint32_t *count = allocate(4 * COUNTS * s->channels);
    uint64_t *cost = allocate(8 * s->channels);
    void *chooser = allocate(clgs_attributes_choose_workspace());
    for (size_t j = 0; j < s->channels; j++) {
        clgs_channel *c = s->model + j;
        int32_t before = (int32_t)j;
        c->centre = before - 1;
        c->coder = other > CLGS_MIXED && j % 2 == 1 ? other : CLGS_STATIC;
        int32_t last = before - (c->coder == CLGS_SIDED); /* channel that a tap may have */
        c->taps = c->coder == CLGS_KNOWN ? 0 : before % 4;
        for (int32_t t = 0; t < c->taps; t++)
            c->tap[t] =
                (clgs_tap){t < last ? t : last, t == 0 ? CLGS_TAP_NEAR : t - 2, 100 - 60 * t};
        c->gain = 40;
        c->weight[0] = c->coder != CLGS_SIDED && before % 2 ? 1000 : 0;
        c->weight[1] = c->weight[2] = c->coder != CLGS_SIDED && before % 3 ? 500 : 0;
        c->span = before % 3 < before ? before % 3 : 0;
        c->classes = 1;
        c->frequency[0][0] = CLGS_SCALE;
    }
    CHECK(clgs_attributes_count(s->model, s->value, s->near, s->rows, s->channels, count,
                                s->workspace) == CLGS_OK);
    CHECK(clgs_attributes_choose(s->model, s->channels, count, 25600, cost, chooser) == CLGS_OK);
    CHECK(s->channels < 2 || (cost[1] == 0) == (other == CLGS_KNOWN));
    for (size_t j = 1; other == CLGS_MIXED && j < s->channels; j += 2) {
        s->model[j].coder = CLGS_MIXED;
        s->model[j].classes = 1;
        memset(s->model[j].class_of, 0, sizeof s->model[j].class_of);
        memset(s->model[j].frequency, 0, sizeof s->model[j].frequency);
    }
    free(chooser);
    free(cost);
    free(count);
}

static clgs_error read_header(const stream *s, const uint8_t *header, size_t size, void *model)
{
    void *workspace = allocate(clgs_attributes_header_workspace());
    uint8_t *exact = allocate(size);
    memcpy(exact, header, size);
    clgs_error error = clgs_attributes_header_read(exact, size, model, s->channels, workspace);
    free(exact);
    free(workspace);
    return error;
}

static clgs_error decode(const stream *s, const void *model, const uint8_t *data, size_t size)
{
    uint8_t *exact = allocate(size);
    int32_t *value = allocate(4 * s->rows * s->channels);
    memcpy(exact, data, size);
    for (size_t i = 0; i < s->rows * s->channels; i++)
        value[i] = s->model[i % s->channels].coder == CLGS_KNOWN ? s->value[i] : 0;
    clgs_error error = clgs_attributes_decode(model, exact, size, value, s->near, s->rows,
                                              s->channels, s->workspace);
    if (error == CLGS_OK && size == s->size && memcmp(data, s->data, size) == 0)
        CHECK(memcmp(value, s->value, 4 * s->rows * s->channels) == 0);
    free(value);
    free(exact);
    return error;
}

static void test_round_trip(stream *s)
{
    void *workspace = allocate(clgs_attributes_header_workspace());
    size_t size = clgs_attributes_model_size(s->channels);
    size_t capacity = clgs_attributes_header_bound(s->channels);
    clgs_channel *again = allocate(size);
    s->header = allocate(capacity);
    s->header_size =
        clgs_attributes_header_write(s->model, s->channels, s->header, capacity, workspace);
    CHECK(s->header_size > 0);
    CHECK(read_header(s, s->header, s->header_size, again) == CLGS_OK);
    CHECK(memcmp(again, s->model, size) == 0);
    capacity = clgs_attributes_bound(s->model, s->rows, s->channels);
    s->data = allocate(capacity);
    s->size = clgs_attributes_encode(s->model, s->value, s->near, s->rows, s->channels, s->data,
                                     capacity, s->workspace);
    CHECK(s->size > 0 && s->size <= capacity);
    CHECK(clgs_attributes_encode(s->model, s->value, s->near, s->rows, s->channels, s->data,
                                 capacity - 1, s->workspace) == 0);
    CHECK(decode(s, again, s->data, s->size) == CLGS_OK);
    free(again);
    free(workspace);
}

/* Chunks of one lane have no bits to spare: cut, they may decode to other rows. Files have CRCs. */
static void test_chunk_damage(const stream *s)
{
    uint8_t *bad = allocate(s->size + 8);
    for (size_t size = 0; size < s->size; size++) {
        clgs_error error = decode(s, s->model, s->data, size);
        CHECK(error < 0 || (error == CLGS_OK && s->rows < CLGS_LONG_ROWS));
    }
    memcpy(bad, s->data, s->size);
    for (size_t more = 1; more <= 8; more++)
        CHECK(decode(s, s->model, bad, s->size + more) < 0);
    for (size_t bit = 0; bit < 8 * s->size; bit += bit < EVERY_BIT ? 1 : 9) {
        memcpy(bad, s->data, s->size);
        bad[bit / 8] ^= (uint8_t)(1u << (bit & 7));
        CHECK(clgs_error_text(decode(s, s->model, bad, s->size)) != NULL);
    }
    for (int round = 0; round < 100; round++) {
        memcpy(bad, s->data, s->size);
        for (size_t i = 8 + random_u32() % s->size; i < s->size; i++)
            bad[i] = (uint8_t)random_u32();
        CHECK(clgs_error_text(decode(s, s->model, bad, s->size)) != NULL);
    }
    free(bad);
}

/* A damaged header either fails or is a model under which decoding ends; these fail if cut. */
static void test_header_damage(const stream *s)
{
    uint8_t *bad = allocate(s->header_size);
    void *model = allocate(clgs_attributes_model_size(s->channels));
    for (size_t size = 0; size < s->header_size; size++)
        CHECK(read_header(s, s->header, size, model) < 0);
    for (int round = 0; round < 1000; round++) {
        memcpy(bad, s->header, s->header_size);
        for (uint32_t n = random_u32() % 4 + 1; n > 0; n--)
            bad[random_u32() % s->header_size] = (uint8_t)random_u32();
        if (read_header(s, bad, s->header_size, model) == CLGS_OK)
            CHECK(clgs_error_text(decode(s, model, s->data, s->size)) != NULL);
    }
    free(model);
    free(bad);
}

/* The near rows of points in no order. */
static int32_t *scattered(size_t rows)
{
    int32_t *position = allocate(12 * rows), *near = allocate(4 * CLGS_NEAR * rows);
    void *workspace = allocate(clgs_near_workspace(rows));
    for (size_t i = 0; i < 3 * rows; i++)
        position[i] = (int32_t)(random_u32() % 64);
    CHECK(clgs_near(position, rows, near, workspace) == CLGS_OK);
    free(workspace);
    free(position);
    return near;
}

static void test_stream(size_t rows, size_t channels, uint32_t shift, int32_t other)
{
    stream s = {.rows = rows, .channels = channels};
    s.near = other == CLGS_MIXED ? NULL : scattered(rows);
    s.value = allocate(4 * rows * channels);
    s.model = allocate(clgs_attributes_model_size(channels));
    s.workspace = allocate(clgs_attributes_workspace(rows, channels));
    fill_values(&s, shift);
    make_model(&s, other);
    test_round_trip(&s);
    test_chunk_damage(&s);
    if (rows < CLGS_LONG_ROWS) /* long streams are here for their eight lanes */
        test_header_damage(&s);
    free(s.header);
    free(s.data);
    free(s.workspace);
    free(s.model);
    free(s.near);
    free(s.value);
}

/* As many classes as there can be, with tables in which nothing can be expected. */
static void fill_tables(clgs_channel *c)
{
    *c = (clgs_channel){.centre = INT32_MIN, .gain = CLGS_MAX_GAIN, .classes = CLGS_CLASSES};
    c->weight[0] = c->weight[1] = c->weight[2] = CLGS_MAX_WEIGHT;
    for (uint8_t cell = 0; cell < CLGS_LEVELS; cell++)
        c->class_of[cell] = cell / 2;
    for (int k = 0; k < CLGS_CLASSES; k++)
        for (uint32_t left = CLGS_SCALE, n; left > 0; left -= n) {
            n = random_u32() % (left < 40 ? left : 40) + 1;
            c->frequency[k][random_u32() % CLGS_ALPHABET] += (uint16_t)n;
        }
}

static void test_largest_header(void)
{
    size_t bound = clgs_attributes_header_bound(2), model_size = clgs_attributes_model_size(2);
    clgs_channel *model = allocate(model_size), *again = allocate(model_size);
    uint8_t *out = allocate(bound);
    void *workspace = allocate(clgs_attributes_header_workspace());
    fill_tables(model);
    fill_tables(model + 1);
    size_t size = clgs_attributes_header_write(model, 2, out, bound, workspace);
    CHECK(size > 2048 && size <= bound);
    CHECK(clgs_attributes_header_read(out, size, again, 2, workspace) == CLGS_OK);
    CHECK(memcmp(again, model, model_size) == 0);
    CHECK(clgs_attributes_header_write(model, 2, out, size, workspace) == size);
    CHECK(clgs_attributes_header_write(model, 2, out, size - 1, workspace) == 0);
    CHECK(clgs_attributes_header_bound(0) == 0 && clgs_attributes_header_bound(257) == 0);
    free(workspace);
    free(out);
    free(again);
    free(model);
}

/* Every function refuses a model that is out of range, and shapes that are. */
static void test_bad_models(void)
{
    clgs_channel model = {.classes = 1, .gain = CLGS_MAX_GAIN + 1};
    uint32_t *count = allocate(4 * COUNTS);
    uint64_t bytes[1] = {0};
    uint8_t out[256] = {0};
    int32_t value[1] = {0};
    void *workspace = allocate(clgs_attributes_workspace(1, 1));
    void *chooser = allocate(clgs_attributes_choose_workspace());
    model.frequency[0][0] = CLGS_SCALE;
    CHECK(clgs_attributes_bound(&model, 1, 1) <= sizeof out);
    CHECK(clgs_attributes_encode(&model, value, NULL, 1, 1, out, sizeof out, workspace) == 0);
    CHECK(clgs_attributes_decode(&model, out, 1, value, NULL, 1, 1, workspace) ==
          CLGS_ERROR_ARGUMENT);
    CHECK(clgs_attributes_count(&model, value, NULL, 1, 1, count, workspace) ==
          CLGS_ERROR_ARGUMENT);
    CHECK(clgs_attributes_measure(&model, value, NULL, 1, 1, bytes, out, workspace) ==
          CLGS_ERROR_ARGUMENT);
    CHECK(clgs_attributes_header_write(&model, 1, out, sizeof out, workspace) == 0);
    CHECK(clgs_attributes_choose(&model, 1, count, 256, bytes, chooser) == CLGS_ERROR_ARGUMENT);
    model.gain = 0;
    CHECK(clgs_attributes_count(&model, value, NULL, 0, 1, count, workspace) ==
          CLGS_ERROR_ARGUMENT);
    CHECK(clgs_attributes_measure(&model, value, NULL, 0, 1, bytes, out, workspace) ==
          CLGS_ERROR_ARGUMENT);
    CHECK(clgs_attributes_header_write(&model, 0, out, sizeof out, workspace) == 0);
    CHECK(clgs_attributes_header_write(&model, 1, out, 0, workspace) == 0);
    CHECK(clgs_attributes_header_read(out, 1, &model, 257, workspace) == CLGS_ERROR_ARGUMENT);
    CHECK(clgs_attributes_choose(&model, 0, count, 256, bytes, chooser) == CLGS_ERROR_ARGUMENT);
    free(chooser);
    free(workspace);
    free(count);
}

static int64_t distance_of(const int32_t *a, const int32_t *b)
{
    int64_t sum = 0;
    for (int axis = 0; axis < 3; axis++)
        sum += ((int64_t)a[axis] - b[axis]) * ((int64_t)a[axis] - b[axis]);
    return sum;
}

/* Row `row` is near row `place` of row i: `place` earlier rows are nearer, or as near and later. */
static void check_near(const int32_t *position, size_t i, size_t place, int32_t row)
{
    size_t before = 0;
    CHECK(place < i ? row >= 0 && (size_t)row < i : row == -1);
    for (size_t other = 0; row >= 0 && other < i; other++) {
        int64_t mine = distance_of(position + 3 * i, position + 3 * row);
        int64_t its = distance_of(position + 3 * i, position + 3 * other);
        before += its < mine || (its == mine && other > (size_t)row);
    }
    CHECK(row < 0 || before == place);
}

static void test_near(size_t rows, uint32_t extent)
{
    int32_t *position = allocate(12 * rows), *near = allocate(4 * CLGS_NEAR * rows);
    void *workspace = allocate(clgs_near_workspace(rows));
    for (size_t i = 0; i < 3 * rows; i++)
        position[i] = INT32_MIN + (int32_t)(random_u32() % extent);
    CHECK(clgs_near(position, rows, near, workspace) == CLGS_OK);
    for (size_t i = 0; i < CLGS_NEAR * rows; i++)
        check_near(position, i / CLGS_NEAR, i % CLGS_NEAR, near[i]);
    if (rows > 1) {
        position[0] = INT32_MIN + (1 << CLGS_MAX_DEPTH);
        position[3] = INT32_MIN;
        CHECK(clgs_near(position, rows, near, workspace) == CLGS_ERROR_ARGUMENT);
    }
    CHECK(clgs_near(position, CLGS_MAX_POINTS + 1, near, workspace) == CLGS_ERROR_ARGUMENT);
    free(workspace);
    free(near);
    free(position);
}

/* A near row must be an earlier one; that of a model without such terms is not looked at. */
static void test_bad_near(void)
{
    clgs_channel model = {.taps = 1, .tap = {{0, CLGS_TAP_NEAR, 100}}, .classes = 1};
    int32_t value[6] = {0}, near[6 * CLGS_NEAR];
    uint8_t out[256];
    void *workspace = allocate(clgs_attributes_workspace(6, 1));
    model.frequency[0][0] = CLGS_SCALE;
    for (int32_t bad = -1; bad <= 7; bad++) {
        memset(near, 0, sizeof near);
        near[5 * CLGS_NEAR + 3] = bad;
        size_t size = clgs_attributes_encode(&model, value, near, 6, 1, out, sizeof out, workspace);
        CHECK((size > 0) == (bad >= 0 && bad < 5));
        clgs_error error = clgs_attributes_decode(&model, out, size, value, near, 6, 1, workspace);
        CHECK((error == CLGS_ERROR_ARGUMENT) == (size == 0));
    }
    free(workspace);
}

int main(void)
{
    test_largest_header();
    for (int32_t other = CLGS_STATIC; other <= CLGS_SIDED; other++) {
        test_stream(1, 1, 27, other);
        test_stream(other == CLGS_KNOWN ? 8 : 7, 5, 20, other);
        test_stream(60, 4, 27, other);
        test_stream(33, 6, 0, other);
    }
    test_stream(CLGS_LONG_ROWS, 1, 27, 0);
    CHECK(clgs_attributes_model_size(0) == 0 && clgs_attributes_model_size(257) == 0);
    CHECK(clgs_attributes_workspace(CLGS_MAX_POINTS + 1, 1) == 0);
    test_bad_models();
    test_bad_near();
    for (size_t rows = 0; rows < 40; rows++)
        test_near(rows, rows % 3 == 0 ? 4 : 1 << CLGS_MAX_DEPTH);
    test_near(700, 12);
    puts("attributes: all tests passed");
    return 0;
}
