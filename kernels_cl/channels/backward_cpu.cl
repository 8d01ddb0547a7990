/* Gradients of the blending by channels, CPU form: back to front with T / (1 - alpha) and one
 * scalar per pixel, the channels behind the record dotted with d_image. Every entry of a list
 * writes one row of moments to a place of its own, and sums.cl adds the rows of each Gaussian: no
 * atomics, the same bits in every run.
 *
 * A work-item owns a tile: its pixels lie in private memory, cut into units of VEC lanes, and it
 * writes a row per entry of its list. Work-groups of one work-item; launch size: the number of
 * tiles, from `first_tile` on. No local memory. */
#include "blend/record.h"
#include "blend/touch.h"
#include "blend/units.h"
#include "channels/layout.h"
#include "channels/unveil.h"
#include "common/lanes.h"
#include "common/prefetch.h"
#include "common/real.h"
#include "common/tile_size.h"

#define ROWS_AHEAD 8

/* A unit of pixels on the way back, their centres, and the last contributor of them all. */
typedef struct {
    ChannelRays rays;
    fv x, y;
    int last;
} ChannelRayUnit;

/* The pixels of a unit at (x, y) of channel `c` of an image; those outside of it read as zero. */
static inline fv load_channel(__global const float *image, const int c, const int pitch,
                              const int x, const int y, const int width, const int height)
{
    float lane[VEC];
    for (int i = 0; i < VEC; ++i) {
        const int column = x + i % UNIT_WIDTH, row = y + i / UNIT_WIDTH;
        const size_t at = (size_t)row * (size_t)width + (size_t)column;
        const bool inside = column < width && row < height;
        lane[i] = inside ? image[at * (size_t)pitch + (size_t)c] : 0.0f;
    }
    return LOAD_V(0, lane);
}

static inline int last_lane(const iv values)
{
    int lane[VEC], largest = 0;
    STORE_V(values, 0, lane);
    for (int i = 0; i < VEC; ++i)
        largest = max(largest, lane[i]);
    return largest;
}

static inline void store_row(fv part[SUM_PARTS][MOMENTS], __global float *row)
{
    for (int j = 0; j < MOMENTS; ++j) {
        fv one[SUM_PARTS];
        for (int i = 0; i < SUM_PARTS; ++i)
            one[i] = part[i][j];
        row[j] = parts_sum(one);
    }
}

/* d_left: (height, width), dL/d(transmittance) but for what the background adds to it; anything if
 * `with_left` is 0, for zeros. */
__kernel void channels_backward(__global const float *records, __global const int *gaussian,
                                __global const int *tile_range, const int first_tile,
                                __global const float *color, __global const float *depth,
                                const int first, const int pitch, __global const float *background,
                                const int width, const int height, const int image_pitch,
                                __global const float *transmittance,
                                __global const int *last_contributor, __global const float *d_image,
                                __global const float *d_left, const int with_left,
                                __global float *rows)
{
    const int tile = first_tile + (int)get_global_id(0);
    const int columns = tiles_across(width);
    const int x = tile % columns * TILE_SIZE, y = tile / columns * TILE_SIZE;
    const int begin = tile_range[tile], end = tile_range[tile + 1];
    if (begin == end)
        return;
    const TouchConstants constants = touch_constants(width >> 31);
    const Palette palette = {color, depth, first, pitch};
    ChannelRayUnit units[UNITS];
    int tile_last = 0;
    for (int u = 0; u < UNITS; ++u) {
        const int ux = x + unit_x(u), uy = y + unit_y(u);
        ChannelRays *rays = &units[u].rays;
        units[u].x = LANE_X + (float)ux;
        units[u].y = LANE_Y + (float)uy;
        rays->transmittance = load_unit(transmittance, ux, uy, width, height);
        rays->last =
            AS_IV(load_unit((__global const float *)last_contributor, ux, uy, width, height));
        rays->behind = with_left ? load_unit(d_left, ux, uy, width, height) : (fv)(0.0f);
        for (int c = 0; c < ALL_CHANNELS; ++c) {
            rays->d[c] = load_channel(d_image, first + c, image_pitch, ux, uy, width, height);
            rays->behind = fma(rays->d[c], (fv)(background[first + c]), rays->behind);
        }
        units[u].last = last_lane(rays->last);
        tile_last = max(tile_last, units[u].last);
    }
    for (int k = end - 1; k >= begin; --k) {
        __global const float *from = records + RECORD_SIZE * (size_t)k;
        __global float *row = rows + MOMENT_PITCH * (size_t)as_int(from[RECORD_ROW]);
        const int number = k - begin + 1, ahead = max(k - ROWS_AHEAD, begin);
        PREFETCH_WRITE(rows +
                       MOMENT_PITCH *
                           (size_t)as_int(records[RECORD_SIZE * (size_t)ahead + RECORD_ROW]));
        PREFETCH(color + (size_t)pitch * (size_t)gaussian[ahead]);
        const uint touched = number <= tile_last ? as_uint(from[RECORD_UNITS]) : 0u;
        Record record;
        READ_RECORD(record, from);
        float value[ALL_CHANNELS];
        load_channels(&palette, gaussian[k], value);
        fv part[SUM_PARTS][MOMENTS];
        for (int i = 0; i < SUM_PARTS; ++i) {
            for (int j = 0; j < MOMENTS; ++j)
                part[i][j] = (fv)(0.0f);
            uint left = touched & UNITS_OF_PART(i);
            while (left) {
                const int u = take_unit(&left);
                if (number > units[u].last)
                    continue;
                const Touch t = touch(&record, units[u].x, units[u].y, &constants);
                const fv weight = unveil(&units[u].rays, &record, value, &t, number, part[i]);
                for (int c = 0; c < ALL_CHANNELS; ++c)
                    part[i][MOMENT_CHANNEL + c] += weight * units[u].rays.d[c];
            }
        }
        store_row(part, row);
    }
}
