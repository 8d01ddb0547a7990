/* Project 3-D Gaussians to the screen: EWA splatting in whitened form, forward and backward.
 *
 * Work-item: VEC Gaussians, one per lane, counted from the middle on.
 * Work-group: any; no local memory.
 * Launch: a work-item per VEC Gaussians.
 *
 * The blurred 2-D covariance is never inverted. Its Cholesky factor is carried instead:
 *     y1 = dx * r1,  y2 = (dy - l * dx) * r2,  power = (y1^2 + y2^2) / 2
 * and the determinant is a sum of positive terms (Cauchy-Binet): both stay accurate for needles
 * that are 1e5 times longer than wide, for which the conic form loses all digits.
 */
#include "common/camera.h"
#include "common/items.h"
#include "common/lane_math.h"
#include "common/method.h"
#include "common/real.h"
#include "common/rows.h"
#include "gaussian/factor_gradient.h"
#include "gaussian/projected_gaussians.h"
#include "gaussian/projection.h"
#include "gaussian/screen.h"

/* A culled Gaussian gets extent 0 and zeros elsewhere; shown: the opacities on the screen. */
__kernel void project_forward(__global const float *mean, __global const float *scale,
                              __global const float *rotation, __global const float *opacity,
                              __global const float *camera, const int count, const float8 screen,
                              __global float *mean2d, __global float *whitening,
                              __global float *depth, __global float *extent, __global float *shown)
{
    const size_t first = item_from_middle() * VEC;
    if (first >= (size_t)count)
        return;
    const size_t used = min((size_t)VEC, (size_t)count - first);
    fv position[3], size[3], quaternion[4], opaque;
    load_rows3(mean, first, used, position);
    load_rows3(scale, first, used, size);
    load_rows4(rotation, first, used, quaternion);
    load_rows1(opacity, first, used, &opaque);
    const Blurs blurs = blurs_of(screen, position, camera);
    const Projection p = make_projection(position, size, quaternion, camera, blurs.blur);
    opaque *= kept_share(&p, blurs.blur, blurs.learned);
    const ProjectedGaussians projected = project_gaussians(&p, quaternion, opaque, camera);
    const ProjectedArrays out = {mean2d, whitening, depth, extent};
    store_projected(&projected, &out, first, used);
    store_rows1(&opaque, shown, first, used);
}

/* dL/d(quaternion) from the factor. */
static inline void rotation_gradient(const Projection *p, const fv quaternion[4], const fv d_a[3],
                                     const fv d_b[3], __global const float *camera,
                                     fv d_quaternion[4])
{
    fv d_matrix[3][3];
    for (int k = 0; k < 3; ++k) {
        const fv along_a = p->focal_on_z[0] * p->scale[k] * d_a[k];
        const fv along_b = p->focal_on_z[1] * p->scale[k] * d_b[k];
        const fv along[3] = {along_a, along_b, -p->clamped[0] * along_a - p->clamped[1] * along_b};
        for (int row = 0; row < 3; ++row)
            d_matrix[row][k] = along_camera(camera, row, along);
    }
    quaternion_gradient(quaternion, d_matrix, d_quaternion);
}

/* dL/d(mean) from the screen position and from the factor (a, b). */
static inline void mean_gradient(const Projection *p, const fv d_mean2d[2], const fv d_a[3],
                                 const fv d_b[3], const fv d_log_size, __global const float *camera,
                                 fv d_mean[3])
{
    fv deep[3], d_point[3];
    for (int k = 0; k < 3; ++k)
        deep[k] = p->scale[k] * p->axes[2][k];
    const fv d_clamped[2] = {-p->focal_on_z[0] * dot3(deep, d_a),
                             -p->focal_on_z[1] * dot3(deep, d_b)};
    fv d_slope[2];
    for (int axis = 0; axis < 2; ++axis) {
        const fv free = p->clamped[axis] == p->slope[axis] ? d_clamped[axis] : (fv)(0.0f);
        d_slope[axis] = fma(d_mean2d[axis], (fv)(camera[CAMERA_FX + axis]), free);
        d_point[axis] = d_slope[axis] / p->z;
    }
    d_point[2] = -(d_log_size + fma(p->slope[0], d_slope[0], p->slope[1] * d_slope[1])) / p->z;
    for (int column = 0; column < 3; ++column)
        d_mean[column] = along_camera(camera, column, d_point);
}

/* Gradients of the Gaussians from those of their projections on the screen of training, or that of
 * antialiased ones; zero for culled ones, but for the opacity if they are not antialiased. */
__kernel void project_backward(__global const float *mean, __global const float *scale,
                               __global const float *rotation, __global const float *camera,
                               const int count, const int antialiased,
                               __global const float *opacity, __global const float *whitening,
                               __global const float *extent, __global const float *d_mean2d,
                               __global const float *d_whitening, __global const float *d_shown,
                               __global float *d_mean, __global float *d_scale,
                               __global float *d_rotation, __global float *d_opacity)
{
    const size_t item = item_from_middle() * VEC;
    if (item >= (size_t)count)
        return;
    const size_t used = min((size_t)VEC, (size_t)count - item);
    fv box[2], quaternion[4], factor[3], d_factor[3], d_centre[2], d_a[3], d_b[3];
    fv position[3], size[3], d_position[3], d_size[3], d_quaternion[4];
    load_rows3(mean, item, used, position);
    load_rows3(scale, item, used, size);
    load_rows2(extent, item, used, box);
    load_rows4(rotation, item, used, quaternion);
    load_rows3(whitening, item, used, factor);
    load_rows3(d_whitening, item, used, d_factor);
    load_rows2(d_mean2d, item, used, d_centre);
    const Projection p = make_projection(position, size, quaternion, camera, (fv)(BLUR));
    factor_gradient(&p, factor, d_factor, d_a, d_b, d_size);
    const iv drawn = box[0] > (fv)(0.0f);
    fv d_opaque;
    load_rows1(d_shown, item, used, &d_opaque);
    if (antialiased) {
        fv opaque;
        load_rows1(opacity, item, used, &opaque);
        d_opaque *= kept_share(&p, (fv)(BLUR), (fv)(0.0f));
        share_gradient(&p, d_opaque * opaque, d_a, d_b, d_size);
        blank(drawn, 1, &d_opaque);
    }
    store_rows1(&d_opaque, d_opacity, item, used);
    rotation_gradient(&p, quaternion, d_a, d_b, camera, d_quaternion);
    mean_gradient(&p, d_centre, d_a, d_b, d_size[0] + d_size[1] + d_size[2], camera, d_position);
    for (int k = 0; k < 3; ++k)
        d_size[k] = p.scale[k] == (fv)(0.0f) ? (fv)(0.0f) : d_size[k] / p.scale[k];
    blank(drawn, 3, d_position);
    blank(drawn, 3, d_size);
    blank(drawn, 4, d_quaternion);
    store_rows3(d_position, d_mean, item, used);
    store_rows3(d_size, d_scale, item, used);
    store_rows4(d_quaternion, d_rotation, item, used);
}
