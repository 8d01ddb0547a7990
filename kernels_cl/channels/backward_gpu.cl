/* Gradients of the blending by channels, GPU form: as the CPU form, and with its bits.
 *
 * A work-group owns a tile, each of its TILE_SIZE^2 work-items a pixel. Record after record, the
 * work-items leave MOMENT_BATCH moments at a time in local memory and add them up in a fixed order:
 * over the units for each of their 16 pixels, then over these by a tree. Loops over channels are
 * unrolled, so that arrays stay in registers; the loop with barriers is not: PoCL 3.1 would make
 * other sums of it. Launch size: tiles * TILE_SIZE^2, from `first_tile` on. */
#include "blend/record.h"
#include "blend/touch.h"
#include "blend/units.h"
#include "channels/layout.h"
#include "channels/unveil.h"
#include "common/lanes.h"
#include "common/tile_size.h"

#define MOMENT_BATCH 8

/* What a record leaves of a work-item's pixel: the first moments, and the weight of the others. */
typedef struct {
    float first[MOMENT_CHANNEL];
    float weight;
    bool touched;
} PixelMoments;

/* Writes the row of the moments that each work-item has of its pixel. Those of the channels are
 * made here, and indices are constants: else arrays would not stay in registers. */
static inline void write_row(const PixelMoments *m, const float d[ALL_CHANNELS],
                             __local float *pixels, __local float *lanes, __global float *row)
{
    const int item = (int)get_local_id(0), lane = item % SUM_LANES, moment = item / SUM_LANES;
    for (int begin = 0; begin < MOMENTS; begin += MOMENT_BATCH) {
        const int count = min(MOMENT_BATCH, MOMENTS - begin);
#pragma unroll
        for (int j = 0; j < MOMENT_CHANNEL; ++j)
            if (j / MOMENT_BATCH * MOMENT_BATCH == begin)
                pixels[j % MOMENT_BATCH * TILE_PIXELS + item] = m->first[j];
#pragma unroll
        for (int c = 0, j = MOMENT_CHANNEL; c < ALL_CHANNELS; ++c, ++j)
            if (j / MOMENT_BATCH * MOMENT_BATCH == begin)
                pixels[j % MOMENT_BATCH * TILE_PIXELS + item] =
                    m->touched ? 0.0f + m->weight * d[c] : 0.0f;
        barrier(CLK_LOCAL_MEM_FENCE);
        if (moment < count) {
            float sum = 0.0f;
            for (int u = 0; u < TILE_PIXELS / SUM_LANES; ++u)
                sum += pixels[moment * TILE_PIXELS + u * SUM_LANES + lane];
            lanes[moment * LANES_PITCH + lane] = sum;
        }
        barrier(CLK_LOCAL_MEM_FENCE);
        if (item < count)
            row[begin + item] = lane_tree(lanes + item * LANES_PITCH);
    }
}

/* d_left: (height, width), dL/d(transmittance) but for what the background adds to it; anything if
 * `with_left` is 0, for zeros. */
TILE_GROUP __kernel void
channels_backward(__global const float *records, __global const int *gaussian,
                  __global const int *tile_range, const int first_tile, __global const float *color,
                  __global const float *depth, const int first, const int pitch,
                  __global const float *background, const int width, const int height,
                  const int image_pitch, __global const float *transmittance,
                  __global const int *last_contributor, __global const float *d_image,
                  __global const float *d_left, const int with_left, __global float *rows)
{
    __local float pixels[MOMENT_BATCH * TILE_PIXELS], lanes[MOMENT_BATCH * LANES_PITCH];
    const int tile = first_tile + (int)get_group_id(0), item = (int)get_local_id(0);
    const int columns = tiles_across(width);
    const int x = tile % columns * TILE_SIZE + pixel_x(item);
    const int y = tile / columns * TILE_SIZE + pixel_y(item);
    const uint unit = unit_bit(item / UNIT_SIZE);
    const TouchConstants constants = touch_constants(0);
    const Palette palette = {color, depth, first, pitch};
    ChannelRays rays;
    rays.transmittance = 1.0f;
    rays.behind = 0.0f;
    rays.last = 0;
#pragma unroll
    for (int c = 0; c < ALL_CHANNELS; ++c)
        rays.d[c] = 0.0f;
    if (x < width && y < height) {
        const size_t at = (size_t)y * (size_t)width + (size_t)x;
        rays.transmittance = transmittance[at];
        rays.last = last_contributor[at];
        rays.behind = with_left ? d_left[at] : 0.0f;
#pragma unroll
        for (int c = 0; c < ALL_CHANNELS; ++c) {
            rays.d[c] = d_image[at * (size_t)image_pitch + (size_t)(first + c)];
            rays.behind = fma(rays.d[c], background[first + c], rays.behind);
        }
    }
    const int begin = tile_range[tile], end = tile_range[tile + 1];
    for (int k = end - 1; k >= begin; --k) {
        __global const float *from = records + RECORD_SIZE * (size_t)k;
        PixelMoments m;
        for (int j = 0; j < MOMENT_CHANNEL; ++j)
            m.first[j] = 0.0f;
        m.weight = 0.0f;
        m.touched = (as_uint(from[RECORD_UNITS]) & unit) != 0;
        if (m.touched) {
            Record record;
            READ_RECORD(record, from);
            float value[ALL_CHANNELS];
            load_channels(&palette, gaussian[k], value);
            const Touch t = touch(&record, (float)x + 0.5f, (float)y + 0.5f, &constants);
            m.weight = unveil(&rays, &record, value, &t, k - begin + 1, m.first);
        }
        write_row(&m, rays.d, pixels, lanes,
                  rows + MOMENT_PITCH * (size_t)as_int(from[RECORD_ROW]));
    }
}
