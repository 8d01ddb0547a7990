/* Blend the Gaussians of every tile front to back, and take the blend apart
 * again for gradients.
 *
 * Forward:  color += alpha T c,  T *= 1 - alpha; a pixel stops before T <
 * TRANSMITTANCE_STOP. Backward: back to front with T / (1 - alpha) and one
 * scalar a pixel, the colour behind the splat dotted with d_image. Every (tile,
 * Gaussian) entry writes one row of moments at a place of its own, and every
 * Gaussian then sums its rows in order: no atomics, the same bits in every run.
 *
 * CPU form: one work-item a tile, pixels in units of VEC. GPU form: one
 * work-item a pixel, records staged in local memory.
 */
#include "blend/blend_observe.h"
#include "blend/blend_step.h"
#include "common/items.h"
#include "common/prefetch.h"
#include "common/rows.h"
#include "blend/tile.h"

#ifndef USE_LOCAL
#define USE_LOCAL 0
#endif
#define UNIT_INVERSE (1.0f / WHITENING_UNIT)
#define BATCH 256 /* records staged at a time (GPU form) */
#define SPLATS_AHEAD 16

DEFINE_STORE_ROWS(store_rows16, 16)

inline fv clamp_color(const fv value)
{
    const fv raised = value < (fv)(-COLOR_LIMIT) ? (fv)(-COLOR_LIMIT) : value;
    return raised > (fv)(COLOR_LIMIT) ? (fv)(COLOR_LIMIT) : raised;
}

/* Record of every Gaussian; one work-item VEC of them. */
__kernel void blend_prepare(__global const float *mean2d, __global const float *whitening,
                            __global const float *color, __global const float *opacity,
                            const int count, __global float *splats)
{
    const int first = (int)item_from_middle() * VEC;
    if (first >= count)
        return;
    const size_t used = (size_t)min(VEC, count - first);
    const Ellipses e = load_ellipses(mean2d, whitening, opacity, (size_t)first, used);
    fv paint[3];
    load_rows3(color, (size_t)first, used, paint);
    const fv zero = (fv)(0.0f);
    const fv red = clamp_color(paint[0]), green = clamp_color(paint[1]),
             blue = clamp_color(paint[2]);
    const iv valid = red + green + blue <= (fv)(3.0f * COLOR_LIMIT); /* NaN touches nothing */
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
    store_rows16(record, splats, (size_t)first, used);
}

/* Units that a Gaussian may touch in the tile at (x, y). */
inline uint record_units(__global const float *splat, int x, int y)
{
#if VEC == 1
    (void)splat, (void)x, (void)y;
    return 1u;
#elif !SKIP_UNITS
    (void)splat, (void)x, (void)y;
    return ALL_UNITS;
#else
    __global const float *span = splat + RECORD_SPAN;
    return units_of((float2)(splat[0] - (float)x, splat[1] - (float)y), span[0], span[1], span[2]);
#endif
}

/* Records of all entries. One work-group a tile. */
__kernel void blend_gather(__global const float *splats, __global const int *gaussian,
                           __global const int *row, __global const int *tile_range, const int width,
                           __global float *records)
{
    const int tile = (int)get_group_id(0);
    const int columns = (width + TILE_SIZE - 1) / TILE_SIZE;
    const int x = tile % columns * TILE_SIZE, y = tile / columns * TILE_SIZE;
    const int begin = tile_range[tile] + (int)get_local_id(0), end = tile_range[tile + 1];
    const int step = (int)get_local_size(0);
    /* two loops: in a short one, more of the scattered reads are under way at the same time */
    for (int k = begin; k < end; k += step) {
        __global const float *splat = splats + RECORD_SIZE * (size_t)gaussian[k];
        __global float *record = records + RECORD_SIZE * (size_t)k;
        PREFETCH(splats + RECORD_SIZE * (size_t)gaussian[min(k + SPLATS_AHEAD, end - 1)]);
        vstore8(vload8(0, splat), 0, record);
        vstore4(vload4(2, splat), 2, record);
    }
    for (int k = begin; k < end; k += step) {
        __global float *record = records + RECORD_SIZE * (size_t)k;
        record[RECORD_UNITS] = as_float(record_units(record, x, y));
        record[RECORD_ROW] = as_float(row[k]);
    }
}

