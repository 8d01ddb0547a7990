/* The CPU form of blend: one work-item a tile, its pixels in private memory. */
#ifndef CLGS_BLEND_TILE_H
#define CLGS_BLEND_TILE_H

#include "common/lanes.h"

inline iv inside_image(int x, int y, int width, int height)
{
    return ((LANE_X + (float)x) < (fv)((float)width)) & ((LANE_Y + (float)y) < (fv)((float)height));
}

/* A unit of pixels and where their centres are. */
typedef struct {
    Pixels pixels;
    fv x, y;
} Unit;

/* Returns the units that are still open. */
inline __attribute__((always_inline)) uint
blend_forward_entry(Unit *units, Ends *ends, uint open, __global const float *record, int entry,
                    int number, const TouchConstants *constants OBSERVE_PARAMETERS)
{
    Paint paint;
    READ_PAINT(paint, record);
    uint left = as_uint(record[RECORD_UNITS]) & open;
    while (left) {
        const int u = take_unit(&left);
        const Touch t = touch(&paint.splat, units[u].x, units[u].y, constants);
        OBSERVE(entry, unit_x(u), unit_y(u), blended_over(&units[u].pixels, &t), t.saturated);
        if (any_lane(blend_over(&units[u].pixels, &ends[u], &paint, &t, number)) && SKIP_FINISHED &&
            !any_lane(units[u].pixels.stop > (fv)(0.0f)))
            open &= ~unit_bit(u);
    }
    return open;
}

/* A tile in front of which there is nothing. */
inline void store_background(__global const float *background, int x, int y, int width, int height,
                             __global float *image, __global float *transmittance,
                             __global int *last_contributor)
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

inline void store_pixels(const Unit *unit, const Ends *e, __global const float *background,
                         int entries, int x, int y, int width, int height, __global float *image,
                         __global float *transmittance, __global int *last_contributor)
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
    const int columns = (width + TILE_SIZE - 1) / TILE_SIZE;
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

/* Largest lane. */
inline int max_lane(iv values)
{
    int lane[VEC];
    STORE_V(values, 0, lane);
    int largest = lane[0];
    for (int i = 1; i < VEC; ++i)
        largest = lane[i] > largest ? lane[i] : largest;
    return largest;
}

/* A unit of pixels on the way back, and where their centres are. */
typedef struct {
    Rays rays;
    fv x, y;
} RayUnit;

/* Rows of neighbouring entries lie far apart: without this every write waits for its line. */
#define ROWS_AHEAD 8
inline void fetch_row(__global const float *rows, __global const float *records, const int entry)
{
    __global const float *record = records + RECORD_SIZE * (size_t)entry;
    PREFETCH_WRITE(rows + ROW_SIZE * (size_t)as_int(record[RECORD_ROW]));
}

inline void store_moments(const Moments *m, __global float *row)
{
    vstore4(lane_sums(m->y1, m->y2, m->y11, m->y12), 0, row);
    vstore4(lane_sums(m->y22, m->red, m->green, m->blue), 1, row);
    row[8] = lane_sum(m->alpha);
}

__kernel void blend_backward(__global const float *records, __global const int *tile_range,
                             __global const float *background, const int width, const int height,
                             __global const float *transmittance,
                             __global const int *last_contributor, __global const float *d_image,
                             __global float *rows OBSERVE_PARAMETERS)
{
    const int tile = (int)get_global_id(0);
    const int columns = (width + TILE_SIZE - 1) / TILE_SIZE;
    const int x = tile % columns * TILE_SIZE, y = tile / columns * TILE_SIZE;
    const int first = tile_range[tile], end = tile_range[tile + 1];
    if (SKIP_EMPTY_TILES && first == end)
        return;
    const size_t plane = (size_t)width * (size_t)height;
    const TouchConstants constants = touch_constants(width >> 31);
    RayUnit units[UNITS];
    int unit_last[UNITS];
    int tile_last = 0;
    for (int u = 0; u < UNITS; ++u) {
        const int ux = x + unit_x(u), uy = y + unit_y(u);
        Rays *rays = &units[u].rays;
        units[u].x = LANE_X + (float)ux;
        units[u].y = LANE_Y + (float)uy;
        rays->transmittance = load_unit(transmittance, ux, uy, width, height);
        rays->d_red = load_unit(d_image, ux, uy, width, height);
        rays->d_green = load_unit(d_image + plane, ux, uy, width, height);
        rays->d_blue = load_unit(d_image + 2 * plane, ux, uy, width, height);
        rays->last =
            AS_IV(load_unit((__global const float *)last_contributor, ux, uy, width, height));
        rays->behind = fma(rays->d_red, (fv)(background[0]),
                           fma(rays->d_green, (fv)(background[1]), rays->d_blue * background[2]));
        unit_last[u] = SKIP_CONTRIBUTORS ? max_lane(rays->last) : end - first;
        tile_last = max(tile_last, unit_last[u]);
    }
    const Moments zero = {(fv)(0.0f), (fv)(0.0f), (fv)(0.0f), (fv)(0.0f), (fv)(0.0f),
                          (fv)(0.0f), (fv)(0.0f), (fv)(0.0f), (fv)(0.0f)};
    for (int k = end - 1; k >= first; --k) {
        __global const float *record = records + RECORD_SIZE * (size_t)k;
        const int number = k - first + 1;
        fetch_row(rows, records, max(k - ROWS_AHEAD, first));
        PREFETCH(record - 3 * ROWS_AHEAD * RECORD_SIZE);
        uint left = number <= tile_last ? as_uint(record[RECORD_UNITS]) : 0u;
        Paint paint;
        READ_PAINT(paint, record);
        Moments m = zero;
        while (left) {
            const int u = take_unit(&left);
            if (number > unit_last[u])
                continue;
            const Touch t = touch(&paint.splat, units[u].x, units[u].y, &constants);
            const iv taken = blend_back(&units[u].rays, &paint, &t, number, &m);
            OBSERVE(k, unit_x(u), unit_y(u), taken, t.saturated);
        }
        store_moments(&m, rows + ROW_SIZE * (size_t)as_int(record[RECORD_ROW]));
    }
}

#endif
