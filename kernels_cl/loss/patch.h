/* Patches of planar images, PATCH_ROWS x PATCH_COLUMNS pixels of one channel each, one per
 * work-group (group ids: patch x, patch y, channel): guarded loads and stores of lanes along x. */
#ifndef CLGS_PATCH_H
#define CLGS_PATCH_H

#include "common/real.h"

#ifndef PATCH_COLUMNS
#define PATCH_COLUMNS 16
#endif
#ifndef PATCH_ROWS
#define PATCH_ROWS 32
#endif

typedef struct {
    int x; /* first pixel of the patch */
    int y;
    int width; /* of the image */
    int height;
    size_t plane; /* offset of this channel */
} Patch;

static inline Patch make_patch(int width, int height)
{
    Patch patch;
    patch.x = (int)get_group_id(0) * PATCH_COLUMNS;
    patch.y = (int)get_group_id(1) * PATCH_ROWS;
    patch.width = width;
    patch.height = height;
    patch.plane = get_group_id(2) * (size_t)width * (size_t)height;
    return patch;
}

/* Number of a patch of this channel among the patches of all channels. */
static inline size_t patch_index(int patch_x, int patch_y)
{
    return (get_group_id(2) * get_num_groups(1) + (size_t)patch_y) * get_num_groups(0) +
           (size_t)patch_x;
}

static inline bool inside(Patch patch, int x, int y)
{
    return x >= 0 && x < patch.width && y >= 0 && y < patch.height;
}

/* Lanes from pixel (x, y) on, zero outside of the image. */
static inline fv load_pixels(Patch patch, __global const float *image, int x, int y)
{
    __global const float *row = image + patch.plane + (size_t)y * (size_t)patch.width;
    if (y >= 0 && y < patch.height && x >= 0 && x + VEC <= patch.width)
        return LOAD_V(0, row + x);
    float lanes[VEC];
    for (int lane = 0; lane < VEC; ++lane)
        lanes[lane] = inside(patch, x + lane, y) ? row[x + lane] : 0.0f;
    return LOAD_V(0, lanes);
}

/* The same of 8-bit pixels, as level / 255 correctly rounded. */
static inline fv load_levels(Patch patch, __global const uchar *target, int x, int y)
{
    __global const uchar *row = target + patch.plane + (size_t)y * (size_t)patch.width;
    fv level;
    if (y >= 0 && y < patch.height && x >= 0 && x + VEC <= patch.width) {
        level = TO_FV(LOAD_V(0, row + x));
    } else {
        float lanes[VEC];
        for (int lane = 0; lane < VEC; ++lane)
            lanes[lane] = inside(patch, x + lane, y) ? (float)row[x + lane] : 0.0f;
        level = LOAD_V(0, lanes);
    }
    const fv quotient = level * (1.0f / 255.0f);
    const fv rest = fma(quotient, (fv)(-255.0f), level);
    return fma(rest, (fv)(1.0f / 255.0f), quotient);
}

static inline void store_pixels(Patch patch, fv value, __global float *image, int x, int y)
{
    __global float *row = image + patch.plane + (size_t)y * (size_t)patch.width;
    if (x + VEC <= patch.width) {
        STORE_V(value, 0, row + x);
        return;
    }
    float lanes[VEC];
    STORE_V(value, 0, lanes);
    for (int lane = 0; lane < VEC && x + lane < patch.width; ++lane)
        row[x + lane] = lanes[lane];
}

/* 1 for lanes whose pixel lies in the image, else 0. */
static inline fv image_mask(Patch patch, int x, int y)
{
    if (y >= 0 && y < patch.height && x >= 0 && x + VEC <= patch.width)
        return (fv)(1.0f);
    float lanes[VEC];
    for (int lane = 0; lane < VEC; ++lane)
        lanes[lane] = inside(patch, x + lane, y) ? 1.0f : 0.0f;
    return LOAD_V(0, lanes);
}

#endif
