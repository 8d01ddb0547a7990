/* Gaussians on the screen, by lanes: whitened factors and boxes of visible alpha. */
#ifndef CLGS_PROJECTION_H
#define CLGS_PROJECTION_H

#include "common/camera.h"
#include "common/lanes.h"
#include "common/real.h"
#include "common/rows.h"

#ifndef BLUR
#define BLUR 0.3f
#endif
#ifndef ALPHA_CUT
#define ALPHA_CUT 0.00392156886f
#endif

/* Gaussians with smaller boxes are left out, pixels. */
#ifndef MIN_EXTENT
#define MIN_EXTENT 0.0f
#endif

#define FINITE_LIMIT 1e30f

/* VEC Gaussians, one a lane. The factor and what follows from it are divided by powers of `unit`,
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
    fv blur; /* BLUR by unit^2 */
} Splat;

static inline fv dot3(const fv p[3], const fv q[3])
{
    return fma(p[2], q[2], fma(p[1], q[1], p[0] * q[0]));
}

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

static inline void place(Splat *s, const fv mean[3], __global const float *camera)
{
    fv point[3];
    for (int row = 0; row < 3; ++row) {
        __global const float *w = camera + CAMERA_ROTATION + 3 * row;
        const fv turned = fma((fv)(w[2]), mean[2], fma((fv)(w[1]), mean[1], w[0] * mean[0]));
        point[row] = turned + camera[CAMERA_TRANSLATION + row];
    }
    s->z = point[2];
    for (int axis = 0; axis < 2; ++axis) {
        __global const float *limits = camera + CAMERA_SLOPE_LIMITS + 2 * axis;
        const fv slope = point[axis] / s->z;
        const fv raised = slope < (fv)(limits[0]) ? (fv)(limits[0]) : slope;
        s->slope[axis] = slope;
        s->clamped[axis] = raised > (fv)(limits[1]) ? (fv)(limits[1]) : raised;
        s->focal_on_z[axis] = (fv)(camera[CAMERA_FX + axis]) / s->z;
    }
}

static inline void orient(Splat *s, const fv quaternion[4], __global const float *camera)
{
    fv matrix[3][3];
    quaternion_matrix(quaternion, matrix);
    for (int row = 0; row < 3; ++row) {
        __global const float *w = camera + CAMERA_ROTATION + 3 * row;
        for (int k = 0; k < 3; ++k)
            s->axes[row][k] = w[0] * matrix[0][k] + w[1] * matrix[1][k] + w[2] * matrix[2][k];
    }
}

/* The largest power of two up to the largest entry of a and b, at least 1; and its reciprocal. */
static inline void measure(Splat *s)
{
    fv largest = (fv)(1.0f);
    for (int k = 0; k < 3; ++k) {
        const fv a = fabs(s->a[k]), b = fabs(s->b[k]);
        largest = a > largest ? a : largest;
        largest = b > largest ? b : largest;
    }
    const iv exponent = AS_IV(largest) & (iv)(0x7f800000);
    s->unit = AS_FV(exponent);
    s->on_unit = AS_FV((iv)(0x7f000000) - exponent);
}

/* The 2x3 factor, the covariance and its determinant. */
static inline void spread(Splat *s)
{
    fv stretch_x[3], stretch_y[3], ray[3]; /* ray: (u, v, 1) in the splat's axes */
    for (int k = 0; k < 3; ++k) {
        const fv x = s->axes[0][k], y = s->axes[1][k], z = s->axes[2][k];
        stretch_x[k] = s->focal_on_z[0] * s->scale[k];
        stretch_y[k] = s->focal_on_z[1] * s->scale[k];
        s->a[k] = stretch_x[k] * (x - s->clamped[0] * z);
        s->b[k] = stretch_y[k] * (y - s->clamped[1] * z);
        ray[k] = s->clamped[0] * x + s->clamped[1] * y + z;
    }
    measure(s);
    for (int k = 0; k < 3; ++k) {
        s->a[k] *= s->on_unit;
        s->b[k] *= s->on_unit;
        stretch_x[k] *= s->on_unit;
        stretch_y[k] *= s->on_unit;
    }
    for (int k = 0; k < 3; ++k)
        s->minor[k] = stretch_x[(k + 1) % 3] * stretch_y[(k + 2) % 3] * ray[k];
    s->blur = BLUR * s->on_unit * s->on_unit;
    const fv xx = dot3(s->a, s->a), yy = dot3(s->b, s->b);
    s->cov_xx = xx + s->blur;
    s->cov_xy = dot3(s->a, s->b);
    s->cov_yy = yy + s->blur;
    s->det = fma(s->blur, xx + yy + s->blur, dot3(s->minor, s->minor));
}

