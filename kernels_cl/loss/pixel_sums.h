/* Sums over the pixels of a patch, in the same order in both forms: down each column of pixels,
 * then over the columns by the tree of lanes.h. The GPU form keeps what the pixels give in local
 * memory until all of it is there. */
#ifndef CLGS_PIXEL_SUMS_H
#define CLGS_PIXEL_SUMS_H

#include "common/lanes.h"
#include "common/real.h"
#include "loss/group.h"
#include "loss/patch.h"

#define PATCH_PIXELS (PATCH_ROWS * PATCH_COLUMNS)

#if VEC == 1

/* Sums over columns take their place from `pixels`, PATCH_PIXELS numbers that nothing else needs.
 */
#define DECLARE_PIXEL_SUMS(name, pixels)                                                           \
    SPACE float *name = (pixels);                                                                  \
    clear_pixels(name)
#define ADD_PIXELS(name, unit, value) (name)[unit] = (value)
#define STORE_PIXEL_SUM(name, to) store_pixel_sum(name, to)

static inline void clear_pixels(SPACE float *pixels)
{
    for (int pixel = ITEM; pixel < PATCH_PIXELS; pixel += ITEMS)
        pixels[pixel] = 0.0f;
}

static inline void store_pixel_sum(SPACE float *pixels, __global float *to)
{
    SYNC();
    float sum = 0.0f;
    for (int row = 0; row < PATCH_ROWS && ITEM < PATCH_COLUMNS; ++row)
        sum += pixels[row * PATCH_COLUMNS + ITEM];
    SYNC();
    if (ITEM < PATCH_COLUMNS)
        pixels[ITEM] = sum;
    SYNC();
    if (ITEM == 0)
        *to = lane_tree(pixels);
}

#else

#define DECLARE_PIXEL_SUMS(name, pixels) fv name[SUM_PARTS] = {(fv)(0.0f)}
#define ADD_PIXELS(name, unit, value) (name)[(unit) % SUM_PARTS] += (value)
#define STORE_PIXEL_SUM(name, to) *(to) = parts_sum(name)

#endif
#endif
