/* The exposure of a photo: an affine map of the colors of a picture, y = M x + b, as rows of 3 x 4
 * numbers (M | b), 12 for each photo.
 *
 * exposure_forward: a work-item per vector of pixels.
 * exposure_backward: a work-group per EXPOSURE_BLOCK pixels, on a CPU one work-item; block sums.
 * exposure_sum: a work-item per number of the map; adds the blocks in order.
 * exposure_centre: a work-item per number of the map; goes through the photos in order.
 */
#include "common/form.h"
#include "common/lanes.h"
#include "common/real.h"
#include "loss/group.h"

#ifndef EXPOSURE_BLOCK
#define EXPOSURE_BLOCK 2048
#endif
#ifndef MAP_SIZE
#define MAP_SIZE 12
#endif

/* Vector number `vector` of each of the three planes of `total` pixels. */
static inline void load_pixels(__global const float *planes, const size_t vector,
                               const size_t total, fv pixels[3])
{
    for (int k = 0; k < 3; ++k)
        pixels[k] = load_lanes(planes + k * total, vector, total);
}

/* picture = M image + b; planes of `total` pixels; the map is number `photo` of `maps`. */
__kernel void exposure_forward(__global const float *image, const uint total,
                               __global const float *maps, const uint photo,
                               __global float *picture)
{
    const size_t vector = get_global_id(0);
    if (vector >= vectors_in(total))
        return;
    fv x[3];
    load_pixels(image, vector, total, x);
    maps += MAP_SIZE * photo;
    for (int c = 0; c < 3; ++c) {
        fv y = (fv)(maps[4 * c + 3]);
        for (int k = 0; k < 3; ++k)
            y = fma((fv)(maps[4 * c + k]), x[k], y);
        store_lanes(y, vector, picture + c * (size_t)total, total);
    }
}

/* d_image = M^T d_picture of one vector of pixels. */
static inline void pixels_backward(const fv d[3], __global const float *map, const size_t vector,
                                   const size_t total, __global float *d_image)
{
    for (int k = 0; k < 3; ++k) {
        fv back = (fv)(0.0f);
        for (int c = 0; c < 3; ++c)
            back = fma((fv)(map[4 * c + k]), d[c], back);
        store_lanes(back, vector, d_image + k * total, total);
    }
}

/* Sums over a block of pixels of d y / d(map) times d_picture. Each number of the map is summed in
 * SUM_LANES lanes, of every SUM_LANES-th pixel, and these by the tree of lanes.h. */
#if USE_LOCAL
static inline void store_map_sums(__global const float *image, __global const float *d_picture,
                                  const size_t begin, const size_t total, __local float *lanes,
                                  __global float *sums)
{
    const int number = ITEM / SUM_LANES, lane = ITEM % SUM_LANES;
    const size_t end = min(begin + EXPOSURE_BLOCK, total);
    if (number < MAP_SIZE) {
        __global const float *d = d_picture + number / 4 * total;
        __global const float *x = image + number % 4 * total;
        float sum = 0.0f;
        for (size_t pixel = begin + lane; pixel < end; pixel += SUM_LANES)
            sum = number % 4 < 3 ? fma(d[pixel], x[pixel], sum) : sum + d[pixel];
        lanes[number * LANES_PITCH + lane] = sum;
    }
    SYNC();
    if (ITEM < MAP_SIZE)
        sums[ITEM] = lane_tree(lanes + ITEM * LANES_PITCH);
}
#else
static inline void store_map_sums(__global const float *image, __global const float *d_picture,
                                  const size_t begin, const size_t total, __private float *lanes,
                                  __global float *sums)
{
    (void)lanes;
    fv x[3], d[3], sum[MAP_SIZE];
    for (int i = 0; i < MAP_SIZE; ++i)
        sum[i] = (fv)(0.0f);
    for (size_t first = begin; first < min(begin + EXPOSURE_BLOCK, total); first += VEC) {
        load_pixels(image, first / VEC, total, x);
        load_pixels(d_picture, first / VEC, total, d);
        for (int c = 0; c < 3; ++c) {
            for (int k = 0; k < 3; ++k)
                sum[4 * c + k] = fma(d[c], x[k], sum[4 * c + k]);
            sum[4 * c + 3] += d[c];
        }
    }
    for (int i = 0; i < MAP_SIZE; ++i)
        sums[i] = lane_sum(sum[i]);
}
#endif

/* d_image = M^T d_picture, and for each block its part of the gradient of the map. */
GROUP_SIZED __kernel void exposure_backward(__global const float *image,
                                            __global const float *d_picture, const uint total,
                                            __global const float *maps, const uint photo,
                                            __global float *d_image, __global float *sums)
{
    SPACE float lanes[MAP_SIZE * LANES_PITCH];
    const size_t begin = get_group_id(0) * EXPOSURE_BLOCK;
    for (int unit = ITEM * VEC; unit < EXPOSURE_BLOCK; unit += ITEMS * VEC) {
        fv d[3];
        if (begin + (size_t)unit >= total)
            continue;
        load_pixels(d_picture, (begin + (size_t)unit) / VEC, total, d);
        pixels_backward(d, maps + MAP_SIZE * photo, (begin + (size_t)unit) / VEC, total, d_image);
    }
    store_map_sums(image, d_picture, begin, total, lanes, sums + MAP_SIZE * get_group_id(0));
}

/* d_maps of number `photo`: the blocks' sums, and pull * (map - identity). */
__kernel void exposure_sum(__global const float *sums, const uint blocks,
                           __global const float *maps, const uint photo, const float pull,
                           __global float *d_maps)
{
    const size_t number = get_global_id(0);
    if (number >= MAP_SIZE)
        return;
    float sum = 0.0f;
    for (size_t block = 0; block < blocks; ++block)
        sum += sums[MAP_SIZE * block + number];
    const size_t at = MAP_SIZE * photo + number;
    const float identity = number % 5 == 0 ? 1.0f : 0.0f;
    d_maps[at] = fma(pull, maps[at] - identity, sum);
}

/* Moves all maps alike, so that their mean is the identity. Nothing happens unless *stop is 0. */
__kernel void exposure_centre(__global float *maps, const uint photos, __global const int *stop)
{
    const size_t number = get_global_id(0);
    if (number >= MAP_SIZE || *stop != 0)
        return;
    const float identity = number % 5 == 0 ? 1.0f : 0.0f;
    float sum = 0.0f;
    for (size_t photo = 0; photo < photos; ++photo)
        sum += maps[MAP_SIZE * photo + number] - identity;
    const float mean = sum / (float)photos;
    for (size_t photo = 0; photo < photos; ++photo)
        maps[MAP_SIZE * photo + number] -= mean;
}
