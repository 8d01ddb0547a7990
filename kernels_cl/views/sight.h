/* VEC Gaussians as a camera sees them, up to the blurred covariance.
 *
 * A shape is a square root of the covariance, by columns: R S, or the lower triangle of Cholesky.
 */
#ifndef CLGS_SIGHT_H
#define CLGS_SIGHT_H

#include "common/camera.h"
#include "common/camera_space.h"
#include "common/lane_math.h"
#include "common/own_function.h"
#include "common/real.h"
#include "common/rows.h"
#include "gaussian/projection.h"
#include "gaussian/unit_quaternion.h"
#include "views/fisheye.h"

#ifndef PARALLEL_RAYS
#define PARALLEL_RAYS 0
#endif
#ifndef FISHEYE
#define FISHEYE 0
#endif
#ifndef BY_COVARIANCE
#define BY_COVARIANCE 0 /* shapes are xx, xy, xz, yy, yz, zz, not scales and rotations */
#endif
#ifndef COMPENSATED
#define COMPENSATED 0 /* whether opacities make up for the blur */
#endif
#ifndef UNIT_OPACITY
#define UNIT_OPACITY 1.000001f
#endif

/* VEC Gaussians on the way to the screen; of `p`, what depends on the screen. */
typedef struct {
    fv point[3];
    fv root[3][3];   /* columns of the shape, in the world */
    fv seen[3][3];   /* the same in camera space */
    fv turn[3][3];   /* the rotation matrix, unless BY_COVARIANCE */
    fv unit_quat[4]; /* with the reciprocal of its length before */
    fv on_length;
    fv rays[2][3]; /* rows of the Jacobian */
    fv share;      /* of the opacity that is left */
    fv doubt;      /* 0; NaN if a number is not finite, or a quaternion 0 */
    Projection p;
} Sight;

#if BY_COVARIANCE
/* Square root, and 0 of what rounding made negative. */
static inline fv root_of(const fv x)
{
    return sqrt(x > (fv)(0.0f) ? x : (fv)(0.0f));
}

static inline fv ratio_of(const fv x, const fv y)
{
    return y > (fv)(0.0f) ? x / y : (fv)(0.0f);
}

/* Number `i` of `width` per Gaussian. */
static inline fv load_number(__global const float *values, const size_t first, const size_t used,
                             const size_t width, const size_t i)
{
    float lanes[VEC];
    for (size_t lane = 0; lane < VEC; ++lane)
        lanes[lane] = values[width * (first + min(lane, used - 1)) + i];
    return LOAD_V(0, lanes);
}
#endif

static inline OWN_FUNCTION void load_shape(Sight *s, __global const float *shape,
                                           __global const float *rotation, const size_t first,
                                           const size_t used)
{
#if BY_COVARIANCE
    (void)rotation;
    fv c[6];
    for (size_t i = 0; i < 6; ++i) {
        c[i] = load_number(shape, first, used, 6, i);
        s->doubt += 0.0f * c[i];
    }
    const fv zero = (fv)(0.0f);
    const fv xx = root_of(c[0]), yx = ratio_of(c[1], xx), zx = ratio_of(c[2], xx);
    const fv yy = root_of(c[3] - yx * yx), zy = ratio_of(c[4] - zx * yx, yy);
    const fv zz = root_of(c[5] - zx * zx - zy * zy);
    const fv columns[3][3] = {{xx, yx, zx}, {zero, yy, zy}, {zero, zero, zz}};
    for (int k = 0; k < 3; ++k)
        for (int i = 0; i < 3; ++i)
            s->root[k][i] = columns[k][i];
#else
    load_rows4(rotation, first, used, s->unit_quat);
    fv length = (fv)(0.0f);
    for (int k = 0; k < 4; ++k)
        length += fabs(s->unit_quat[k]);
    s->doubt += length > (fv)(0.0f) ? 0.0f * length : (fv)(NAN);
    s->on_length = make_unit(s->unit_quat);
    quaternion_matrix(s->unit_quat, s->turn);
    load_rows3(shape, first, used, s->p.scale);
    for (int k = 0; k < 3; ++k)
        s->doubt += 0.0f * s->p.scale[k];
    for (int k = 0; k < 3; ++k)
        for (int i = 0; i < 3; ++i)
            s->root[k][i] = s->turn[i][k] * s->p.scale[k];
#endif
}

