/* What the page's worker calls: open a file, decode it step by step, make Gaussians, sort them.
 *
 * One scene at a time. Functions that can fail return a negative number; page_problem says why. */
#include <string.h>

#include "clgs_codec.h"
#include "common/bytes.h"
#include "memory.h"
#include "neural.h"
#include "splats.h"

#ifdef __wasm__
#define EXPORT(name) __attribute__((export_name(#name))) name
#else
#define EXPORT(name) name
#endif

#define PREPARED 4096 /* anchors per step */
#define PHOTO_NUMBERS 7
#define CHUNK_NUMBERS 9

/* Where the numbers of page_numbers lie. */
enum {
    ITEMS,
    NEAR,
    ALPHA_CUT,
    ALPHA_MAX,
    BLUR,
    BACKGROUND,
    SPLATS = 8,
    LEARNED,
    ORIGIN,
    PHOTOS = ORIGIN + 3,
    NUMBERS = PHOTOS + PHOTO_NUMBERS
};

/* Of splats, whose files do not say them: the constants of the method, clgs/constants.py. */
#define ALPHA_CUT_OF_SPLATS (1.0 / 255.0)
#define ALPHA_MAX_OF_SPLATS 0.99
#define BLUR_OF_SPLATS 0.3

static struct page {
    problem wrong;
    span file;
    container sections;
    anchors anchor;
    neural neural;
    splats splat;
    gaussians all;
    size_t items, decoding, prepared, begun; /* decoding: steps that are left of splats */
    size_t apart, at;                        /* ready beyond `items`; the chunk of row `begun` */
    double *chunk;                           /* see page_chunks */
    float centre[3];
    double number[NUMBERS];
} page;

static int fail(problem wrong)
{
    page.wrong = wrong;
    return -1;
}

/* Room for a file of `size` bytes; what was there before is forgotten. NULL: too large. All of the
 * bytes count as there until page_arrived says otherwise. */
uint8_t *EXPORT(page_room)(size_t size)
{
    memory_release(0);
    memset(&page, 0, sizeof page);
    uint8_t *room = memory_take(size);
    page.file = (span){room, room ? size : 0};
    if (!room)
        page.wrong = NO_MEMORY;
    return room;
}

const char *EXPORT(page_problem)(void)
{
    return page.wrong;
}

/* Numbers of META; whether they are in range. */
static int read_numbers(const uint8_t *meta)
{
    static const struct {
        uint8_t to, from;
        double least, most;
    } FIELDS[] = {
        {NEAR, 104, 0x1p-64, 0x1p64}, {ALPHA_CUT, 112, 1e-9, 1}, {ALPHA_MAX, 120, 1e-9, 1},
        {BLUR, 136, 0, 0x1p64},       {BACKGROUND, 80, 0, 1},    {BACKGROUND + 1, 88, 0, 1},
        {BACKGROUND + 2, 96, 0, 1},
    };
    for (size_t i = 0; i < sizeof FIELDS / sizeof FIELDS[0]; i++) {
        double value = load_double(meta + FIELDS[i].from);
        if (!(value >= FIELDS[i].least && value <= FIELDS[i].most))
            return 0;
        page.number[FIELDS[i].to] = value;
    }
    page.number[LEARNED] = page.number[BLUR];
    return 1;
}

/* The bounds of the photos, if the file has them; whether they are in range. */
static int read_photos(span photos)
{
    double *number = page.number + PHOTOS;
    if (photos.size == 0)
        return 1;
    if (photos.size != 8 * PHOTO_NUMBERS)
        return 0;
    for (size_t i = 0; i < PHOTO_NUMBERS; i++) {
        number[i] = load_double(photos.data + 8 * i);
        if (!(number[i] >= -0x1p64 && number[i] <= 0x1p64))
            return 0;
    }
    return number[0] >= 0x1p-64 && number[0] <= number[1] && 0 <= number[5] &&
           number[5] <= number[6];
}

/* How many steps make this many anchors ready. */
static size_t steps_for(size_t count)
{
    return (count + PREPARED - 1) / PREPARED;
}

/* Whether the layer of details is among the first `layers`, and not done. */
static int details_wait(size_t layers)
{
    const anchors *a = &page.anchor;
    return page.sections.details && layers == a->list.layers && a->layer < layers;
}

/* How many steps of those bytes that are there. */
static int steps_left(void)
{
    if (page.sections.splats)
        return (int)page.decoding;
    const anchors *a = &page.anchor;
    if (!a->file)
        return 0;
    size_t layers = anchors_layers(a, page.sections.section[BODY].size);
    size_t bare = layers > 0 ? a->list.layer[layers - 1].rows - page.prepared : 0;
    size_t again = details_wait(layers) ? a->list.anchors : 0;
    return (int)(anchors_left(a, layers) + steps_for(bare) + steps_for(again));
}

