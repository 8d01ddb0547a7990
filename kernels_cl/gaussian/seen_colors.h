/* Colors of Gaussians from spherical harmonics in the direction from the camera, and the way back.
 *
 * sh and d_sh are (N, SH_ROWS, 3), of which the first COEFFICIENTS rows are used. */
#ifndef CLGS_SEEN_COLORS_H
#define CLGS_SEEN_COLORS_H

#include "common/camera.h"
#include "common/lane_math.h"
#include "common/real.h"
#include "gaussian/harmonics.h"

#ifndef SH_ROWS
#define SH_ROWS COEFFICIENTS
#endif
#ifndef BARE_SUMS
#define BARE_SUMS 0 /* whether colors are the sums as they are, not 1/2 more and at least 0 */
#endif

/* Below, a Gaussian lies in the camera's centre and has the direction 0. */
#define SHORTEST_SQUARE 1e-30f

/* Unit vectors from the camera's centre to `position`; returns the reciprocals of the lengths. */
static inline fv look_at(const fv position[3], __global const float *camera, fv direction[3])
{
    for (int i = 0; i < 3; ++i)
        direction[i] = position[i] - camera[CAMERA_CENTRE + i];
    const fv square = dot3(direction, direction);
    const fv on_length = square > (fv)(SHORTEST_SQUARE) ? 1.0f / sqrt(square) : (fv)(0.0f);
    for (int i = 0; i < 3; ++i)
        direction[i] *= on_length;
    return on_length;
}

/* Colors of `used` Gaussians from number `first` on. Negative ones become 0; NaN stays NaN. */
static inline void write_colors(__global const float *sh, const fv basis[MAX_COEFFICIENTS],
                                const size_t first, const size_t used, __global float *color)
{
    float lanes[COEFFICIENTS][VEC];
    for (size_t c = 0; c < COEFFICIENTS; ++c)
        STORE_V(basis[c], 0, lanes[c]);
    for (size_t lane = 0; lane < used; ++lane) {
        __global const float *row = sh + 3 * SH_ROWS * (first + lane);
        for (size_t i = 0; i < 3; ++i) {
            float sum = BARE_SUMS ? 0.0f : 0.5f;
            for (size_t c = 0; c < COEFFICIENTS; ++c)
                sum = fma(lanes[c][lane], row[3 * c + i], sum);
            color[3 * (first + lane) + i] = !BARE_SUMS && sum < 0.0f ? 0.0f : sum;
        }
    }
}

/* Writes d_sh of `used` Gaussians from number `first` on; weight: dL/d(basis). A channel that was
 * negative before it became 0 has no gradient. */
static inline void color_gradient(__global const float *sh, __global const float *color,
                                  __global const float *d_color, const fv basis[MAX_COEFFICIENTS],
                                  const size_t first, const size_t used,
                                  fv weight[MAX_COEFFICIENTS], __global float *d_sh)
{
    float lanes[COEFFICIENTS][VEC], sums[MAX_COEFFICIENTS][VEC];
    for (size_t c = 0; c < MAX_COEFFICIENTS; ++c)
        STORE_V((fv)(0.0f), 0, sums[c]);
    for (size_t c = 0; c < COEFFICIENTS; ++c)
        STORE_V(basis[c], 0, lanes[c]);
    for (size_t lane = 0; lane < used; ++lane) {
        const size_t n = first + lane, row = 3 * SH_ROWS * n;
        float d[3];
        for (size_t i = 0; i < 3; ++i)
            d[i] = BARE_SUMS || color[3 * n + i] > 0.0f ? d_color[3 * n + i] : 0.0f;
        /* Coefficient by coefficient: each sum takes the register of its number of the basis. */
#pragma unroll
        for (size_t c = 0; c < COEFFICIENTS; ++c) {
            float sum = 0.0f;
            for (size_t i = 0; i < 3; ++i) {
                sum = fma(d[i], sh[row + 3 * c + i], sum);
                d_sh[row + 3 * c + i] = d[i] * lanes[c][lane];
            }
            sums[c][lane] = sum;
        }
    }
    for (size_t c = 0; c < MAX_COEFFICIENTS; ++c)
        weight[c] = LOAD_V(0, sums[c]);
}

/* Adds to d_mean what moves the color, by the direction from the camera. */
static inline void direction_gradient(const fv direction[3], const fv on_length,
                                      const fv weight[MAX_COEFFICIENTS], fv d_position[3])
{
    fv d[3];
    harmonics_slopes(direction, weight, d);
    const fv along = dot3(direction, d);
    for (int i = 0; i < 3; ++i)
        d_position[i] = fma(d[i] - along * direction[i], on_length, d_position[i]);
}

#endif
