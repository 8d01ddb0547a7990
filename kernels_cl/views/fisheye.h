/* An equidistant fisheye: a point appears as far from the principal point as its angle to the axis.
 *
 * With r the distance from the axis, z the depth and w the larger of both, a point (x, y, z)
 * appears at f (x, y) angle / r. Derivatives of angle / r are multiples of powers of 1 / w by
 * numbers that depend on the smaller of r and z by the larger alone, and that no difference cancels
 * at r = 0. */
#ifndef CLGS_FISHEYE_H
#define CLGS_FISHEYE_H

#include "common/camera.h"
#include "common/own_function.h"
#include "common/real.h"

#define HALF_PI 1.57079633f

/* VEC points as the lens bends their rays. */
typedef struct {
    fv side[2];   /* x, y by w */
    fv ahead;     /* z by w */
    fv on_w;      /* 1 / w */
    fv on_square; /* 1 / (r^2 + z^2), by w^2 */
    fv bent;      /* g = angle / r, by w */
    fv slope;     /* (dg/dr) / r, by w^3 */
    fv curve;     /* (d slope/dr) / r, by w^5 */
} Bend;

/* R of arctan(k) / k = 1 - s / 3 + s^2 R(s), s = k^2 of 0 to 1; the error of the sum is 2e-8. */
static inline fv arctan_rest(const fv s)
{
    const float terms[9] = {2.20629736e-3f,  -1.22631131e-2f, 3.19203176e-2f,
                            -5.43749630e-2f, 7.33344853e-2f,  -9.02930051e-2f,
                            1.11056775e-1f,  -1.42855272e-1f, 1.99999988e-1f};
    fv sum = (fv)(terms[0]);
    for (int i = 1; i < 9; ++i)
        sum = fma(sum, s, (fv)(terms[i]));
    return sum;
}

static inline OWN_FUNCTION Bend bend(const fv point[3])
{
    Bend b;
    const fv zero = (fv)(0.0f), one = (fv)(1.0f), x = fabs(point[0]), y = fabs(point[1]);
    const fv large = x > y ? x : y, small = x > y ? y : x, z = point[2];
    const fv ratio = large > zero ? small / large : zero;
    const fv r = large * sqrt(fma(ratio, ratio, one));
    const iv wide = r > z; /* more than 45 degrees from the axis */
    const fv w = wide ? r : z, k = (wide ? z : r) / w, s = k * k;
    b.ahead = wide ? k : one;
    b.on_w = one / w;
    b.side[0] = point[0] / w;
    b.side[1] = point[1] / w;
    b.on_square = one / (one + s);
    const fv rest = arctan_rest(s), second = fma(s, rest, (fv)(-1.0f / 3.0f));
    const fv by_k = fma(s, second, one), angle = (fv)(HALF_PI)-k * by_k;
    const fv near_slope = -(b.on_square + second), wide_slope = k * b.on_square - angle;
    const fv square = b.on_square * b.on_square;
    b.bent = wide ? angle : by_k;
    b.slope = wide ? wide_slope : near_slope;
    b.curve = wide ? -2.0f * k * square - 3.0f * wide_slope : (one - s) * square + 3.0f * rest;
    return b;
}

/* Rows of the Jacobian, of focal lengths fx and fy. */
static inline void bent_rays(const Bend *b, __global const float *camera, fv rays[2][3])
{
    for (int axis = 0; axis < 2; ++axis) {
        const fv focal_on_w = camera[CAMERA_FX + axis] * b->on_w;
        for (int k = 0; k < 2; ++k) {
            const fv across = b->side[axis] * b->side[k] * b->slope;
            rays[axis][k] = focal_on_w * (axis == k ? across + b->bent : across);
        }
        rays[axis][2] = -focal_on_w * b->side[axis] * b->on_square;
    }
}

/* dL/d(point), from dL/d(mean2d) and from that by the Jacobian. */
static inline void bent_gradient(const Bend *b, const fv rays[2][3], const fv d_mean2d[2],
                                 const fv d_rays[2][3], __global const float *camera, fv d_point[3])
{
    fv d[2][3];
    for (int axis = 0; axis < 2; ++axis)
        for (int k = 0; k < 3; ++k)
            d[axis][k] = d_rays[axis][k] * camera[CAMERA_FX + axis] * b->on_w * b->on_w;
    const fv *n = b->side, square = 2.0f * b->on_square * b->on_square, trace = d[0][0] + d[1][1];
    const fv along =
        n[0] * (d[0][0] * n[0] + d[0][1] * n[1]) + n[1] * (d[1][0] * n[0] + d[1][1] * n[1]);
    const fv deep = d[0][2] * n[0] + d[1][2] * n[1];
    const fv outward = b->slope * trace + b->curve * along + square * deep;
    for (int k = 0; k < 2; ++k) {
        const fv lean = (d[k][0] + d[0][k]) * n[0] + (d[k][1] + d[1][k]) * n[1];
        d_point[k] = n[k] * outward + b->slope * lean - b->on_square * d[k][2];
    }
    d_point[2] = square * (along + b->ahead * deep) - b->on_square * trace;
    for (int k = 0; k < 3; ++k)
        d_point[k] += rays[0][k] * d_mean2d[0] + rays[1][k] * d_mean2d[1];
}

#endif
