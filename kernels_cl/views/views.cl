/* Project Gaussians for any camera, and the way back to Gaussians and camera: what project.cl does,
 * with shapes as quaternions and scales or as covariances, the rows of the camera's matrix as they
 * are (no rotation is needed), rays of a pinhole, parallel ones or those of a fisheye, and the blur
 * as an argument.
 *
 * Work-item: VEC Gaussians, one per lane, counted from the middle on.
 * Work-group: any; no local memory.
 * Launch: a work-item per VEC Gaussians.
 */
#include "common/camera.h"
#include "common/items.h"
#include "common/lane_math.h"
#include "common/real.h"
#include "common/rows.h"
#include "gaussian/factor_gradient.h"
#include "gaussian/projected_gaussians.h"
#include "gaussian/projection.h"
#include "gaussian/unit_quaternion.h"
#include "views/fisheye.h"
#include "views/sight.h"

/* As project_forward, with a far plane and a smallest radius, and the opacities that are left.
 * Radii are boxes rounded up to pixels; a Gaussian is culled if they miss the image. With a `reach`
 * above 0, boxes end that many standard deviations from the centre, at any opacity. A depth is NaN
 * if a number of its Gaussian cannot be used. */
__kernel void views_forward(__global const float *mean, __global const float *shape,
                            __global const float *rotation, __global const float *opacity,
                            __global const float *camera, const int count, const float blur,
                            const float far, const float smallest_radius, const float reach,
                            __global float *mean2d, __global float *whitening,
                            __global float *depth, __global float *extent,
                            __global float *compensated)
{
    const size_t first = item_from_middle() * VEC;
    if (first >= (size_t)count)
        return;
    const size_t used = min((size_t)VEC, (size_t)count - first);
    const Sight s = see(mean, shape, rotation, camera, blur, first, used);
    ProjectedGaussians g;
    fv opaque;
    load_rows1(opacity, first, used, &opaque);
    const iv usable = (opaque >= (fv)(0.0f)) & (opaque <= (fv)(UNIT_OPACITY));
    opaque *= s.share;
    g.depth = s.p.z;
    for (int axis = 0; axis < 2; ++axis)
        g.centre[axis] = s.p.slope[axis] * camera[CAMERA_FX + axis] + camera[CAMERA_CX + axis];
    whiten(&s.p, g.factor);
    iv shows = opaque >= (fv)(ALPHA_CUT);
    if (reach > 0.0f) {
        shows = opaque >= (fv)(0.0f);
        g.extent[0] = reach * s.p.unit * sqrt(s.p.cov_xx);
        g.extent[1] = reach * s.p.unit * sqrt(s.p.cov_yy);
    } else {
        half_widths(&s.p, opaque, g.extent);
    }
    const fv radii[2] = {ceil(g.extent[0]), ceil(g.extent[1])};
    const iv drawn = (g.depth >= (fv)(camera[CAMERA_NEAR])) & (g.depth <= (fv)(far)) & shows &
                     is_whitening(g.factor) &
                     ((radii[0] > (fv)(smallest_radius)) | (radii[1] > (fv)(smallest_radius))) &
                     overlaps_image(g.centre, radii, camera);
    blank(drawn, 2, g.centre);
    blank(drawn, 3, g.factor);
    blank(drawn, 1, &g.depth);
    g.depth += usable ? s.doubt : (fv)(NAN);
    blank(drawn, 2, g.extent);
    blank(drawn, 1, &opaque);
    const ProjectedArrays out = {mean2d, whitening, depth, extent};
    store_projected(&g, &out, first, used);
    store_rows1(&opaque, compensated, first, used);
}

#if BY_COVARIANCE
/* dL/d(covariance) in the world, both halves of it in the upper: moments of the whitened rows of
 * J W, and the share's part. */
