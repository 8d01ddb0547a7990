/* Records for the blending: one per Gaussian, then copies in the order of the tile lists, so that
 * the blending reads a stream.
 *
 * blend_prepare: a work-item makes the records of VEC Gaussians; launch size: at least
 * Gaussians / VEC, in work-groups of any size. blend_gather: a work-group copies the records of one
 * tile, its work-items every get_local_size-th; launch size: tiles * (1 on a CPU, TILE_SIZE^2 on a
 * GPU). No local memory. */
#include "blend/record.h"
#include "blend/units.h"
#include "common/ellipses.h"
#include "common/items.h"
#include "common/prefetch.h"
#include "common/real.h"
#include "common/rows.h"
#include "common/tile_size.h"

#ifndef SKIP_UNITS
#define SKIP_UNITS 1 /* see Skips in clgs/options.py */
#endif

#define RECORDS_AHEAD 16

#if VEC == 1
/* As below, but 16 bytes at a time: records lie at multiples of 64. */
static inline void store_rows16(const float columns[16], __global float *values, const size_t first,
                                const size_t used)
{
    (void)used;
    __global float4 *record = (__global float4 *)values + 4 * first;
    for (int j = 0; j < 4; ++j)
        record[j] = vload4((size_t)j, columns);
}
#else
DEFINE_STORE_ROWS(store_rows16, 16)
#endif

static inline fv clamp_color(const fv value)
{
    const fv raised = value < (fv)(-COLOR_LIMIT) ? (fv)(-COLOR_LIMIT) : value;
    return raised > (fv)(COLOR_LIMIT) ? (fv)(COLOR_LIMIT) : raised;
}

/* Record of every Gaussian; one with a NaN touches nothing. */
__kernel void blend_prepare(__global const float *mean2d, __global const float *whitening,
                            __global const float *color, __global const float *opacity,
                            const int count, __global float *prepared)
{
    const int first = (int)item_from_middle() * VEC;
    if (first >= count)
        return;
    const size_t used = (size_t)min(VEC, count - first);
    const Ellipses e = load_ellipses(mean2d, whitening, opacity, (size_t)first, used);
    fv rgb[3];
    load_rows3(color, (size_t)first, used, rgb);
    const fv zero = (fv)(0.0f);
    const fv red = clamp_color(rgb[0]), green = clamp_color(rgb[1]), blue = clamp_color(rgb[2]);
    const iv valid = red + green + blue <= (fv)(3.0f * COLOR_LIMIT);
    const fv record[RECORD_SIZE] = {e.x,
                                    e.y,
                                    e.r1,
                                    e.l,
                                    e.r2,
                                    valid ? e.bias : (fv)(-INFINITY),
                                    valid ? red : zero,
                                    valid ? green : zero,
                                    valid ? blue : zero,
                                    e.slope,
                                    e.squared,
                                    e.shrink,
                                    zero,
                                    zero,
                                    zero,
                                    zero};
    store_rows16(record, prepared, (size_t)first, used);
}

/* Writes the units that VEC entries from k on, of those before `end`, may touch in the tile at
 * (x, y). */
static inline void write_units(__global float *records, const int k, const int end, const int x,
                               const int y)
{
    int units[VEC];
#if SKIP_UNITS
    float numbers[5][VEC];
    for (int lane = 0; lane < VEC; ++lane) {
        __global const float *record = records + RECORD_SIZE * (size_t)min(k + lane, end - 1);
        numbers[0][lane] = record[0] - (float)x;
        numbers[1][lane] = record[1] - (float)y;
        for (int i = 0; i < 3; ++i)
            numbers[2 + i][lane] = record[RECORD_ELLIPSE + i];
    }
    const TileEllipses e = {LOAD_V(0, numbers[0]), LOAD_V(0, numbers[1]), LOAD_V(0, numbers[2]),
                            LOAD_V(0, numbers[3]), LOAD_V(0, numbers[4])};
    STORE_V(touched_units(&e), 0, units);
#else
    (void)x, (void)y;
    STORE_V((iv)((int)ALL_UNITS), 0, units);
#endif
    for (int lane = 0; lane < VEC && k + lane < end; ++lane)
        records[RECORD_SIZE * (size_t)(k + lane) + RECORD_UNITS] = as_float(units[lane]);
}

/* Records of the entries of every tile, from those of their Gaussians. */
__kernel void blend_gather(__global const float *prepared, __global const int *gaussian,
                           __global const int *row, __global const int *tile_range, const int width,
                           __global float *records)
{
    const int tile = (int)get_group_id(0);
    const int columns = tiles_across(width);
    const int x = tile % columns * TILE_SIZE, y = tile / columns * TILE_SIZE;
    const int item = (int)get_local_id(0), step = (int)get_local_size(0);
    const int end = tile_range[tile + 1];
    /* two loops: in a short one, more of the scattered reads are under way at the same time */
    for (int k = tile_range[tile] + item; k < end; k += step) {
        __global const float *own = prepared + RECORD_SIZE * (size_t)gaussian[k];
        __global float *record = records + RECORD_SIZE * (size_t)k;
        PREFETCH(prepared + RECORD_SIZE * (size_t)gaussian[min(k + RECORDS_AHEAD, end - 1)]);
        for (int j = 0; j < RECORD_USED / 4; ++j)
            ((__global float4 *)record)[j] = ((__global const float4 *)own)[j];
    }
    for (int k = tile_range[tile] + item * VEC; k < end; k += step * VEC) {
        write_units(records, k, end, x, y);
        for (int i = k; i < min(k + VEC, end); ++i)
            records[RECORD_SIZE * (size_t)i + RECORD_ROW] = as_float(row[i]);
    }
}
