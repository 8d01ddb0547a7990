/* Gradients of the blending, GPU form: back to front with T / (1 - alpha) and one scalar per pixel,
 * the colour behind the record dotted with d_image. Every entry of a list writes one row of moments
 * to a place of its own, and sums.cl adds the rows of each Gaussian: no floating-point atomics, the
 * same bits in every run.
 *
 * A work-group owns a tile, each of its TILE_SIZE^2 work-items a pixel; 16 neighbouring ones are a
 * unit, which passes over records that do not touch it. Local memory holds BACKWARD_BATCH records,
 * which the work-items load together, and the moments of all pixels for ROUND entries, which they
 * then add up together. Launch size: tiles * TILE_SIZE^2. */
#include "blend/moments.h"
#include "blend/observe.h"
#include "blend/rays.h"
#include "blend/record.h"
#include "blend/touch.h"
#include "blend/units.h"
#include "common/lanes.h"
#include "common/real.h"
#include "common/tile_size.h"

/* Sums over the work-group, of ROUND entries at a time, in the order of the CPU form: over the
 * units for each of their 16 pixels, then over these by a tree. */
#define ROUND 3
#define ROUND_MOMENTS (ROUND * ROW_USED)
#define BACKWARD_BATCH (16 * ROUND) /* records staged at a time */

/* Place of a pixel's moment. Every second moment has its units swapped in pairs: two neighbouring
 * moments of the same lanes then lie in different banks. */
static inline int value_place(const int moment, const int pixel)
{
    return TILE_PIXELS * moment + (pixel ^ (moment % 2 * UNIT_SIZE));
}

static inline void store_moments(const Moments *m, int slot, __local float *values)
{
    const float own[ROW_USED] = {m->y1,  m->y2,    m->y11,  m->y12,  m->y22,
                                 m->red, m->green, m->blue, m->alpha};
    for (int j = 0; j < ROW_USED; ++j)
        values[value_place(ROW_USED * slot + j, (int)get_local_id(0))] = own[j];
}

/* Writes the rows of `entries` entries. Contains barriers; `values` may be written again after
 * it. */
static inline void reduce_moments(__local const float *values, __local float *lanes,
                                  __local const float *staged, int entries, __global float *rows)
{
    const int item = (int)get_local_id(0);
    barrier(CLK_LOCAL_MEM_FENCE);
    for (int i = item; i < entries * ROW_USED * UNIT_SIZE; i += TILE_PIXELS) {
        const int moment = i / UNIT_SIZE, lane = i % UNIT_SIZE;
        float sum = 0.0f;
        for (int unit = 0; unit < UNITS; ++unit)
            sum += values[value_place(moment, unit * UNIT_SIZE + lane)];
        lanes[LANES_PITCH * moment + lane] = sum;
    }
    barrier(CLK_LOCAL_MEM_FENCE);
    if (item < entries * ROW_USED) {
        const int row = as_int(staged[RECORD_USED * (item / ROW_USED) + RECORD_ROW]);
        rows[ROW_SIZE * (size_t)row + (size_t)(item % ROW_USED)] =
            lane_tree(lanes + LANES_PITCH * item);
    }
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

/* Copies `count` records, the one before `stop` first, then those before it; one per work-item. */
static inline void stage_backwards(__local float *staged, __global const float *records, int stop,
                                   int count)
{
    const int item = (int)get_local_id(0);
    if (item < count)
        for (int j = 0; j < RECORD_USED; ++j)
            staged[RECORD_USED * item + j] =
                records[RECORD_SIZE * (size_t)(stop - 1 - item) + (size_t)j];
}

TILE_GROUP __kernel void
blend_backward(__global const float *records, __global const int *tile_range,
               __global const float *background, const int width, const int height,
               __global const float *transmittance, __global const int *last_contributor,
               __global const float *d_image, __global float *rows OBSERVE_PARAMETERS)
{
    __local float staged[RECORD_USED * BACKWARD_BATCH];
    __local float values[ROUND_MOMENTS * TILE_PIXELS];
    __local float lanes[ROUND_MOMENTS * LANES_PITCH];
    __local int tile_last;
    const int tile = (int)get_group_id(0), item = (int)get_local_id(0);
    const int columns = tiles_across(width);
    const int tile_x = pixel_x(item), tile_y = pixel_y(item);
    const int x = tile % columns * TILE_SIZE + tile_x, y = tile / columns * TILE_SIZE + tile_y;
    const uint unit = unit_bit(item / UNIT_SIZE);
    const TouchConstants constants = touch_constants(0);
    Rays p = {1.0f, 0.0f, 0.0f, 0.0f, 0.0f, 0};
    if (x < width && y < height)
        p = load_ray(background, transmittance, last_contributor, d_image,
                     (size_t)y * (size_t)width + (size_t)x, (size_t)width * (size_t)height);
    if (item == 0)
        tile_last = 0;
    barrier(CLK_LOCAL_MEM_FENCE);
    atomic_max(&tile_last, p.last);
    barrier(CLK_LOCAL_MEM_FENCE);
    const int first = tile_range[tile], end = tile_range[tile + 1];
    /* an empty list may be that of another group of tiles, whose pixels have contributors */
    const int lit = SKIP_CONTRIBUTORS ? min(first + tile_last, end) : end;
    for (int k = end - 1; k >= lit; --k)
        if (item < ROW_USED)
            rows[ROW_SIZE * (size_t)as_int(records[RECORD_SIZE * (size_t)k + RECORD_ROW]) +
                 (size_t)item] = 0.0f;
    /* back to front: entry `stop - 1 - i` is staged at place i */
    for (int stop = lit; stop > first; stop -= BACKWARD_BATCH) {
        const int batch = min(stop - first, BACKWARD_BATCH);
        barrier(CLK_LOCAL_MEM_FENCE);
        stage_backwards(staged, records, stop, batch);
        barrier(CLK_LOCAL_MEM_FENCE);
        for (int i = 0; i < batch; i += ROUND) {
            const int entries = min(batch - i, ROUND);
            for (int slot = 0; slot < entries; ++slot) {
                const int k = stop - 1 - i - slot;
                __local const float *from = staged + RECORD_USED * (i + slot);
                Moments m = {0.0f, 0.0f, 0.0f, 0.0f, 0.0f, 0.0f, 0.0f, 0.0f, 0.0f};
                if (as_uint(from[RECORD_UNITS]) & unit) {
                    Record record;
                    READ_RECORD(record, from);
                    const Touch t = touch(&record, (float)x + 0.5f, (float)y + 0.5f, &constants);
                    const iv taken = blend_back(&p, &record, &t, k - first + 1, &m);
                    OBSERVE(k, tile_x, tile_y, taken, t.saturated);
                }
                store_moments(&m, slot, values);
            }
            reduce_moments(values, lanes, staged + RECORD_USED * i, entries, rows);
        }
    }
}