static inline void covariance_gradient(const Sight *s, const fv factor[3], const fv d_factor[3],
                                       const fv d_share, __global const float *camera, fv d[6])
{
    const Projection *p = &s->p;
    const fv m11 = -0.5f * d_factor[0] * factor[0], m22 = -0.5f * d_factor[2] * factor[2];
    const fv m12 = 0.5f * d_factor[1] * factor[0] / factor[2];
    const fv sharp = dot3(p->minor, p->minor), unit = 0.5f * d_share * p->on_unit * p->on_unit;
    const fv on_sharp = sharp > (fv)(0.0f) ? 1.0f / sharp : (fv)(0.0f), on_det = 1.0f / p->det;
    const fv weight = sharp > (fv)(0.0f) ? on_sharp - on_det : (fv)(0.0f);
    const fv s_xx = unit * (weight * (p->cov_yy - p->blur) - p->blur * on_det);
    const fv s_yy = unit * (weight * (p->cov_xx - p->blur) - p->blur * on_det);
    const fv s_xy = -unit * weight * p->cov_xy;
    fv x[3], y[3], first[3], second[3];
    for (int k = 0; k < 3; ++k) {
        x[k] = along_camera(camera, k, s->rays[0]);
        y[k] = along_camera(camera, k, s->rays[1]);
        first[k] = factor[0] * x[k];
        second[k] = factor[2] * (y[k] - factor[1] * x[k]);
    }
    for (int row = 0, at = 0; row < 3; ++row)
        for (int k = row; k < 3; ++k, ++at) {
            const fv both = m11 * first[row] * first[k] + m22 * second[row] * second[k] +
                            m12 * (first[row] * second[k] + second[row] * first[k]) +
                            s_xx * x[row] * x[k] + s_yy * y[row] * y[k] +
                            s_xy * (x[row] * y[k] + y[row] * x[k]);
            d[at] = row == k ? both : 2.0f * both;
        }
}
#endif

/* dL/d(point in camera space). `d_size`: by the logarithm of the size on the screen. */
static inline void point_gradient(const Sight *s, const fv d_mean2d[2], const fv d_a[3],
                                  const fv d_b[3], const fv d_size, const fv d_depth,
                                  __global const float *camera, fv d_point[3])
{
    const Projection *p = &s->p;
#if PARALLEL_RAYS
    (void)p, (void)d_a, (void)d_b, (void)d_size;
    d_point[0] = d_mean2d[0] * camera[CAMERA_FX];
    d_point[1] = d_mean2d[1] * camera[CAMERA_FY];
    d_point[2] = d_depth;
#elif FISHEYE
    (void)p, (void)d_size;
    const Bend b = bend(s->point);
    fv d_rays[2][3];
    for (int i = 0; i < 3; ++i) {
        const fv seen[3] = {s->seen[0][i], s->seen[1][i], s->seen[2][i]};
        d_rays[0][i] = dot3(seen, d_a);
        d_rays[1][i] = dot3(seen, d_b);
    }
    bent_gradient(&b, s->rays, d_mean2d, d_rays, camera, d_point);
    d_point[2] += d_depth;
#else
    const fv deep[3] = {s->seen[0][2], s->seen[1][2], s->seen[2][2]};
    const fv d_clamped[2] = {-p->focal_on_z[0] * dot3(deep, d_a),
                             -p->focal_on_z[1] * dot3(deep, d_b)};
    fv d_slope[2];
    for (int axis = 0; axis < 2; ++axis) {
        const fv free = p->clamped[axis] == p->slope[axis] ? d_clamped[axis] : (fv)(0.0f);
        d_slope[axis] = fma(d_mean2d[axis], (fv)(camera[CAMERA_FX + axis]), free);
        d_point[axis] = d_slope[axis] / p->z;
    }
    const fv by_slopes = fma(p->slope[0], d_slope[0], p->slope[1] * d_slope[1]);
    d_point[2] = d_depth - (d_size + by_slopes) / p->z;
#endif
}

/* Gradients of the Gaussians and of the camera; zero for culled Gaussians. d_camera: (3, 4, count)
 * by the rows of the camera's matrix, for each Gaussian, if `want_camera` is not 0. */
