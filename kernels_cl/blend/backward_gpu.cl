/* Gradients of the blending, GPU form: back to front with T / (1 - alpha) and one scalar per pixel,
 * the colour behind the record dotted with d_image. Every entry of a list writes one row of moments
 * to a place of its own, and sums.cl adds the rows of each Gaussian: no floating-point atomics, the
 * same bits in every run.
 *
 * A work-group owns a tile, each of its TILE_SIZE^2 work-items a pixel; 16 neighbouring ones are a
 * unit, which passes over records that do not touch it. Records are staged together; those of a
 * round, as many as there is room for, leave a block of moments in local memory for each unit that
 * they touch, and then the work-items add up the blocks of every record. Launch size: tiles *
 * TILE_SIZE^2. */
#include "blend/moments.h"
#include "blend/observe.h"
#include "blend/rays.h"
#include "blend/record.h"
#include "blend/touch.h"
#include "blend/units.h"
#include "common/lanes.h"
#include "common/real.h"
#include "common/tile_size.h"

#define BACKWARD_BATCH 32 /* records staged at a time: a set of them is the bits of a uint */
#define RECORD_VECTORS (RECORD_USED / 4)
#define STAGED_BLOCK 10 /* of a staged record, int: the first of its blocks, see Place */
#define UNIT_VECTORS (UNIT_SIZE / 4)
/* One more than there are, so that eight neighbouring moments lie in different banks. */
#define MOMENT_VECTORS (UNIT_VECTORS + 1)
/* An odd multiple of half the banks, so that the two units of a warp lie in different ones. */
#define BLOCK_VECTORS (SUM_SIZE * MOMENT_VECTORS - 1)
#define ROUND_BLOCKS 42 /* at least UNITS, so that there is room for any record */

/* What the work-items share. A block holds the moments of a unit's pixels, moment after moment. */
typedef struct {
    float4 blocks[ROUND_BLOCKS * BLOCK_VECTORS];
    float4 records[RECORD_VECTORS * BACKWARD_BATCH]; /* the last one of the list first */
    uint touching[UNITS]; /* records of the round that touch a unit; record 0 is the highest bit */
    int end;              /* of the round, a number of a record */
    int last;             /* contributor of the tile */
} Shared;

/* Numbers in the last vector of a staged record. */
typedef struct {
    uint units;
    int block; /* first of the record's blocks: one per unit that it touches, in their order */
    int row;
} Place;

static inline Place place_of(const float4 last)
{
    const Place place = {as_uint(last.y), as_int(last.z), as_int(last.w)};
    return place;
}

static inline void store_moments(const Moments *m, __local float *lane)
{
    const float own[SUM_SIZE] = {m->y1,  m->y2,    m->y11,  m->y12,  m->y22,
                                 m->red, m->green, m->blue, m->alpha};
#pragma unroll
    for (int j = 0; j < SUM_SIZE; ++j)
        lane[4 * MOMENT_VECTORS * j] = own[j];
}

/* Sum of a moment over `count` blocks: over the blocks in their order for each of the 16 pixels,
 * then over these by a tree, as the CPU form does. Units without a block would add zeros. */
static inline float sum_moment(__local const float4 *blocks, int count, const int moment)
{
    float4 sum[UNIT_VECTORS] = {(float4)(0.0f), (float4)(0.0f), (float4)(0.0f), (float4)(0.0f)};
    /* more blocks at a time would only take registers from other work-groups */
#pragma unroll 1
    for (__local const float4 *from = blocks + MOMENT_VECTORS * moment; count > 0; --count) {
#pragma unroll
        for (int i = 0; i < UNIT_VECTORS; ++i)
            sum[i] += from[i];
        from += BLOCK_VECTORS;
    }
    return quads_tree(sum[0], sum[1], sum[2], sum[3]);
}

/* Writes the rows of the records from `begin` on, up to `end`. */
static inline void write_rows(__local const Shared *shared, int begin, int end,
                              __global float *rows)
{
    for (int i = (int)get_local_id(0); i < (end - begin) * SUM_SIZE; i += TILE_PIXELS) {
        const int record = begin + i / SUM_SIZE, moment = i % SUM_SIZE;
        const Place place = place_of(shared->records[RECORD_VECTORS * record + 2]);
        rows[ROW_SIZE * (size_t)place.row + (size_t)moment] = sum_moment(
            shared->blocks + BLOCK_VECTORS * place.block, (int)popcount(place.units), moment);
    }
}

/* Begins a round at record `begin` of `count`: as many as there are blocks for. A work-item for
 * each unit, of the warps that have least to do in write_rows. */
static inline void plan_round(__local Shared *shared, int begin, int count)
{
    const int unit = TILE_PIXELS - 1 - (int)get_local_id(0);
    if (unit >= UNITS)
        return;
    __local float *records = (__local float *)shared->records;
    uint touching = 0;
    int blocks = 0, i = begin;
    for (; i < count; ++i) {
        const uint units = as_uint(records[RECORD_USED * i + RECORD_UNITS]);
        const int after = blocks + (int)popcount(units);
        if (after > ROUND_BLOCKS)
            break;
        if (unit == 0)
            records[RECORD_USED * i + STAGED_BLOCK] = as_float(blocks);
        touching |= (units << unit & unit_bit(0)) >> i;
        blocks = after;
    }
    shared->touching[unit] = touching;
    if (unit == 0)
        shared->end = i;
}

