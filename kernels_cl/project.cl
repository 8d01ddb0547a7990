/* Project 3-D Gaussians to the screen: EWA splatting in whitened form.
 *
 * The blurred 2-D covariance is never inverted. Its Cholesky factor is carried instead:
 *     y1 = dx * r1,  y2 = (dy - l * dx) * r2,  power = (y1^2 + y2^2) / 2
 * and the determinant is a sum of positive terms (Cauchy-Binet): both stay accurate for needles
 * that are 1e5 times longer than wide, where the conic form loses all digits.
 */
#include "include/camera.h"
#include "include/lanes.h"
#include "include/real.h"
#include "include/rows.h"

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

inline fv dot3(const fv p[3], const fv q[3])
{
    return fma(p[2], q[2], fma(p[1], q[1], p[0] * q[0]));
}

/* Column `column` of the camera's rotation along p: sum of p[row] times its rows. */
inline fv along_camera(__global const float *camera, const int column, const fv p[3])
{
    __global const float *entry = camera + CAMERA_ROTATION + column;
    return p[0] * entry[0] + p[1] * entry[3] + p[2] * entry[6];
}

/* The rotation matrix of unit quaternions q = (w, x, y, z). */
inline void quaternion_matrix(const fv q[4], fv matrix[3][3])
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

inline void place(Splat *s, const fv mean[3], __global const float *camera)
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

inline void orient(Splat *s, const fv quaternion[4], __global const float *camera)
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
inline void measure(Splat *s)
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
inline void spread(Splat *s)
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

inline Splat make_splat(__global const float *mean, __global const float *scale,
                        const fv quaternion[4], __global const float *camera, const size_t first,
                        const size_t used)
{
    Splat s;
    fv position[3];
    load_rows3(scale, first, used, s.scale);
    load_rows3(mean, first, used, position);
    place(&s, position, camera);
    orient(&s, quaternion, camera);
    spread(&s);
    return s;
}

/* r1, l, r2 */
inline void whiten(const Splat *s, fv factor[3])
{
    factor[0] = 1.0f / sqrt(s->cov_xx) * s->on_unit;
    factor[1] = s->cov_xy / s->cov_xx;
    factor[2] = sqrt(s->cov_xx / s->det) * s->on_unit;
}

/* Half-widths of the box outside of which alpha < ALPHA_CUT, pixels. */
inline void half_widths(const Splat *s, const fv opacity, fv extent[2])
{
    const fv reach = sqrt(2.0f * log_v(opacity / ALPHA_CUT)) * s->unit;
    extent[0] = reach * sqrt(s->cov_xx);
    extent[1] = reach * sqrt(s->cov_yy);
}

/* Of the box around `centre`, which has to be finite. */
inline iv overlaps_image(const fv centre[2], const fv extent[2], __global const float *camera)
{
    iv overlaps = (fabs(centre[0]) < (fv)(FINITE_LIMIT)) & (fabs(centre[1]) < (fv)(FINITE_LIMIT));
    for (int axis = 0; axis < 2; ++axis)
        overlaps = overlaps & (centre[axis] + extent[axis] > (fv)(0.0f)) &
                   (centre[axis] - extent[axis] < (fv)(camera[CAMERA_WIDTH + axis]));
    return overlaps;
}

/* Close enough to a unit quaternion to be one; NaN is not. */
inline iv is_rotation(const fv q[4])
{
    const fv square = fma(q[0], q[0], fma(q[3], q[3], fma(q[2], q[2], q[1] * q[1])));
    return (square > (fv)(0.99f)) & (square < (fv)(1.01f));
}

inline iv is_whitening(const fv factor[3])
{
    const fv limit = (fv)(FINITE_LIMIT);
    return (factor[0] > (fv)(0.0f)) & (factor[0] < limit) & (fabs(factor[1]) < limit) &
           (factor[2] > (fv)(0.0f)) & (factor[2] < limit);
}

/* `count` rows of zeros where the mask is not set. */
inline void blank(const iv keep, const int count, fv *columns)
{
    for (int k = 0; k < count; ++k)
        columns[k] = keep ? columns[k] : (fv)(0.0f);
}

