/* Blend the records of every tile front to back into pictures of any number of channels, CPU form.
 *
 * A work-item owns a tile: its pixels lie in private memory, cut into units of VEC lanes, and the
 * records of its list pass by as a stream. Work-groups of one work-item; launch size: the number of
 * tiles, from `first_tile` on. No local memory. */
#include "blend/pixels.h"
#include "blend/record.h"
#include "blend/touch.h"
#include "blend/units.h"
#include "channels/layout.h"
#include "channels/veil.h"
#include "common/prefetch.h"
#include "common/real.h"
#include "common/tile_size.h"

#define COLORS_AHEAD 8

/* A unit of pixels, their centres and channels. */
typedef struct {
    Veil veil;
    fv x, y;
    fv channel[ALL_CHANNELS];
} ChannelUnit;

/* Writes a unit of pixels at (x, y) of the tile's picture. */
static inline void store_channels(const ChannelUnit *unit, __global const float *background,
                                  const int entries, const int x, const int y, const int width,
                                  const int height, const int first, const int pitch,
                                  __global float *image, __global float *transmittance,
                                  __global float *alpha, __global int *last_contributor)
{
    iv last;
    const fv rest = veil_rest(&unit->veil, entries, &last);
    store_unit(rest, transmittance, x, y, width, height);
    store_unit(1.0f - rest, alpha, x, y, width, height);
    store_unit(AS_FV(last), (__global float *)last_contributor, x, y, width, height);
    for (int c = 0; c < ALL_CHANNELS; ++c) {
        float lane[VEC];
        STORE_V(fma(rest, (fv)(background[first + c]), unit->channel[c]), 0, lane);
        for (int i = 0; i < VEC; ++i) {
            const int column = x + i % UNIT_WIDTH, row = y + i / UNIT_WIDTH;
            const size_t at = (size_t)row * (size_t)width + (size_t)column;
            if (column < width && row < height)
                image[at * (size_t)pitch + (size_t)(first + c)] = lane[i];
        }
    }
}

/* background: (image_pitch,); image: (height, width, image_pitch). */
__kernel void channels_forward(__global const float *records, __global const int *gaussian,
                               __global const int *tile_range, const int first_tile,
                               __global const float *color, __global const float *depth,
                               const int first, const int pitch, __global const float *background,
                               const int width, const int height, const int image_pitch,
                               __global float *image, __global float *transmittance,
                               __global float *alpha, __global int *last_contributor)
{
    const int tile = first_tile + (int)get_global_id(0);
    const int columns = tiles_across(width);
    const int x = tile % columns * TILE_SIZE, y = tile / columns * TILE_SIZE;
    const int begin = tile_range[tile], end = tile_range[tile + 1];
    const TouchConstants constants = touch_constants(width >> 31);
    const Palette palette = {color, depth, first, pitch};
    ChannelUnit units[UNITS];
    uint open = 0;
    for (int u = 0; u < UNITS; ++u) {
        const fv ux = LANE_X + (float)(x + unit_x(u)), uy = LANE_Y + (float)(y + unit_y(u));
        const iv inside = (ux < (fv)((float)width)) & (uy < (fv)((float)height));
        units[u].x = ux;
        units[u].y = uy;
        start_veil(&units[u].veil, inside);
        for (int c = 0; c < ALL_CHANNELS; ++c)
            units[u].channel[c] = (fv)(0.0f);
        open |= any_lane(inside) ? unit_bit(u) : 0u;
    }
    for (int k = begin; k < end && open; ++k) {
        __global const float *from = records + RECORD_SIZE * (size_t)k;
        PREFETCH(color + (size_t)pitch * (size_t)gaussian[min(k + COLORS_AHEAD, end - 1)]);
        uint left = as_uint(from[RECORD_UNITS]) & open;
        if (!left)
            continue;
        Record record;
        READ_RECORD(record, from);
        float value[ALL_CHANNELS];
        load_channels(&palette, gaussian[k], value);
        while (left) {
            const int u = take_unit(&left);
            const Touch t = touch(&record, units[u].x, units[u].y, &constants);
            iv stops;
            const fv weight = veil_over(&units[u].veil, &t, k - begin + 1, &stops);
            for (int c = 0; c < ALL_CHANNELS; ++c)
                units[u].channel[c] = fma(weight, (fv)(value[c]), units[u].channel[c]);
            if (any_lane(stops) && !any_lane(units[u].veil.stop > (fv)(0.0f)))
                open &= ~unit_bit(u);
        }
    }
    for (int u = 0; u < UNITS; ++u)
        store_channels(&units[u], background, end - begin, x + unit_x(u), y + unit_y(u), width,
                       height, first, image_pitch, image, transmittance, alpha, last_contributor);
}