/* Of Gaussians given by lanes. */
static inline Splat make_splat(const fv mean[3], const fv scale[3], const fv quaternion[4],
                               __global const float *camera)
{
    Splat s;
    for (int i = 0; i < 3; ++i)
        s.scale[i] = scale[i];
    place(&s, mean, camera);
    orient(&s, quaternion, camera);
    spread(&s);
    return s;
}

/* r1, l, r2 */
static inline void whiten(const Splat *s, fv factor[3])
{
    factor[0] = 1.0f / sqrt(s->cov_xx) * s->on_unit;
    factor[1] = s->cov_xy / s->cov_xx;
    factor[2] = sqrt(s->cov_xx / s->det) * s->on_unit;
}

/* Half-widths of the box outside of which alpha < ALPHA_CUT, pixels. */
static inline void half_widths(const Splat *s, const fv opacity, fv extent[2])
{
    const fv reach = sqrt(2.0f * log_v(opacity / ALPHA_CUT)) * s->unit;
    extent[0] = reach * sqrt(s->cov_xx);
    extent[1] = reach * sqrt(s->cov_yy);
}

/* Of the box around `centre`, which has to be finite. */
static inline iv overlaps_image(const fv centre[2], const fv extent[2],
                                __global const float *camera)
{
    iv overlaps = (fabs(centre[0]) < (fv)(FINITE_LIMIT)) & (fabs(centre[1]) < (fv)(FINITE_LIMIT));
    for (int axis = 0; axis < 2; ++axis)
        overlaps = overlaps & (centre[axis] + extent[axis] > (fv)(0.0f)) &
                   (centre[axis] - extent[axis] < (fv)(camera[CAMERA_WIDTH + axis]));
    return overlaps;
}

/* Close enough to a unit quaternion to be one; NaN is not. */
static inline iv is_rotation(const fv q[4])
{
    const fv square = fma(q[0], q[0], fma(q[3], q[3], fma(q[2], q[2], q[1] * q[1])));
    return (square > (fv)(0.99f)) & (square < (fv)(1.01f));
}

static inline iv is_whitening(const fv factor[3])
{
    const fv limit = (fv)(FINITE_LIMIT);
    return (factor[0] > (fv)(0.0f)) & (factor[0] < limit) & (fabs(factor[1]) < limit) &
           (factor[2] > (fv)(0.0f)) & (factor[2] < limit);
}

/* `count` rows of zeros where the mask is not set. */
static inline void blank(const iv keep, const int count, fv *columns)
{
    for (int k = 0; k < count; ++k)
        columns[k] = keep ? columns[k] : (fv)(0.0f);
}

/* VEC Gaussians on the screen; a culled one has extent 0 and zeros elsewhere. */
typedef struct {
    fv centre[2];
    fv factor[3];
    fv depth;
    fv extent[2];
} Projection;

static inline Projection project_splat(const Splat *s, const fv quaternion[4], const fv opaque,
                                       __global const float *camera)
{
    Projection p;
    p.depth = s->z;
    for (int axis = 0; axis < 2; ++axis)
        p.centre[axis] = s->slope[axis] * camera[CAMERA_FX + axis] + camera[CAMERA_CX + axis];
    whiten(s, p.factor);
    half_widths(s, opaque, p.extent);
    const iv drawn = (s->z > (fv)(camera[CAMERA_NEAR])) & (s->z < (fv)(FINITE_LIMIT)) &
                     (opaque >= (fv)(ALPHA_CUT)) & (opaque < (fv)(FINITE_LIMIT)) &
                     is_rotation(quaternion) & is_whitening(p.factor) &
                     ((p.extent[0] >= (fv)(MIN_EXTENT)) | (p.extent[1] >= (fv)(MIN_EXTENT))) &
                     overlaps_image(p.centre, p.extent, camera);
    blank(drawn, 2, p.centre);
    blank(drawn, 3, p.factor);
    blank(drawn, 1, &p.depth);
    blank(drawn, 2, p.extent);
    return p;
}

/* Where projections go to. */
typedef struct {
    __global float *mean2d;
    __global float *whitening;
    __global float *depth;
    __global float *extent;
} Screen;

static inline void store_projection(const Projection *p, const Screen *out, const size_t first,
                                    const size_t used)
{
    store_rows2(p->centre, out->mean2d, first, used);
    store_rows3(p->factor, out->whitening, first, used);
    store_rows1(&p->depth, out->depth, first, used);
    store_rows2(p->extent, out->extent, first, used);
}

#endif