#if USE_LOCAL
#include "blend/blend_group.h"
#else
#include "blend/blend_tile.h"
#endif

/* The moments of a Gaussian, summed over its rows in their order. */
typedef struct {
    float8 first; /* y1, y2, y1^2, y1 y2, y2^2, red, green, blue */
    float alpha;
} Sums;

inline Sums load_sums(__global const float *from)
{
    const Sums s = {vload8(0, from), from[8]};
    return s;
}

inline Sums add_rows(Sums s, __global const float *rows, int begin, int end)
{
    for (int k = begin; k < end; ++k) {
        const Sums row = load_sums(rows + ROW_SIZE * (size_t)k);
        s.first += row.first;
        s.alpha += row.alpha;
    }
    return s;
}

/* Adds the rows of every Gaussian to its sums, (count, ROW_USED). */
__kernel void blend_accumulate(__global const float *rows, __global const int *row_range,
                               const int count, __global float *sums)
{
    const int i = (int)item_from_middle();
    if (i >= count)
        return;
    __global float *own = sums + ROW_USED * (size_t)i;
    const Sums s = add_rows(load_sums(own), rows, row_range[i], row_range[i + 1]);
    vstore8(s.first, 0, own);
    own[8] = s.alpha;
}

#define GRADIENTS                                                                                  \
    __global float *d_mean2d, __global float *d_whitening, __global float *d_color,                \
        __global float *d_opacity

inline void store_gradients(Sums s, int i, __global const float *whitening,
                            __global const float *color, __global const float *opacity, GRADIENTS)
{
    const float r1 = whitening[3 * i], l = whitening[3 * i + 1], r2 = whitening[3 * i + 2];
    const bool touched = any(s.first != (float8)(0.0f)) | (s.alpha != 0.0f);
    const bool drawn =
        touched & (opacity[i] > 0.0f) & (r1 > 0.0f) & (r2 > 0.0f) & (fabs(l) < INFINITY);
    const float sigma = 1.0f / r1;
    const float m1 = -s.first.s0 * UNIT_INVERSE, m2 = -s.first.s1 * UNIT_INVERSE;
    const float3 square = s.first.s234 * (UNIT_INVERSE * UNIT_INVERSE);
    d_mean2d[2 * i] = drawn ? fma(r1, m1, -l * r2 * m2) : 0.0f;
    d_mean2d[2 * i + 1] = drawn ? r2 * m2 : 0.0f;
    d_whitening[3 * i] = drawn ? -square.x * sigma : 0.0f;
    d_whitening[3 * i + 1] = drawn ? square.y * r2 * sigma : 0.0f;
    d_whitening[3 * i + 2] = drawn ? -square.z / r2 : 0.0f;
    d_opacity[i] = drawn ? s.alpha / opacity[i] : 0.0f;
    d_color[3 * i] = fabs(color[3 * i]) <= COLOR_LIMIT ? s.first.s5 : 0.0f;
    d_color[3 * i + 1] = fabs(color[3 * i + 1]) <= COLOR_LIMIT ? s.first.s6 : 0.0f;
    d_color[3 * i + 2] = fabs(color[3 * i + 2]) <= COLOR_LIMIT ? s.first.s7 : 0.0f;
}

/* Gradients of every Gaussian, from its rows. */
__kernel void blend_sum(__global const float *rows, __global const int *row_range, const int count,
                        __global const float *whitening, __global const float *color,
                        __global const float *opacity, GRADIENTS)
{
    const int i = (int)item_from_middle();
    if (i >= count)
        return;
    const Sums zero = {(float8)(0.0f), 0.0f};
    store_gradients(add_rows(zero, rows, row_range[i], row_range[i + 1]), i, whitening, color,
                    opacity, d_mean2d, d_whitening, d_color, d_opacity);
}

/* The same, from its sums over all rows. */
__kernel void blend_finish(__global const float *sums, const int count,
                           __global const float *whitening, __global const float *color,
                           __global const float *opacity, GRADIENTS)
{
    const int i = (int)item_from_middle();
    if (i >= count)
        return;
    store_gradients(load_sums(sums + ROW_USED * (size_t)i), i, whitening, color, opacity, d_mean2d,
                    d_whitening, d_color, d_opacity);
}
