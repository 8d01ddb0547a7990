/* Which anchors a view may see: each is projected as a Gaussian with the scale of its offsets and
 * no rotation, and kept where its 3-sigma square touches the image's tiles. */
#include "common/rows.h"
#include "common/camera.h"

#ifndef BLUR
#define BLUR 0.3f
#endif
#ifndef LOG_SCALE_LIMIT
#define LOG_SCALE_LIMIT 20.0f
#endif
#ifndef TILE_SIZE
#define TILE_SIZE 16
#endif

/* Numbers of a row of scaling: three for the offsets, which count here, three for the shape. */
#define SCALING_DIM 6
DEFINE_LOAD_ROWS(load_rows6, 6)

/* Row `row` of the world-to-camera rotation times (x, y, z). */
static inline fv rotate(__global const float *camera, const int row, const fv x, const fv y,
                        const fv z)
{
    __global const float *r = camera + CAMERA_ROTATION + 3 * row;
    return fma((fv)(r[2]), z, fma((fv)(r[1]), y, (fv)(r[0]) * x));
}

static inline fv bound(const fv x, const float low, const float high)
{
    const fv raised = x < (fv)(low) ? (fv)(low) : x;
    return raised > (fv)(high) ? (fv)(high) : raised;
}

/* The three entries of one row of the 2x3 factor J W S: focal/z (W_axis - slope W_z) scale. */
static inline void factor_row(__global const float *camera, const int axis, const fv focal_on_z,
                              const fv slope, const fv scale[3], fv factor[3])
{
    __global const float *along = camera + CAMERA_ROTATION + 3 * axis;
    __global const float *depth = camera + CAMERA_ROTATION + 6;
    for (int i = 0; i < 3; ++i)
        factor[i] = focal_on_z * scale[i] * fma(-slope, (fv)(depth[i]), (fv)(along[i]));
}

static inline fv dot_lanes(const fv a[3], const fv b[3])
{
    return fma(a[2], b[2], fma(a[1], b[1], a[0] * b[0]));
}

/* Largest variance on the screen, blurred, square pixels. */
static inline fv largest_variance(const fv a[3], const fv b[3])
{
    const fv xx = dot_lanes(a, a) + (fv)(BLUR), yy = dot_lanes(b, b) + (fv)(BLUR);
    const fv xy = dot_lanes(a, b), half_difference = 0.5f * (xx - yy);
    return 0.5f * (xx + yy) + sqrt(fma(half_difference, half_difference, xy * xy));
}

/* Whether [centre - radius, centre + radius] touches the tiles of `size` pixels. */
static inline iv touches(const fv centre, const fv radius, const float size)
{
    const float tiled = ceil(size / TILE_SIZE) * TILE_SIZE;
    return (centre + radius > (fv)(0.0f)) & (centre - radius < (fv)(tiled));
}

/* One work-item VEC anchors: keep[i] = 1 where anchor i may be seen, else 0; NaN is not seen. Nor
 * is an anchor that is less than `smallest` pixels wide (6 sigma, without the blur). */
__kernel void cull_test(__global const float *position, __global const float *scaling,
                        __global const float *camera, const int count, const float smallest,
                        __global int *keep)
{
    const size_t first = get_global_id(0) * VEC, size = (size_t)count;
    if (first >= size)
        return;
    const size_t used = min((size_t)VEC, size - first);
    fv p[3], scale[SCALING_DIM];
    load_rows3(position, first, used, p);
    load_rows6(scaling, first, used, scale);
    for (int i = 0; i < 3; ++i)
        scale[i] = exp_v(bound(scale[i], -LOG_SCALE_LIMIT, LOG_SCALE_LIMIT));
    const fv z = rotate(camera, 2, p[0], p[1], p[2]) + (fv)(camera[CAMERA_TRANSLATION + 2]);
    fv factor[2][3], centre[2];
    for (int axis = 0; axis < 2; ++axis) {
        const fv along = rotate(camera, axis, p[0], p[1], p[2]);
        const fv slope = (along + (fv)(camera[CAMERA_TRANSLATION + axis])) / z;
        const float focal = camera[CAMERA_FX + axis];
        centre[axis] = fma(slope, (fv)(focal), (fv)(camera[CAMERA_CX + axis]));
        __global const float *limits = camera + CAMERA_SLOPE_LIMITS + 2 * axis;
        factor_row(camera, axis, (fv)(focal) / z, bound(slope, limits[0], limits[1]), scale,
                   factor[axis]);
    }
    const fv largest = largest_variance(factor[0], factor[1]);
    const fv radius = ceil(3.0f * sqrt(largest)); /* half the edge of the 3-sigma square */
    const iv all_wide = (fv)(smallest) <= (fv)(0.0f);
    const iv wide = 36.0f * (largest - (fv)(BLUR)) >= (fv)(smallest * smallest);
    const iv seen = (z > (fv)(camera[CAMERA_NEAR])) & (radius > (fv)(0.0f)) & (wide | all_wide) &
                    touches(centre[0], radius, camera[CAMERA_WIDTH]) &
                    touches(centre[1], radius, camera[CAMERA_HEIGHT]);
    int lanes[VEC];
    STORE_V(seen ? (iv)(1) : (iv)(0), 0, lanes);
    for (size_t lane = 0; lane < VEC && first + lane < size; ++lane)
        keep[first + lane] = lanes[lane];
}

/* Lists the kept anchors; place is the exclusive sum of keep. What lies beyond the capacity is left
 * out, and entries after the last one are -1. One work-item an anchor and an entry. */
__kernel void cull_compact(__global const int *keep, __global const int *place, const int count,
                           __global const long *total, const int capacity, __global int *visible)
{
    const int i = (int)get_global_id(0);
    if (i < count && keep[i] && place[i] < capacity)
        visible[place[i]] = i;
    if (i < capacity && (long)i >= total[0])
        visible[i] = -1;
}

/* Every anchor at its own place, -1 for those that are not kept. */
__kernel void cull_mark(__global const int *keep, const int count, __global int *visible)
{
    const int i = (int)get_global_id(0);
    if (i < count)
        visible[i] = keep[i] ? i : -1;
}
