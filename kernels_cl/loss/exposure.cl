/* The exposure of a photo: an affine map of the colors of a picture, y = M x + b, as rows of 3 x 4
 * numbers (M | b), 12 for each photo.
 *
 * exposure_forward: a work-item per vector of pixels.
 * exposure_backward: a work-group per EXPOSURE_BLOCK pixels, on a CPU one work-item; block sums.
 * exposure_sum: a work-item per number of the map; adds the blocks in order.
 * exposure_centre: a work-item per number of the map; goes through the photos in order.
 */
#include "common/lanes.h"
#include "common/real.h"
#include "loss/group.h"

#define EXPOSURE_BLOCK 2048
#define MAP_SIZE 12

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

/* d_image = M^T d_picture, and for each block its part of the gradient of the map. */
GROUP_SIZED __kernel void exposure_backward(__global const float *image,
                                            __global const float *d_picture, const uint total,
                                            __global const float *maps, const uint photo,
                                            __global float *d_image, __global float *sums)
{
    SPACE float4 scratch[ITEMS];
    fv x[3], d[3], sum[MAP_SIZE];
    for (int i = 0; i < MAP_SIZE; ++i)
        sum[i] = (fv)(0.0f);
    maps += MAP_SIZE * photo;
    for (int unit = ITEM * VEC; unit < EXPOSURE_BLOCK; unit += ITEMS * VEC) {
        const size_t first = get_group_id(0) * EXPOSURE_BLOCK + (size_t)unit;
        if (first >= total)
            continue;
        load_pixels(image, first / VEC, total, x);
        load_pixels(d_picture, first / VEC, total, d);
        for (int k = 0; k < 3; ++k) {
            fv back = (fv)(0.0f);
            for (int c = 0; c < 3; ++c) {
                back = fma((fv)(maps[4 * c + k]), d[c], back);
                sum[4 * c + k] = fma(d[c], x[k], sum[4 * c + k]);
            }
            store_lanes(back, first / VEC, d_image + k * (size_t)total, total);
            sum[4 * k + 3] += d[k];
        }
    }
    for (int c = 0; c < 3; ++c) {
        const fv *row = sum + 4 * c;
        const float4 block = group_sum(lane_sums(row[0], row[1], row[2], row[3]), scratch);
        if (ITEM == 0)
            vstore4(block, 3 * get_group_id(0) + c, sums);
    }
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
