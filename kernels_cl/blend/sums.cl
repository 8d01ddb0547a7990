/* Gradients of every Gaussian from the rows of moments of its entries in the tile lists. The rows
 * of a Gaussian are neighbours and are added in their order, so that all runs agree bit for bit.
 *
 * A work-item owns a Gaussian; launch size: at least the number of Gaussians, in work-groups of any
 * size. No local memory. */
#include "blend/moments.h"
#include "blend/record.h"
#include "common/ellipses.h"
#include "common/items.h"

/* The moments of a Gaussian, summed over its rows in order. */
typedef struct {
    float8 first; /* y1, y2, y1^2, y1 y2, y2^2, red, green, blue */
    float alpha;
} Sums;

static inline Sums load_sums(__global const float *from)
{
    const Sums s = {vload8(0, from), from[8]};
    return s;
}

static inline Sums add_rows(Sums s, __global const float *rows, int begin, int end)
{
    for (int k = begin; k < end; ++k) {
        const Sums row = load_sums(rows + ROW_SIZE * (size_t)k);
        s.first += row.first;
        s.alpha += row.alpha;
    }
    return s;
}

/* Adds the rows of every Gaussian to its sums, (count, SUM_SIZE). */
__kernel void blend_accumulate(__global const float *rows, __global const int *row_range,
                               const int count, __global float *sums)
{
    const size_t i = item_from_middle();
    if (i >= (size_t)count)
        return;
    __global float *own = sums + SUM_SIZE * i;
    const Sums s = add_rows(load_sums(own), rows, row_range[i], row_range[i + 1]);
    vstore8(s.first, 0, own);
    own[8] = s.alpha;
}

#define UNIT_INVERSE (1.0f / WHITENING_UNIT)

#define GRADIENTS                                                                                  \
    __global float *d_mean2d, __global float *d_whitening, __global float *d_color,                \
        __global float *d_opacity

/* The gradients of Gaussian i from its sums, by the chain rule on
 *     alpha = opacity exp(-(y1^2 + y2^2) / 2),  y1 = dx r1,  y2 = (dy - l dx) r2
 * as in clgs/reference/blend.py; sums with an odd power of y1 or y2 have the other sign here. */
static inline void store_gradients(Sums s, size_t i, __global const float *whitening,
                                   __global const float *color, __global const float *opacity,
                                   GRADIENTS)
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
    const size_t i = item_from_middle();
    if (i >= (size_t)count)
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
    const size_t i = item_from_middle();
    if (i >= (size_t)count)
        return;
    store_gradients(load_sums(sums + SUM_SIZE * i), i, whitening, color, opacity, d_mean2d,
                    d_whitening, d_color, d_opacity);
}