/* How many bytes the whole file has, by its table, or, if `front`, what page_open needs of them. 0:
 * more of the beginning is needed to tell. */
double EXPORT(page_size)(int front)
{
    uint64_t size[2];
    problem wrong = container_size(page.file, size, size + 1);
    return wrong ? fail(wrong) : (double)size[front != 0];
}

/* This many bytes of the file are there. The number of steps that can be taken with them. */
int EXPORT(page_arrived)(size_t size)
{
    page.file.size = size;
    if (page.sections.layers)
        page.sections.section[BODY].size = size - page.sections.begin;
    return steps_left();
}

/* How many layers the file has, or, if `ready`, how many of them page_numbers counts. */
size_t EXPORT(page_layers)(int ready)
{
    const anchors *a = &page.anchor;
    return page.sections.splats ? 1 : ready ? a->layer : a->list.layers;
}

/* The numbers of page_chunks. */
static problem list_chunks(void)
{
    const anchors *a = &page.anchor;
    page.chunk = memory_take(8 * CHUNK_NUMBERS * a->list.chunks + 8);
    if (!page.chunk)
        return NO_MEMORY;
    double scale = load_double(page.sections.section[META].data + 16);
    size_t of = 0;
    for (size_t i = 0; i < a->list.chunks; i++) {
        const chunk *c = a->list.chunk + i;
        const span *last = &c->part[CODED - 1];
        double *number = page.chunk + CHUNK_NUMBERS * i;
        while (a->list.layer[of].chunks <= i)
            of++;
        number[0] = (double)(c->part[0].data - page.file.data);
        number[1] = (double)(last->data + last->size - page.file.data);
        number[2] = (double)of;
        for (int k = 0; k < 6; k++)
            number[3 + k] = (double)c->bounds[k] / scale;
    }
    return NULL;
}

static problem open_anchors(void)
{
    problem wrong = anchors_open(&page.sections, &page.anchor);
    if (wrong)
        return wrong;
    if (!read_numbers(page.sections.section[META].data) || !read_photos(page.sections.photos))
        return "a setting of the file is out of range; encode it again";
    wrong = page.sections.layers ? list_chunks() : NULL;
    if (!wrong)
        wrong = neural_open(&page.anchor, &page.neural);
    return wrong ? wrong : gaussians_open(OFFSETS * page.anchor.list.anchors, &page.all);
}

static problem open_splats(void)
{
    problem wrong = splats_open(&page.sections, &page.splat, &page.decoding);
    page.number[SPLATS] = 1;
    page.number[ALPHA_CUT] = ALPHA_CUT_OF_SPLATS;
    page.number[ALPHA_MAX] = ALPHA_MAX_OF_SPLATS;
    page.number[BLUR] = BLUR_OF_SPLATS;
    return wrong ? wrong : gaussians_open(page.splat.count, &page.all);
}

/* Read the file's lists; the number of steps that can be taken. */
int EXPORT(page_open)(void)
{
    problem wrong = container_read(page.file, &page.sections);
    if (!wrong)
        wrong = page.sections.splats ? open_splats() : open_anchors();
    return wrong ? fail(wrong) : steps_left();
}

static problem step_of_splats(void)
{
    problem wrong = splats_step(&page.splat);
    if (wrong || --page.decoding > 0)
        return wrong;
    page.number[NEAR] = page.splat.near;
    page.number[LEARNED] = page.splat.keeps_light ? 0 : BLUR_OF_SPLATS;
    memcpy(page.number + ORIGIN, page.splat.origin, sizeof page.splat.origin);
    page.items = page.splat.count;
    return NULL;
}

static problem step_of_anchors(void)
{
    anchors *a = &page.anchor;
    if (page.prepared < a->rows) {
        size_t rest = a->rows - page.prepared;
        size_t count = rest < PREPARED ? rest : PREPARED;
        neural_prepare(&page.neural, page.prepared, count);
        page.prepared += count;
    } else {
        int read = a->read;
        problem wrong = anchors_step(a);
        if (wrong)
            return wrong;
        if (!read)
            neural_weights(&page.neural);
        if (page.sections.details && a->layer == a->list.layers)
            page.prepared = 0; /* all anchors have changed */
    }
    if (page.prepared == a->rows)
        page.items = a->rows;
    return NULL;
}

/* The next step; the number of those that are left. After one that failed, there is none. */
int EXPORT(page_step)(void)
{
    if (page.wrong)
        return -1;
    problem wrong = page.sections.splats ? step_of_splats() : step_of_anchors();
    page.number[ITEMS] = (double)page.items;
    return wrong ? fail(wrong) : steps_left();
}

