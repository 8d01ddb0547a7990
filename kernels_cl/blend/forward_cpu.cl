/* Blend the records of every tile front to back, CPU form.
 *
 *     color += alpha T c,  T *= 1 - alpha;  a pixel stops before T < TRANSMITTANCE_STOP.
 * touch.h computes alpha, pixels.h blends; rays.h and sums.cl take the derivatives.
 *
 * A work-item owns a tile: its pixels lie in private memory, cut into units of VEC lanes, and the
 * records of its list pass by as a stream. Work-groups of one work-item; launch size: the number of
 * tiles. No local memory. */
#include "blend/observe.h"
#include "blend/pixels.h"
#include "blend/record.h"
#include "blend/touch.h"
#include "blend/units.h"
#include "common/real.h"
#include "common/tile_size.h"

static inline iv inside_image(int x, int y, int width, int height)
{
    return ((LANE_X + (float)x) < (fv)((float)width)) & ((LANE_Y + (float)y) < (fv)((float)height));
}

/* A unit of pixels, and their centres. */
typedef struct {
    Pixels pixels;
    fv x, y;
} Unit;

/* Blends entry number `entry` into the open units; returns those that are still open. */
static inline __attribute__((always_inline)) uint
blend_forward_entry(Unit *units, Ends *ends, uint open, __global const float *from, int entry,
                    int number, const TouchConstants *constants OBSERVE_PARAMETERS)
{
    Record record;
    READ_RECORD(record, from);
    uint left = as_uint(from[RECORD_UNITS]) & open;
    while (left) {
        const int u = take_unit(&left);
        const Touch t = touch(&record, units[u].x, units[u].y, constants);
        OBSERVE(entry, unit_x(u), unit_y(u), blended_over(&units[u].pixels, &t), t.saturated);
        if (any_lane(blend_over(&units[u].pixels, &ends[u], &record, &t, number)) &&
            SKIP_FINISHED && !any_lane(units[u].pixels.stop > (fv)(0.0f)))
            open &= ~unit_bit(u);
    }
    return open;
}

/* Writes a tile that shows nothing but the background. */
static inline void store_background(__global const float *background, int x, int y, int width,
                                    int height, __global float *image,
                                    __global float *transmittance, __global int *last_contributor)
{
    const size_t plane = (size_t)width * (size_t)height;
    for (int row = y; row < min(y + TILE_SIZE, height); ++row)
        for (int column = x; column < min(x + TILE_SIZE, width); ++column) {
            const size_t at = (size_t)row * (size_t)width + (size_t)column;
            for (int channel = 0; channel < 3; ++channel)
                image[at + (size_t)channel * plane] = background[channel];
            transmittance[at] = 1.0f;
            last_contributor[at] = 0;
        }
}

static inline void store_pixels(const Unit *unit, const Ends *e, __global const float *background,
                                int entries, int x, int y, int width, int height,
                                __global float *image, __global float *transmittance,
                                __global int *last_contributor)
{
    const size_t plane = (size_t)width * (size_t)height;
    const Pixels p = unit->pixels;
    const iv open = e->transmittance < (fv)(0.0f);
    const fv rest = open ? p.transmittance : e->transmittance;
    const iv last = open ? (iv)(entries) : e->last;
    store_unit(fma(rest, (fv)(background[0]), p.red), image, x, y, width, height);
    store_unit(fma(rest, (fv)(background[1]), p.green), image + plane, x, y, width, height);
    store_unit(fma(rest, (fv)(background[2]), p.blue), image + 2 * plane, x, y, width, height);
    store_unit(rest, transmittance, x, y, width, height);
    store_unit(AS_FV(last), (__global float *)last_contributor, x, y, width, height);
}

__kernel void blend_forward(__global const float *records, __global const int *tile_range,
                            __global const float *background, const int width, const int height,
                            __global float *image, __global float *transmittance,
                            __global int *last_contributor OBSERVE_PARAMETERS)
{
    const int tile = (int)get_global_id(0);
    const int columns = tiles_across(width);
    const int x = tile % columns * TILE_SIZE, y = tile / columns * TILE_SIZE;
    const int first = tile_range[tile], end = tile_range[tile + 1];
    if (SKIP_EMPTY_TILES && first == end) {
        store_background(background, x, y, width, height, image, transmittance, last_contributor);
        return;
    }
    const TouchConstants constants = touch_constants(width >> 31);
    Unit units[UNITS];
    Ends ends[UNITS];
    uint open = 0;
    for (int u = 0; u < UNITS; ++u) {
        const iv inside = inside_image(x + unit_x(u), y + unit_y(u), width, height);
        units[u].x = LANE_X + (float)(x + unit_x(u));
        units[u].y = LANE_Y + (float)(y + unit_y(u));
        start_pixels(&units[u].pixels, &ends[u], inside);
        open |= any_lane(inside) ? unit_bit(u) : 0u;
    }
    for (int k = first; k < end && open; ++k)
        open = blend_forward_entry(units, ends, open, records + RECORD_SIZE * (size_t)k, k,
                                   k - first + 1, &constants OBSERVE_ARGUMENTS);
    for (int u = 0; u < UNITS; ++u)
        store_pixels(&units[u], &ends[u], background, end - first, x + unit_x(u), y + unit_y(u),
                     width, height, image, transmittance, last_contributor);
}
