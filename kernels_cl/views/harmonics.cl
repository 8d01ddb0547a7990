/* Colors from spherical harmonics alone, for directions from any point, and the way back.
 *
 * Work-item: VEC Gaussians, one per lane, counted from the middle on. Their coefficients are read
 *     row by row, since a row is longer than a vector.
 * Work-group: any; no local memory.
 * Launch: a work-item per VEC Gaussians.
 */
#include "common/items.h"
#include "common/real.h"
#include "common/rows.h"
#include "gaussian/harmonics.h"
#include "gaussian/seen_colors.h"

/* camera: (26,), of which the centre is used. */
__kernel void harmonics_forward(__global const float *mean, __global const float *sh,
                                __global const float *camera, const int count,
                                __global float *color)
{
    const size_t first = item_from_middle() * VEC;
    if (first >= (size_t)count)
        return;
    const size_t used = min((size_t)VEC, (size_t)count - first);
    fv position[3], direction[3], basis[MAX_COEFFICIENTS];
    load_rows3(mean, first, used, position);
    look_at(position, camera, direction);
    harmonics(direction, basis);
    write_colors(sh, basis, first, used, color);
}

/* Rows of d_sh that are not used are left as they are. */
__kernel void harmonics_backward(__global const float *mean, __global const float *sh,
                                 __global const float *camera, const int count,
                                 __global const float *color, __global const float *d_color,
                                 __global float *d_sh, __global float *d_mean)
{
    const size_t first = item_from_middle() * VEC;
    if (first >= (size_t)count)
        return;
    const size_t used = min((size_t)VEC, (size_t)count - first);
    fv position[3], direction[3], basis[MAX_COEFFICIENTS], weight[MAX_COEFFICIENTS];
    load_rows3(mean, first, used, position);
    const fv on_length = look_at(position, camera, direction);
    harmonics(direction, basis);
    color_gradient(sh, color, d_color, basis, first, used, weight, d_sh);
    fv d_position[3] = {(fv)(0.0f), (fv)(0.0f), (fv)(0.0f)};
    direction_gradient(direction, on_length, weight, d_position);
    store_rows3(d_position, d_mean, first, used);
}