/* Of every chunk of a file in layers: where its bytes begin and end in the file, its layer, and the
 * least and the greatest position of its anchors, in scene units. NULL of other files. */
const double *EXPORT(page_chunks)(void)
{
    return page.chunk;
}

size_t EXPORT(page_chunk_count)(void)
{
    return page.chunk ? page.anchor.list.chunks : 0;
}

/* A chunk of which the bytes are there, though others may be missing: decode it and make it ready.
 * Layer 0 must be; then all chunks before the details must come by this. */
int EXPORT(page_take)(size_t index)
{
    anchors *a = &page.anchor;
    if (page.wrong)
        return -1;
    if (!page.chunk || index < a->chunk || index >= a->list.chunks || a->taken[index])
        return fail("a chunk was asked for twice");
    const chunk *c = a->list.chunk + index;
    problem wrong = anchors_take(a, index);
    if (wrong)
        return fail(wrong);
    neural_prepare(&page.neural, c->first, c->rows);
    page.apart += c->rows;
    if (a->rows == a->list.anchors) {
        page.items = page.prepared = a->rows;
        page.apart = 0;
    }
    page.number[ITEMS] = (double)(page.items + page.apart);
    return 0;
}

/* ITEMS, NEAR, ALPHA_CUT, ALPHA_MAX, BLUR, BACKGROUND (3), SPLATS: whether it is made of them,
 * LEARNED: the blur that they learned with, ORIGIN (3): what positions are relative to, PHOTOS (7):
 * those of section PHOT, or zeros. */
const double *EXPORT(page_numbers)(void)
{
    return page.number;
}

/* Two hashes of 8 bytes, little-endian: of what was decoded, and the file's own. */
const uint64_t *EXPORT(page_hashes)(void)
{
    static uint64_t hash[2];
    hash[0] = page.sections.splats ? page.splat.hash : page.anchor.hash;
    hash[1] = page.sections.splats ? page.splat.expected_hash : page.anchor.expected_hash;
    return hash;
}

/* Positions (items, 3) of anchors or splats, to choose a first view by. */
const float *EXPORT(page_positions)(void)
{
    return page.sections.splats ? page.splat.position : page.anchor.array[0].value;
}

/* Begin a new set of Gaussians, for a camera at this place. */
void EXPORT(page_begin)(float x, float y, float z)
{
    page.begun = page.at = page.all.count = 0;
    page.centre[0] = x;
    page.centre[1] = y;
    page.centre[2] = z;
}

/* How many of the next `count` anchors are of one chunk, or of the first `page.items`; `ready`:
 * whether they can be drawn. */
static size_t next_rows(size_t count, int *ready)
{
    const anchors *a = &page.anchor;
    size_t end = page.items;
    *ready = page.begun < page.items;
    if (!*ready) {
        while (a->list.chunk[page.at].first + a->list.chunk[page.at].rows <= page.begun)
            page.at++;
        *ready = a->taken[page.at];
        end = a->list.chunk[page.at].first + a->list.chunk[page.at].rows;
    }
    return count < end - page.begun ? count : end - page.begun;
}

/* Add those of the next `count` anchors or splats. How many are left: at 0 the set is complete. */
int EXPORT(page_add)(size_t count)
{
    size_t end = page.apart > 0 ? page.anchor.list.anchors : page.items;
    const float alpha_cut = (float)page.number[ALPHA_CUT];
    while (count > 0 && page.begun < end) {
        int ready = 1;
        size_t some = page.sections.splats ? page.items - page.begun : next_rows(count, &ready);
        some = some < count ? some : count;
        if (page.sections.splats)
            splats_add(&page.splat, page.begun, some, page.centre, alpha_cut, &page.all);
        else if (ready)
            neural_add(&page.neural, page.begun, some, page.centre, alpha_cut, &page.all);
        page.begun += some;
        count -= ready ? some : 0;
    }
    if (page.begun == end)
        gaussians_finish(&page.all);
    return (int)(end - page.begun);
}

/* Gaussians of the set so far, and their records. */
size_t EXPORT(page_count)(void)
{
    return page.all.count;
}

const uint32_t *EXPORT(page_records)(void)
{
    return page.all.record;
}

/* Sort the last complete set by depth x, y, z, 1 times the arguments; how many must be drawn. */
size_t EXPORT(page_sort)(float x, float y, float z, float w)
{
    const float row[4] = {x, y, z, w};
    return gaussians_sort(&page.all, row, (float)page.number[NEAR]);
}

const uint32_t *EXPORT(page_order)(void)
{
    return page.all.order;
}
