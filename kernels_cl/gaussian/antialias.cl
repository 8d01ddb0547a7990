/* Opacities of Gaussians whose blur on the screen must not make them brighter.
 *
 * Work-item: VEC Gaussians, one per lane, counted from the middle on.
 * Work-group: any; no local memory.
 * Launch: a work-item per VEC Gaussians.
 */
#include "common/items.h"
#include "common/lane_math.h"
#include "common/real.h"
#include "common/rows.h"
#include "gaussian/projection.h"

/* The determinant before blurring is a sum of squares, so that it keeps its digits for needles. */
__kernel void antialias_forward(__global const float *mean, __global const float *scale,
                                __global const float *rotation, __global const float *opacity,
                                __global const float *camera, const int count,
                                __global float *compensated)
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
    const Projection p = make_projection(position, size, quaternion, camera);
    opaque *= sqrt(dot3(p.minor, p.minor) / p.det);
    store_rows1(&opaque, compensated, first, used);
}
