/* Ordinary Gaussians as a camera sees them: scales, unit quaternions, opacities and colors from
 * what 3DGS stores, and the way back.
 *
 * Work-item: VEC Gaussians, one per lane, counted from the middle on. Their coefficients are read
 *     row by row, since a row is longer than a vector.
 * Work-group: any; no local memory.
 * Launch: a work-item per VEC Gaussians.
 *
 * sh and d_sh are (N, COEFFICIENTS, 3).
 */
#include "common/items.h"
#include "common/method.h"
#include "common/real.h"
#include "common/rows.h"
#include "gaussian/harmonics.h"
#include "gaussian/log_scale.h"
#include "gaussian/seen_colors.h"
#include "gaussian/unit_quaternion.h"

__kernel void splats_forward(__global const float *mean, __global const float *log_scale,
                             __global const float *rotation, __global const float *logit,
                             __global const float *sh, __global const float *camera,
                             const int count, __global float *scale, __global float *unit,
                             __global float *color, __global float *opacity)
{
    const size_t first = item_from_middle() * VEC;
    if (first >= (size_t)count)
        return;
    const size_t used = min((size_t)VEC, (size_t)count - first);
    fv position[3], size[3], quaternion[4], opaque, direction[3], basis[MAX_COEFFICIENTS];
    load_rows3(mean, first, used, position);
    load_rows3(log_scale, first, used, size);
    load_rows4(rotation, first, used, quaternion);
    load_rows1(logit, first, used, &opaque);
    for (int i = 0; i < 3; ++i)
        size[i] = exp_log_scale(size[i]);
    make_unit(quaternion);
    opaque = sigmoid_v(opaque);
    store_rows3(size, scale, first, used);
    store_rows4(quaternion, unit, first, used);
    store_rows1(&opaque, opacity, first, used);
    look_at(position, camera, direction);
    harmonics(direction, basis);
    write_colors(sh, basis, first, used, color);
}

/* Gradients by the stored numbers from those by scale, unit quaternion, color and opacity; d_mean
 * has the gradient by the mean alone, and receives that of the color by it. */
__kernel void splats_backward(__global const float *mean, __global const float *log_scale,
                              __global const float *rotation, __global const float *sh,
                              __global const float *camera, const int count,
                              __global const float *scale, __global const float *color,
                              __global const float *opacity, __global const float *d_scale,
                              __global const float *d_unit, __global const float *d_color,
                              __global const float *d_opacity, __global float *d_mean,
                              __global float *d_log_scale, __global float *d_rotation,
                              __global float *d_logit, __global float *d_sh)
{
    const size_t first = item_from_middle() * VEC;
    if (first >= (size_t)count)
        return;
    const size_t used = min((size_t)VEC, (size_t)count - first);
    fv position[3], direction[3], d_position[3];
    fv basis[MAX_COEFFICIENTS], weight[MAX_COEFFICIENTS];
    load_rows3(mean, first, used, position);
    const fv on_length = look_at(position, camera, direction);
    harmonics(direction, basis);
    color_gradient(sh, color, d_color, basis, first, used, weight, d_sh);
    load_rows3(d_mean, first, used, d_position);
    direction_gradient(direction, on_length, weight, d_position);
    store_rows3(d_position, d_mean, first, used);

    fv size[3], log_size[3], d_size[3];
    load_rows3(scale, first, used, size);
    load_rows3(log_scale, first, used, log_size);
    load_rows3(d_scale, first, used, d_size);
    for (int i = 0; i < 3; ++i)
        d_size[i] = fabs(log_size[i]) <= (fv)(LOG_SCALE_LIMIT) ? d_size[i] * size[i] : (fv)(0.0f);
    store_rows3(d_size, d_log_scale, first, used);

    fv quaternion[4], d_quaternion[4];
    load_rows4(rotation, first, used, quaternion);
    load_rows4(d_unit, first, used, d_quaternion);
    unit_gradient(quaternion, d_quaternion);
    store_rows4(d_quaternion, d_rotation, first, used);

    fv opaque, d_opaque;
    load_rows1(opacity, first, used, &opaque);
    load_rows1(d_opacity, first, used, &d_opaque);
    d_opaque *= opaque * (1.0f - opaque);
    store_rows1(&d_opaque, d_logit, first, used);
}
