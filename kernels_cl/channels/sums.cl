/* Gradients of every Gaussian from the moments that the entries of its tiles left: the rows of a
 * Gaussian are neighbours and are added in their order, so that all runs agree bit for bit.
 *
 * A work-item owns a Gaussian; launch size: at least the number of Gaussians, in work-groups of any
 * size. No local memory.
 *
 * A Gaussian's sums: the first moments, FIXED_SUMS with the absolute ones, then every channel. */
#include "channels/layout.h"
#include "common/ellipses.h"
#include "common/items.h"

#ifndef FIXED_SUMS
#define FIXED_SUMS 8
#endif

#define SUMS_AT_ONCE (MOMENTS < 16 ? MOMENTS : 16) /* more would not all stay in registers */

/* Where a moment is summed, among the sums of a Gaussian. */
static inline int place_of_sum(const int moment, const int first)
{
    return moment < MOMENT_CHANNEL ? moment : FIXED_SUMS + first + moment - MOMENT_CHANNEL;
}

/* Whether a sum holds what was added before: another launch, or one for other channels. */
static inline bool is_begun(const int moment, const int first, const int fresh)
{
    return !fresh || (first > 0 && moment < MOMENT_CHANNEL);
}

/* Adds the rows of every Gaussian to its sums, (count, sums_pitch); `first`: of the channels;
 * `fresh`: not 0 if no rows were added before, so that the sums hold nothing yet. */
__kernel void channels_accumulate(__global const float *rows, __global const int *row_range,
                                  const int count, const int first, const int fresh,
                                  const int sums_pitch, __global float *sums)
{
    const size_t i = item_from_middle();
    if (i >= (size_t)count)
        return;
    __global float *own = sums + (size_t)sums_pitch * i;
#pragma unroll 1
    for (int begin = 0; begin < MOMENTS; begin += SUMS_AT_ONCE) {
        float sum[SUMS_AT_ONCE];
#pragma unroll
        for (int j = 0; j < SUMS_AT_ONCE; ++j)
            sum[j] = begin + j < MOMENTS && is_begun(begin + j, first, fresh)
                         ? own[place_of_sum(begin + j, first)]
                         : 0.0f;
        for (int k = row_range[i]; k < row_range[i + 1]; ++k)
#pragma unroll
            for (int j = 0; j < SUMS_AT_ONCE; ++j)
                if (begin + j < MOMENTS)
                    sum[j] += rows[MOMENT_PITCH * (size_t)k + (size_t)(begin + j)];
#pragma unroll
        for (int j = 0; j < SUMS_AT_ONCE; ++j)
            if (begin + j < MOMENTS)
                own[place_of_sum(begin + j, first)] = sum[j];
    }
}

/* Gradients from the sums of all rows; d_absolute: (count, 2), or anything WITH_ABSOLUTE 0;
 * d_color: (count, colors); d_depth: (count,), or anything WITH_DEPTH 0. */
__kernel void channels_finish(__global const float *sums, const int count, const int sums_pitch,
                              const int colors, __global const float *whitening,
                              __global const float *opacity, __global float *d_mean2d,
                              __global float *d_whitening, __global float *d_opacity,
                              __global float *d_absolute, __global float *d_color,
                              __global float *d_depth)
{
    const size_t i = item_from_middle();
    if (i >= (size_t)count)
        return;
    __global const float *s = sums + (size_t)sums_pitch * i;
    const float r1 = whitening[3 * i], l = whitening[3 * i + 1], r2 = whitening[3 * i + 2];
    bool touched = false; /* else compilers may choose the sign of a zero */
    for (int j = 0; j <= MOMENT_ALPHA; ++j)
        touched |= s[j] != 0.0f;
    const bool drawn = touched & (opacity[i] > 0.0f) & (r1 > 0.0f) & (r2 > 0.0f);
    const float inverse = 1.0f / WHITENING_UNIT, square = inverse * inverse;
    const float m1 = -s[0] * inverse, m2 = -s[1] * inverse, sigma = 1.0f / r1;
    d_mean2d[2 * i] = drawn ? fma(r1, m1, -l * r2 * m2) : 0.0f;
    d_mean2d[2 * i + 1] = drawn ? r2 * m2 : 0.0f;
    d_whitening[3 * i] = drawn ? -s[2] * square * sigma : 0.0f;
    d_whitening[3 * i + 1] = drawn ? s[3] * square * r2 * sigma : 0.0f;
    d_whitening[3 * i + 2] = drawn ? -s[4] * square / r2 : 0.0f;
    d_opacity[i] = drawn ? s[MOMENT_ALPHA] / opacity[i] : 0.0f;
#if WITH_ABSOLUTE
    d_absolute[2 * i] = s[MOMENT_ABSOLUTE];
    d_absolute[2 * i + 1] = s[MOMENT_ABSOLUTE + 1];
#else
    (void)d_absolute;
#endif
    for (int c = 0; c < colors; ++c)
        d_color[(size_t)colors * i + (size_t)c] = s[FIXED_SUMS + c];
#if WITH_DEPTH
    d_depth[i] = s[FIXED_SUMS + colors];
#else
    (void)d_depth;
#endif
}