static inline void see_point(Sight *s, const fv mean[3], __global const float *camera)
{
    Projection *p = &s->p;
    for (int row = 0; row < 3; ++row)
        s->point[row] = camera_coordinate(camera, row, mean);
    p->z = s->point[2];
#if FISHEYE
    const Bend b = bend(s->point);
    for (int axis = 0; axis < 2; ++axis)
        p->slope[axis] = b.side[axis] * b.bent;
    bent_rays(&b, camera, s->rays);
#else
    const fv zero = (fv)(0.0f);
    for (int axis = 0; axis < 2; ++axis) {
        const fv focal = (fv)(camera[CAMERA_FX + axis]);
        __global const float *limits = camera + CAMERA_SLOPE_LIMITS + 2 * axis;
#if PARALLEL_RAYS
        (void)limits;
        p->slope[axis] = s->point[axis];
        p->clamped[axis] = zero;
        p->focal_on_z[axis] = focal;
#else
        p->slope[axis] = s->point[axis] / p->z;
        p->clamped[axis] = clamp_lanes(p->slope[axis], (fv)(limits[0]), (fv)(limits[1]));
        p->focal_on_z[axis] = focal / p->z;
#endif
        s->rays[axis][0] = axis == 0 ? p->focal_on_z[0] : zero;
        s->rays[axis][1] = axis == 1 ? p->focal_on_z[1] : zero;
        s->rays[axis][2] = -p->focal_on_z[axis] * p->clamped[axis];
    }
#endif
}

/* The covariance from a, b and the shape in camera space; its determinant is a sum of positive
 * terms, by the minors of the 2x3 factor. */
static inline OWN_FUNCTION void see_shape(Sight *s, __global const float *camera, const float blur)
{
    Projection *p = &s->p;
    for (int k = 0; k < 3; ++k) {
        for (int row = 0; row < 3; ++row) {
            __global const float *w = camera + CAMERA_ROTATION + 3 * row;
            s->seen[k][row] = w[0] * s->root[k][0] + w[1] * s->root[k][1] + w[2] * s->root[k][2];
        }
        p->a[k] = dot3(s->rays[0], s->seen[k]);
        p->b[k] = dot3(s->rays[1], s->seen[k]);
    }
    choose_unit(p);
    fv normal[3], scaled[3][3], across[3];
    cross3(s->rays[0], s->rays[1], normal);
    for (int k = 0; k < 3; ++k) {
        p->a[k] *= p->on_unit;
        p->b[k] *= p->on_unit;
        for (int i = 0; i < 3; ++i)
            scaled[k][i] = s->seen[k][i] * p->on_unit;
    }
    for (int k = 0; k < 3; ++k) {
        cross3(scaled[(k + 1) % 3], scaled[(k + 2) % 3], across);
        p->minor[k] = dot3(normal, across);
    }
    p->blur = blur * p->on_unit * p->on_unit;
    const fv xx = dot3(p->a, p->a), yy = dot3(p->b, p->b), sharp = dot3(p->minor, p->minor);
    p->cov_xx = xx + p->blur;
    p->cov_xy = dot3(p->a, p->b);
    p->cov_yy = yy + p->blur;
    p->det = fma(p->blur, xx + yy + p->blur, sharp);
    s->share = COMPENSATED ? kept_share(p, (fv)(blur), (fv)(0.0f)) : (fv)(1.0f);
}

static inline Sight see(__global const float *mean, __global const float *shape,
                        __global const float *rotation, __global const float *camera,
                        const float blur, const size_t first, const size_t used)
{
    Sight s;
    fv position[3];
    load_rows3(mean, first, used, position);
    s.doubt = 0.0f * position[0] + 0.0f * position[1] + 0.0f * position[2];
    load_shape(&s, shape, rotation, first, used);
    see_point(&s, position, camera);
    see_shape(&s, camera, blur);
    return s;
}

#endif