static inline Rays load_ray(__global const float *background, __global const float *transmittance,
                            __global const int *last_contributor, __global const float *d_image,
                            size_t at, size_t plane)
{
    Rays p;
    p.transmittance = transmittance[at];
    p.d_red = d_image[at];
    p.d_green = d_image[at + plane];
    p.d_blue = d_image[at + 2 * plane];
    p.behind = fma(p.d_red, background[0], fma(p.d_green, background[1], p.d_blue * background[2]));
    p.last = last_contributor[at];
    return p;
}

/* Copies `count` records, the one before `stop` first, then those before it; a vector per
 * work-item. */
static inline void stage_backwards(__local Shared *shared, __global const float *records, int stop,
                                   int count)
{
    const int item = (int)get_local_id(0);
    if (item < RECORD_VECTORS * count)
        shared->records[item] =
            ((__global const float4 *)
                 records)[RECORD_SIZE / 4 * (size_t)(stop - 1 - item / RECORD_VECTORS) +
                          (size_t)(item % RECORD_VECTORS)];
}

/* A work-item's pixel, and its lane in its unit. */
typedef struct {
    int x, y; /* in the tile */
    float center_x, center_y;
    int unit, lane;
} Pixel;

/* Takes the records of a round off a pixel that touch its unit; `number` is that of the first
 * staged entry, counted from 1 in the list, which begins at entry `first`. */
static inline void blend_round(__local Shared *shared, Rays *p, const Pixel *pixel, int number,
                               int first OBSERVE_PARAMETERS)
{
    const TouchConstants constants = touch_constants(0);
    const uint units_before = ~(0xffffffffu >> pixel->unit);
    uint left = shared->touching[pixel->unit];
    while (left) {
        const int i = (int)clz(left);
        left ^= unit_bit(i);
        __local const float4 *from = shared->records + RECORD_VECTORS * i;
        const float4 a = from[0], b = from[1], c = from[2];
        const Record record = {a.x, a.y, a.z, a.w, b.x, b.y, b.z, b.w, c.x};
        const Place place = place_of(c);
        Moments m;
        const Touch t = touch(&record, pixel->center_x, pixel->center_y, &constants);
        const iv taken = blend_back(p, &record, &t, number - i, &m);
        OBSERVE(first + number - 1 - i, pixel->x, pixel->y, taken, t.saturated);
        const int block = place.block + (int)popcount(place.units & units_before);
        store_moments(&m,
                      (__local float *)shared->blocks + 4 * BLOCK_VECTORS * block + pixel->lane);
    }
}

TILE_GROUP __kernel void
blend_backward(__global const float *records, __global const int *tile_range,
               __global const float *background, const int width, const int height,
               __global const float *transmittance, __global const int *last_contributor,
               __global const float *d_image, __global float *rows OBSERVE_PARAMETERS)
{
    __local Shared shared;
    const int tile = (int)get_group_id(0), item = (int)get_local_id(0);
    const int columns = tiles_across(width);
    const int tile_x = pixel_x(item), tile_y = pixel_y(item);
    const int x = tile % columns * TILE_SIZE + tile_x, y = tile / columns * TILE_SIZE + tile_y;
    const Pixel pixel = {tile_x,          tile_y,           (float)x + 0.5f,
                         (float)y + 0.5f, item / UNIT_SIZE, item % UNIT_SIZE};
    Rays p = {1.0f, 0.0f, 0.0f, 0.0f, 0.0f, 0};
    if (x < width && y < height)
        p = load_ray(background, transmittance, last_contributor, d_image,
                     (size_t)y * (size_t)width + (size_t)x, (size_t)width * (size_t)height);
    if (item == 0)
        shared.last = 0;
    barrier(CLK_LOCAL_MEM_FENCE);
    atomic_max(&shared.last, p.last);
    barrier(CLK_LOCAL_MEM_FENCE);
    const int first = tile_range[tile], end = tile_range[tile + 1];
    /* an empty list may be that of another group of tiles, whose pixels have contributors */
    const int lit = SKIP_CONTRIBUTORS ? min(first + shared.last, end) : end;
    for (int k = end - 1; k >= lit; --k)
        if (item < SUM_SIZE)
            rows[ROW_SIZE * (size_t)as_int(records[RECORD_SIZE * (size_t)k + RECORD_ROW]) +
                 (size_t)item] = 0.0f;
    /* back to front: entry `stop - 1 - i` is staged as record i */
    for (int stop = lit; stop > first; stop -= BACKWARD_BATCH) {
        const int batch = min(stop - first, BACKWARD_BATCH);
        barrier(CLK_LOCAL_MEM_FENCE);
        stage_backwards(&shared, records, stop, batch);
        barrier(CLK_LOCAL_MEM_FENCE);
        for (int i = 0; i < batch;) {
            plan_round(&shared, i, batch);
            barrier(CLK_LOCAL_MEM_FENCE);
            const int round_end = shared.end;
            blend_round(&shared, &p, &pixel, stop - first, first OBSERVE_ARGUMENTS);
            barrier(CLK_LOCAL_MEM_FENCE);
            write_rows(&shared, i, round_end, rows);
            i = round_end;
        }
    }
}
