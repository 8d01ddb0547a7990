/* The rate proxy's passes over an attribute. A channel's Laplace model needs nothing of its symbols
 * n = rint(x q) but sums of integers: their sum, and about the centre m = rint(mean), with
 * k = n - m, the counts below and above, and the sums of |k| and k^2. The op turns them into bits
 * in float64, and into a gradient that is piecewise linear in k. No transcendental function is
 * needed here, and no sum loses a digit as long as it is below 2^24.
 *
 * rate_total, rate_statistics: a work-item per column of the period and block of
 *     VECTORS_PER_BLOCK periods.
 * rate_backward: a work-item per vector; every attribute's begin with a work-group.
 * Work-group: any; no local memory.
 *
 * Arrays are read flat, VEC lanes at a time. The channel of a lane repeats every `period` vectors
 * (VEC rows), so every table has VEC * period elements, the channel changing fastest.
 */
#include "common/lanes.h"
#include "common/parts.h"
#include "common/real.h"

#ifndef VECTORS_PER_BLOCK
#define VECTORS_PER_BLOCK 256
#endif

/* Rounded symbols of VEC elements; lanes at or past `total` are zero. */
static inline fv symbols(__global const float *x, size_t vector, size_t total, float q)
{
    return rint(load_lanes(x, vector, total) * q);
}

/* 1 for lanes before `total`, else 0. */
static inline fv valid_lanes(size_t vector, size_t total)
{
    if ((vector + 1) * VEC <= total)
        return (fv)(1.0f);
    float lanes[VEC];
    for (size_t lane = 0; lane < VEC; ++lane)
        lanes[lane] = vector * VEC + lane < total ? 1.0f : 0.0f;
    return LOAD_V(0, lanes);
}

/* sums[block][column]: sum of the symbols. */
__kernel void rate_total(__global const float *x, const uint total, const float q,
                         const uint period, const uint blocks, __global float *sums)
{
    const size_t column = get_global_id(0) % period, block = get_global_id(0) / period;
    if (block >= blocks)
        return;
    fv sum = (fv)(0.0f);
    for (size_t i = block * VECTORS_PER_BLOCK; i < (block + 1) * VECTORS_PER_BLOCK; ++i) {
        const size_t vector = i * period + column;
        if (vector * VEC >= total)
            break;
        sum += symbols(x, vector, total, q);
    }
    STORE_V(sum, block * period + column, sums);
}

/* Like rate_total, but five statistics of k = n - centre, one plane each: the counts of
 * [0] low <= k < 0, [1] 0 < k <= high and [2] k outside of [low, high], and the sums of [3] |k|
 * inside and [4] all k^2. limits: low and high, each a table. */
__kernel void rate_statistics(__global const float *x, const uint total, const float q,
                              const uint period, const uint blocks, __global const float *centre,
                              __global const float *limits, __global float *sums)
{
    const size_t column = get_global_id(0) % period, block = get_global_id(0) / period;
    if (block >= blocks)
        return;
    const fv middle = LOAD_V(column, centre);
    const fv low = LOAD_V(column, limits), high = LOAD_V(period + column, limits);
    const fv zero = (fv)(0.0f), one = (fv)(1.0f);
    fv below = zero, above = zero, outside = zero, distance = zero, square = zero;
    for (size_t i = block * VECTORS_PER_BLOCK; i < (block + 1) * VECTORS_PER_BLOCK; ++i) {
        const size_t vector = i * period + column;
        if (vector * VEC >= total)
            break;
        const fv valid = valid_lanes(vector, total);
        const fv k = (symbols(x, vector, total, q) - middle) * valid;
        const fv is_below = k < zero ? one : zero, is_above = k > zero ? one : zero;
        const fv is_outside = k < low ? one : k > high ? one : zero;
        below = fma(is_below, one - is_outside, below);
        above = fma(is_above, one - is_outside, above);
        outside += is_outside;
        distance = fma(fabs(k), one - is_outside, distance);
        square = fma(k, k, square);
    }
    const size_t at = block * period + column, plane = (size_t)blocks * period;
    STORE_V(below, at, sums);
    STORE_V(above, plane + at, sums);
    STORE_V(outside, 2 * plane + at, sums);
    STORE_V(distance, 3 * plane + at, sums);
    STORE_V(square, 4 * plane + at, sums);
}

/* The work-groups after those of other attributes belong to attribute n, if it has elements. */
#define CHOOSE_ATTRIBUTE(n)                                                                        \
    if (get_group_id(0) >= first_group) {                                                          \
        attribute_group = first_group;                                                             \
        x = x##n;                                                                                  \
        tables = tables##n;                                                                        \
        d_x = d_x##n;                                                                              \
        total = sizes.s##n;                                                                        \
        q = scales.s##n;                                                                           \
        step = periods.s##n;                                                                       \
    }                                                                                              \
    first_group += groups_of(vectors_in(sizes.s##n));

/* d_x += slope k + (value of k's side) of up to three attributes. tables: [0] centre, [1] low,
 * [2] high, [3] slope, and the values [4] below, [5] at the centre, [6] above, [7] outside of
 * [low, high]. */
PARTS_GROUP __kernel void rate_backward(__global const float *x0, __global const float *x1,
                                        __global const float *x2, const uint4 sizes,
                                        const float4 scales, const uint4 periods,
                                        __global const float *tables0,
                                        __global const float *tables1,
                                        __global const float *tables2, __global float *d_x0,
                                        __global float *d_x1, __global float *d_x2)
{
    uint first_group = 0, attribute_group = 0;
    size_t step = 1;
    __global const float *x = x0, *tables = tables0;
    __global float *d_x = d_x0;
    uint total = 0;
    float q = 1.0f;
    CHOOSE_ATTRIBUTE(0)
    CHOOSE_ATTRIBUTE(1)
    CHOOSE_ATTRIBUTE(2)
    const size_t vector = item_of_part(attribute_group);
    if (vector >= vectors_in(total))
        return;
    const size_t column = vector % step;
    const fv k = symbols(x, vector, total, q) - LOAD_V(column, tables);
    fv value = k<(fv)(0.0f) ? LOAD_V(4 * step + column, tables) : k>(fv)(0.0f)
                   ? LOAD_V(6 * step + column, tables)
                   : LOAD_V(5 * step + column, tables);
    const fv outside = LOAD_V(7 * step + column, tables);
    value = k < LOAD_V(step + column, tables) ? outside : value;
    value = k > LOAD_V(2 * step + column, tables) ? outside : value;
    const fv slope = LOAD_V(3 * step + column, tables);
    store_lanes(load_lanes(d_x, vector, total) + fma(k, slope, value), vector, d_x, total);
}