/* One work-item VEC Gaussians. A culled one gets extent 0 and zeros elsewhere. */
__kernel void project_forward(__global const float *mean, __global const float *scale,
                              __global const float *rotation, __global const float *opacity,
                              __global const float *camera, const int count, __global float *mean2d,
                              __global float *whitening, __global float *depth,
                              __global float *extent)
{
    const size_t first = get_global_id(0) * VEC;
    if (first >= (size_t)count)
        return;
    const size_t used = min((size_t)VEC, (size_t)count - first);
    fv quaternion[4], opaque, centre[2], factor[3], box[2];
    load_rows4(rotation, first, used, quaternion);
    load_rows1(opacity, first, used, &opaque);
    Splat s = make_splat(mean, scale, quaternion, camera, first, used);
    for (int axis = 0; axis < 2; ++axis)
        centre[axis] = s.slope[axis] * camera[CAMERA_FX + axis] + camera[CAMERA_CX + axis];
    whiten(&s, factor);
    half_widths(&s, opaque, box);
    const iv drawn = (s.z > (fv)(camera[CAMERA_NEAR])) & (s.z < (fv)(FINITE_LIMIT)) &
                     (opaque >= (fv)(ALPHA_CUT)) & (opaque < (fv)(FINITE_LIMIT)) &
                     is_rotation(quaternion) & is_whitening(factor) &
                     ((box[0] >= (fv)(MIN_EXTENT)) | (box[1] >= (fv)(MIN_EXTENT))) &
                     overlaps_image(centre, box, camera);
    blank(drawn, 2, centre);
    blank(drawn, 3, factor);
    blank(drawn, 1, &s.z);
    blank(drawn, 2, box);
    store_rows2(centre, mean2d, first, used);
    store_rows3(factor, whitening, first, used);
    store_rows1(&s.z, depth, first, used);
    store_rows2(box, extent, first, used);
}

/* Columns of the whitened factor: (r1 a_k, r2 (b_k - l a_k)). The difference is a sum of minors,
 * which keeps its digits where the two terms almost cancel. */
inline void whitened_columns(const Splat *s, const fv factor[3], fv first[3], fv second[3])
{
    const fv r1 = factor[0] * s->unit, r2 = factor[2] * s->unit / s->cov_xx;
    for (int k = 0; k < 3; ++k) {
        const int next = (k + 1) % 3, last = (k + 2) % 3;
        const fv sum = fma(s->a[last], s->minor[next], -s->a[next] * s->minor[last]);
        first[k] = r1 * s->a[k];
        second[k] = r2 * (sum + s->blur * s->b[k]);
    }
}

/* dL/dq for q = (w, x, y, z), from dL/dR given by rows. */
inline void quaternion_gradient(const fv q[4], const fv d[3][3], fv d_q[4])
{
    const fv turn_x = d[2][1] - d[1][2], turn_y = d[0][2] - d[2][0], turn_z = d[1][0] - d[0][1];
    const fv xy = d[0][1] + d[1][0], xz = d[0][2] + d[2][0], yz = d[1][2] + d[2][1];
    d_q[0] = 2.0f * (q[1] * turn_x + q[2] * turn_y + q[3] * turn_z);
    d_q[1] = 2.0f * (q[2] * xy + q[3] * xz + q[0] * turn_x - 2.0f * q[1] * (d[1][1] + d[2][2]));
    d_q[2] = 2.0f * (q[1] * xy + q[3] * yz + q[0] * turn_y - 2.0f * q[2] * (d[0][0] + d[2][2]));
    d_q[3] = 2.0f * (q[1] * xz + q[2] * yz + q[0] * turn_z - 2.0f * q[3] * (d[0][0] + d[1][1]));
}

/* dL/d(factor) by rows, and dL/d(log scale). */
inline void factor_gradient(const Splat *s, const fv factor[3], const fv d_factor[3], fv d_a[3],
                            fv d_b[3], fv d_log_scale[3])
{
    /* sums of alpha dL/d(alpha) y y^T over the pixels */
    const fv m11 = -d_factor[0] * factor[0];
    const fv m12 = d_factor[1] * factor[0] / factor[2];
    const fv m22 = -d_factor[2] * factor[2];
    const fv back = factor[1] * factor[2];
    fv first[3], second[3];
    whitened_columns(s, factor, first, second);
    for (int k = 0; k < 3; ++k) {
        const fv d_first = m11 * first[k] + m12 * second[k];
        const fv d_second = m12 * first[k] + m22 * second[k];
        d_a[k] = factor[0] * d_first - back * d_second;
        d_b[k] = factor[2] * d_second;
        d_log_scale[k] = first[k] * d_first + second[k] * d_second;
    }
}