__kernel void views_backward(__global const float *mean, __global const float *shape,
                             __global const float *rotation, __global const float *opacity,
                             __global const float *camera, const int count, const float blur,
                             __global const float *whitening, __global const float *extent,
                             __global const float *d_mean2d, __global const float *d_whitening,
                             __global const float *d_depth, __global const float *d_compensated,
                             const int want_camera, __global float *d_mean, __global float *d_shape,
                             __global float *d_rotation, __global float *d_opacity,
                             __global float *d_camera)
{
    const size_t item = item_from_middle() * VEC;
    if (item >= (size_t)count)
        return;
    const size_t used = min((size_t)VEC, (size_t)count - item);
    fv box[2], factor[3], d_factor[3], d_centre[2], d_a[3], d_b[3], d_size[3], d_deep, opaque;
    fv d_opaque, position[3], d_point[3], d_position[3];
    load_rows2(extent, item, used, box);
    load_rows3(whitening, item, used, factor);
    load_rows3(d_whitening, item, used, d_factor);
    load_rows2(d_mean2d, item, used, d_centre);
    load_rows1(d_depth, item, used, &d_deep);
    load_rows1(opacity, item, used, &opaque);
    load_rows1(d_compensated, item, used, &d_opaque);
    Sight s = see(mean, shape, rotation, camera, blur, item, used);
    iv shown = (d_deep != (fv)(0.0f)) | (d_opaque != (fv)(0.0f)); /* else no zero has a sign */
    for (int k = 0; k < 3; ++k)
        shown |= d_factor[k] != (fv)(0.0f);
    for (int k = 0; k < 2; ++k)
        shown |= d_centre[k] != (fv)(0.0f);
    const iv drawn = (box[0] > (fv)(0.0f)) & shown;
    factor_gradient(&s.p, factor, d_factor, d_a, d_b, d_size);
    const fv d_share = COMPENSATED ? d_opaque * opaque * s.share : (fv)(0.0f);
    if (COMPENSATED)
        share_gradient(&s.p, d_share, d_a, d_b, d_size);
    d_opaque *= s.share;
    blank(drawn, 1, &d_opaque);
    store_rows1(&d_opaque, d_opacity, item, used);

    /* What is read and computed again, here and below, does not stay in registers meanwhile: that
     * would leave Intel's compilers 8 work-items, or memory for a part. */
    load_rows3(mean, item, used, position);
    see_point(&s, position, camera);
    point_gradient(&s, d_centre, d_a, d_b, d_size[0] + d_size[1] + d_size[2], d_deep, camera,
                   d_point);
    for (int k = 0; k < 3; ++k)
        d_position[k] = along_camera(camera, k, d_point);
    blank(drawn, 3, d_position);
    store_rows3(d_position, d_mean, item, used);

    load_rows3(mean, item, used, position);
    load_shape(&s, shape, rotation, item, used);
    fv d_seen[3][3]; /* by the columns of the shape in camera space */
    for (int k = 0; k < 3; ++k)
        for (int row = 0; row < 3; ++row)
            d_seen[k][row] = d_a[k] * s.rays[0][row] + d_b[k] * s.rays[1][row];
    for (int row = 0; row < 3 && want_camera; ++row) {
        fv d_row[4] = {d_point[row] * position[0], d_point[row] * position[1],
                       d_point[row] * position[2], d_point[row]};
        for (int k = 0; k < 3; ++k)
            for (int i = 0; i < 3; ++i)
                d_row[i] = fma(d_seen[k][row], s.root[k][i], d_row[i]);
        blank(drawn, 4, d_row);
        for (int i = 0; i < 4; ++i)
            store_rows1(d_row + i, d_camera + (size_t)count * (size_t)(4 * row + i), item, used);
    }
#if BY_COVARIANCE
    fv d_cov[6];
    load_rows3(whitening, item, used, factor);
    load_rows3(d_whitening, item, used, d_factor);
    covariance_gradient(&s, factor, d_factor, d_share, camera, d_cov);
    blank(drawn, 6, d_cov);
    for (size_t i = 0; i < 6; ++i) {
        float lanes[VEC];
        STORE_V(d_cov[i], 0, lanes);
        for (size_t lane = 0; lane < used; ++lane)
            d_shape[6 * (item + lane) + i] = lanes[lane];
    }
    (void)d_rotation;
#else
    fv d_turn[3][3], d_quaternion[4], quaternion[4];
    for (int k = 0; k < 3; ++k) {
        for (int i = 0; i < 3; ++i)
            d_turn[i][k] = s.p.scale[k] * along_camera(camera, i, d_seen[k]);
        d_size[k] = s.p.scale[k] == (fv)(0.0f) ? (fv)(0.0f) : d_size[k] / s.p.scale[k];
    }
    quaternion_gradient(s.unit_quat, d_turn, d_quaternion);
    load_rows4(rotation, item, used, quaternion);
    unit_gradient(quaternion, d_quaternion);
    blank(drawn, 3, d_size);
    blank(drawn, 4, d_quaternion);
    store_rows3(d_size, d_shape, item, used);
    store_rows4(d_quaternion, d_rotation, item, used);
#endif
}
