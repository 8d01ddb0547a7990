/* Which anchors a view may see: each is projected as a Gaussian with the scale of its offsets and
 * no rotation, and kept if its 3-sigma square touches the image's tiles.
 *
 * cull_test: a work-item per VEC anchors.
 * cull_compact: a work-item per anchor and per entry of the list, whichever are more.
 * cull_mark: a work-item per anchor.
 * Work-group: see scan/part_sums.h for cull_test, else any.
 */
#include "common/camera.h"
#include "common/camera_space.h"
#include "common/lane_math.h"
#include "common/method.h"
#include "common/real.h"
#include "common/rows.h"
#include "common/tile_size.h"
#include "scan/part_sums.h"

/* Numbers of a row of scaling: three for the offsets, which count here, three for the shape. */
#define SCALING_DIM 6
DEFINE_LOAD_ROWS(load_rows6, 6)

/* The three entries of one row of the 2x3 factor J W S: focal/z (W_axis - slope W_z) scale. */
static inline void factor_row(__global const float *camera, const int axis, const fv focal_on_z,
                              const fv slope, const fv scale[3], fv factor[3])
{
    __global const float *along = camera + CAMERA_ROTATION + 3 * axis;
    __global const float *depth = camera + CAMERA_ROTATION + 6;
    for (int i = 0; i < 3; ++i)
        factor[i] = focal_on_z * scale[i] * fma(-slope, (fv)(depth[i]), (fv)(along[i]));
}

/* Largest variance on the screen, blurred, square pixels. */
static inline fv largest_variance(const fv a[3], const fv b[3])
{
    const fv xx = dot3(a, a) + (fv)(BLUR), yy = dot3(b, b) + (fv)(BLUR);
    const fv xy = dot3(a, b), half_difference = 0.5f * (xx - yy);
    return 0.5f * (xx + yy) + sqrt(fma(half_difference, half_difference, xy * xy));
}

/* Whether [centre - radius, centre + radius] touches the tiles of `size` pixels. */
static inline iv touches(const fv centre, const fv radius, const float size)
{
    const float tiled = ceil(size / TILE_SIZE) * TILE_SIZE;
    return (centre + radius > (fv)(0.0f)) & (centre - radius < (fv)(tiled));
}

/* Which of `used` anchors from `first` on may be seen, 1 each, else 0. A NaN is not seen, nor is an
 * anchor less than `smallest` pixels wide (6 sigma, without the blur). */
static inline iv seen_anchors(__global const float *position, __global const float *scaling,
                              __global const float *camera, const size_t first, const size_t used,
                              const float smallest)
{
    fv p[3], scale[SCALING_DIM];
    load_rows3(position, first, used, p);
    load_rows6(scaling, first, used, scale);
    for (int i = 0; i < 3; ++i)
        scale[i] = exp_v(clamp_lanes(scale[i], (fv)(-LOG_SCALE_LIMIT), (fv)(LOG_SCALE_LIMIT)));
    const fv z = camera_coordinate(camera, 2, p);
    fv factor[2][3], centre[2];
    for (int axis = 0; axis < 2; ++axis) {
        const fv slope = camera_coordinate(camera, axis, p) / z;
        const float focal = camera[CAMERA_FX + axis];
        centre[axis] = fma(slope, (fv)(focal), (fv)(camera[CAMERA_CX + axis]));
        __global const float *limits = camera + CAMERA_SLOPE_LIMITS + 2 * axis;
        const fv clamped = clamp_lanes(slope, (fv)(limits[0]), (fv)(limits[1]));
        factor_row(camera, axis, (fv)(focal) / z, clamped, scale, factor[axis]);
    }
    const fv largest = largest_variance(factor[0], factor[1]);
    const fv radius = ceil(3.0f * sqrt(largest)); /* half the edge of the 3-sigma square */
    const iv all_wide = (fv)(smallest) <= (fv)(0.0f);
    const iv wide = 36.0f * (largest - (fv)(BLUR)) >= (fv)(smallest * smallest);
    const iv seen = (z > (fv)(camera[CAMERA_NEAR])) & (radius > (fv)(0.0f)) & (wide | all_wide) &
                    touches(centre[0], radius, camera[CAMERA_WIDTH]) &
                    touches(centre[1], radius, camera[CAMERA_HEIGHT]);
    return seen ? (iv)(1) : (iv)(0);
}

/* keep[i] = 1 if anchor i may be seen, else 0. */
PART_GROUP __kernel void cull_test(__global const float *position, __global const float *scaling,
                                   __global const float *camera, const int count,
                                   const float smallest, __global int *keep, __global long *sums)
{
    DECLARE_PART_SCRATCH(scratch);
    const size_t first = get_global_id(0) * VEC, size = (size_t)count;
    const size_t used = first < size ? min((size_t)VEC, size - first) : 0;
    int lanes[VEC], kept = 0;
    if (used != 0)
        STORE_V(seen_anchors(position, scaling, camera, first, used, smallest), 0, lanes);
    for (size_t lane = 0; lane < used; ++lane) {
        keep[first + lane] = lanes[lane];
        kept += lanes[lane];
    }
    write_part_sum(scratch, first, count, kept, sums);
}

/* Lists the kept anchors. place: the exclusive prefix sum of keep. Anchors beyond the capacity are
 * left out, and entries after the last one are -1. */
__kernel void cull_compact(__global const int *keep, __global const int *place, const int count,
                           __global const long *total, const int capacity, __global int *visible)
{
    const int i = (int)get_global_id(0);
    if (i < count && keep[i] && place[i] < capacity)
        visible[place[i]] = i;
    if (i < capacity && (long)i >= total[0])
        visible[i] = -1;
}

/* Every anchor at its own place, -1 if it is not kept. */
__kernel void cull_mark(__global const int *keep, const int count, __global int *visible)
{
    const int i = (int)get_global_id(0);
    if (i < count)
        visible[i] = keep[i] ? i : -1;
}
