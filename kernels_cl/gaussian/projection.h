/* The projection of VEC Gaussians to the screen, up to the blurred covariance. */
#ifndef CLGS_PROJECTION_H
#define CLGS_PROJECTION_H

#include "common/camera.h"
#include "common/camera_space.h"
#include "common/lane_math.h"
#include "common/own_function.h"
#include "common/real.h"

/* VEC Gaussians, one per lane. The factor and what follows from it are divided by powers of `unit`,
 * a power of two: that keeps squares finite and costs no digit. */
typedef struct {
    fv z;             /* depth in camera space */
    fv slope[2];      /* x/z, y/z */
    fv clamped[2];    /* the same, inside the slope limits of the camera */
    fv focal_on_z[2]; /* fx/z, fy/z */
    fv scale[3];
    fv axes[3][3]; /* (camera rotation)(Gaussian rotation), by rows */
    fv a[3];       /* rows of the 2x3 factor J W R S, by unit */
    fv b[3];
    fv minor[3]; /* its 2x2 minors (columns yz, zx, xy), by unit^2 */
    fv unit;     /* about the largest entry of the factor, at least 1 */
    fv on_unit;  /* 1 / unit */
    fv cov_xx;   /* blurred covariance, by unit^2 */
    fv cov_xy;
    fv cov_yy;
    fv det;  /* by unit^4 */
    fv blur; /* by unit^2 */
} Projection;

/* Column `column` of the camera's rotation along p: sum of p[row] times its rows. */
static inline fv along_camera(__global const float *camera, const int column, const fv p[3])
{
    __global const float *entry = camera + CAMERA_ROTATION + column;
    return p[0] * entry[0] + p[1] * entry[3] + p[2] * entry[6];
}

/* The rotation matrix of unit quaternions q = (w, x, y, z). */
static inline void quaternion_matrix(const fv q[4], fv matrix[3][3])
{
    matrix[0][0] = 1.0f - 2.0f * fma(q[2], q[2], q[3] * q[3]);
    matrix[0][1] = 2.0f * fma(q[1], q[2], -q[0] * q[3]);
    matrix[0][2] = 2.0f * fma(q[1], q[3], q[0] * q[2]);
    matrix[1][0] = 2.0f * fma(q[1], q[2], q[0] * q[3]);
    matrix[1][1] = 1.0f - 2.0f * fma(q[1], q[1], q[3] * q[3]);
    matrix[1][2] = 2.0f * fma(q[2], q[3], -q[0] * q[1]);
    matrix[2][0] = 2.0f * fma(q[1], q[3], -q[0] * q[2]);
    matrix[2][1] = 2.0f * fma(q[2], q[3], q[0] * q[1]);
    matrix[2][2] = 1.0f - 2.0f * fma(q[1], q[1], q[2] * q[2]);
}

/* Depth, slopes and their clamp. */
static inline void project_mean(Projection *p, const fv mean[3], __global const float *camera)
{
    fv point[3];
    for (int row = 0; row < 3; ++row)
        point[row] = camera_coordinate(camera, row, mean);
    p->z = point[2];
    for (int axis = 0; axis < 2; ++axis) {
        __global const float *limits = camera + CAMERA_SLOPE_LIMITS + 2 * axis;
        const fv slope = point[axis] / p->z;
        p->slope[axis] = slope;
        p->clamped[axis] = clamp_lanes(slope, (fv)(limits[0]), (fv)(limits[1]));
        p->focal_on_z[axis] = (fv)(camera[CAMERA_FX + axis]) / p->z;
    }
}

/* Axes of the Gaussian as the camera sees them. */
static inline void turn_axes(Projection *p, const fv quaternion[4], __global const float *camera)
{
    fv matrix[3][3];
    quaternion_matrix(quaternion, matrix);
    for (int row = 0; row < 3; ++row) {
        __global const float *w = camera + CAMERA_ROTATION + 3 * row;
        for (int k = 0; k < 3; ++k)
            p->axes[row][k] = w[0] * matrix[0][k] + w[1] * matrix[1][k] + w[2] * matrix[2][k];
    }
}

/* The largest power of two up to the largest entry of a and b, at least 1; and its reciprocal. */
static inline void choose_unit(Projection *p)
{
    fv largest = (fv)(1.0f);
    for (int k = 0; k < 3; ++k) {
        const fv a = fabs(p->a[k]), b = fabs(p->b[k]);
        largest = a > largest ? a : largest;
        largest = b > largest ? b : largest;
    }
    const iv exponent = AS_IV(largest) & (iv)(0x7f800000);
    p->unit = AS_FV(exponent);
    p->on_unit = AS_FV((iv)(0x7f000000) - exponent);
}

/* The 2x3 factor, the covariance and its determinant. */
static inline void project_covariance(Projection *p, const fv blur)
{
    fv stretch_x[3], stretch_y[3], ray[3]; /* ray: (u, v, 1) in the Gaussian's axes */
    for (int k = 0; k < 3; ++k) {
        const fv x = p->axes[0][k], y = p->axes[1][k], z = p->axes[2][k];
        stretch_x[k] = p->focal_on_z[0] * p->scale[k];
        stretch_y[k] = p->focal_on_z[1] * p->scale[k];
        p->a[k] = stretch_x[k] * (x - p->clamped[0] * z);
        p->b[k] = stretch_y[k] * (y - p->clamped[1] * z);
        ray[k] = p->clamped[0] * x + p->clamped[1] * y + z;
    }
    choose_unit(p);
    for (int k = 0; k < 3; ++k) {
        p->a[k] *= p->on_unit;
        p->b[k] *= p->on_unit;
        stretch_x[k] *= p->on_unit;
        stretch_y[k] *= p->on_unit;
    }
    for (int k = 0; k < 3; ++k)
        p->minor[k] = stretch_x[(k + 1) % 3] * stretch_y[(k + 2) % 3] * ray[k];
    p->blur = blur * p->on_unit * p->on_unit;
    const fv xx = dot3(p->a, p->a), yy = dot3(p->b, p->b);
    p->cov_xx = xx + p->blur;
    p->cov_xy = dot3(p->a, p->b);
    p->cov_yy = yy + p->blur;
    p->det = fma(p->blur, xx + yy + p->blur, dot3(p->minor, p->minor));
}

static inline void cross3(const fv a[3], const fv b[3], fv result[3])
{
    for (int k = 0; k < 3; ++k)
        result[k] = a[(k + 1) % 3] * b[(k + 2) % 3] - a[(k + 2) % 3] * b[(k + 1) % 3];
}

/* Share of its opacity with which a Gaussian, blurred by `blur`, gives as much light as by
 * `learned`, square pixels. Determinants are sums of positive terms: they keep their digits for
 * needles. */
static inline fv kept_share(const Projection *p, const fv blur, const fv learned)
{
    const fv other = learned * p->on_unit * p->on_unit;
    const fv sizes = dot3(p->a, p->a) + dot3(p->b, p->b);
    const fv share = sqrt(fma(other, sizes + other, dot3(p->minor, p->minor)) / p->det);
    return blur == learned ? (fv)(1.0f) : share;
}

/* The projection of Gaussians given by lanes. blur: square pixels. */
static inline OWN_FUNCTION Projection make_projection(const fv mean[3], const fv scale[3],
                                                      const fv quaternion[4],
                                                      __global const float *camera, const fv blur)
{
    Projection p;
    for (int i = 0; i < 3; ++i)
        p.scale[i] = scale[i];
    project_mean(&p, mean, camera);
    turn_axes(&p, quaternion, camera);
    project_covariance(&p, blur);
    return p;
}

#endif