/* dL/d(quaternion) from the factor. */
inline void rotation_gradient(const Splat *s, const fv quaternion[4], const fv d_a[3],
                              const fv d_b[3], __global const float *camera, fv d_quaternion[4])
{
    fv d_matrix[3][3];
    for (int k = 0; k < 3; ++k) {
        const fv along_a = s->focal_on_z[0] * s->scale[k] * d_a[k];
        const fv along_b = s->focal_on_z[1] * s->scale[k] * d_b[k];
        const fv along[3] = {along_a, along_b, -s->clamped[0] * along_a - s->clamped[1] * along_b};
        for (int row = 0; row < 3; ++row)
            d_matrix[row][k] = along_camera(camera, row, along);
    }
    quaternion_gradient(quaternion, d_matrix, d_quaternion);
}

/* dL/d(mean) from the screen position and from the factor (a, b). */
inline void mean_gradient(const Splat *s, const fv d_mean2d[2], const fv d_a[3], const fv d_b[3],
                          const fv d_log_size, __global const float *camera, fv d_mean[3])
{
    fv deep[3], d_point[3];
    for (int k = 0; k < 3; ++k)
        deep[k] = s->scale[k] * s->axes[2][k];
    const fv d_clamped[2] = {-s->focal_on_z[0] * dot3(deep, d_a),
                             -s->focal_on_z[1] * dot3(deep, d_b)};
    fv d_slope[2];
    for (int axis = 0; axis < 2; ++axis) {
        const fv free = s->clamped[axis] == s->slope[axis] ? d_clamped[axis] : (fv)(0.0f);
        d_slope[axis] = fma(d_mean2d[axis], (fv)(camera[CAMERA_FX + axis]), free);
        d_point[axis] = d_slope[axis] / s->z;
    }
    d_point[2] = -(d_log_size + fma(s->slope[0], d_slope[0], s->slope[1] * d_slope[1])) / s->z;
    for (int column = 0; column < 3; ++column)
        d_mean[column] = along_camera(camera, column, d_point);
}

/* One work-item VEC Gaussians; the mirror of project_forward. */
__kernel void project_backward(__global const float *mean, __global const float *scale,
                               __global const float *rotation, __global const float *camera,
                               const int count, __global const float *whitening,
                               __global const float *extent, __global const float *d_mean2d,
                               __global const float *d_whitening, __global float *d_mean,
                               __global float *d_scale, __global float *d_rotation)
{
    const size_t item = get_global_id(0) * VEC;
    if (item >= (size_t)count)
        return;
    const size_t used = min((size_t)VEC, (size_t)count - item);
    fv box[2], quaternion[4], factor[3], d_factor[3], d_centre[2], d_a[3], d_b[3];
    fv d_position[3], d_size[3], d_quaternion[4];
    load_rows2(extent, item, used, box);
    load_rows4(rotation, item, used, quaternion);
    load_rows3(whitening, item, used, factor);
    load_rows3(d_whitening, item, used, d_factor);
    load_rows2(d_mean2d, item, used, d_centre);
    const Splat s = make_splat(mean, scale, quaternion, camera, item, used);
    factor_gradient(&s, factor, d_factor, d_a, d_b, d_size);
    rotation_gradient(&s, quaternion, d_a, d_b, camera, d_quaternion);
    mean_gradient(&s, d_centre, d_a, d_b, d_size[0] + d_size[1] + d_size[2], camera, d_position);
    const iv drawn = box[0] > (fv)(0.0f);
    for (int k = 0; k < 3; ++k)
        d_size[k] = s.scale[k] == (fv)(0.0f) ? (fv)(0.0f) : d_size[k] / s.scale[k];
    blank(drawn, 3, d_position);
    blank(drawn, 3, d_size);
    blank(drawn, 4, d_quaternion);
    store_rows3(d_position, d_mean, item, used);
    store_rows3(d_size, d_scale, item, used);
    store_rows4(d_quaternion, d_rotation, item, used);
}
