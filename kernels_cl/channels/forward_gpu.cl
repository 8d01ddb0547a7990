/* Blend the records of every tile front to back into pictures of any number of channels, GPU form.
 *
 * A work-group owns a tile, each of its TILE_SIZE^2 work-items a pixel; 16 neighbouring ones are a
 * unit, which passes over records that do not touch it. Local memory holds BATCH records, which the
 * work-items load together. Launch size: tiles * TILE_SIZE^2, from `first_tile` on. */
#include "blend/record.h"
#include "blend/touch.h"
#include "blend/units.h"
#include "channels/layout.h"
#include "channels/veil.h"
#include "common/tile_size.h"

#define BATCH TILE_PIXELS /* records staged at a time, one per work-item */

/* background: (image_pitch,); image: (height, width, image_pitch). */
TILE_GROUP __kernel void
channels_forward(__global const float *records, __global const int *gaussian,
                 __global const int *tile_range, const int first_tile, __global const float *color,
                 __global const float *depth, const int first, const int pitch,
                 __global const float *background, const int width, const int height,
                 const int image_pitch, __global float *image, __global float *transmittance,
                 __global float *alpha, __global int *last_contributor)
{
    __local float staged[RECORD_USED * BATCH];
    __local int owner[BATCH];
    __local int open;
    const int tile = first_tile + (int)get_group_id(0), item = (int)get_local_id(0);
    const int columns = tiles_across(width);
    const int x = tile % columns * TILE_SIZE + pixel_x(item);
    const int y = tile / columns * TILE_SIZE + pixel_y(item);
    const uint unit = unit_bit(item / UNIT_SIZE);
    const bool inside = x < width && y < height;
    const TouchConstants constants = touch_constants(0);
    const Palette palette = {color, depth, first, pitch};
    Veil veil;
    float channel[ALL_CHANNELS];
    start_veil(&veil, inside);
    for (int c = 0; c < ALL_CHANNELS; ++c)
        channel[c] = 0.0f;
    const int begin = tile_range[tile], end = tile_range[tile + 1];
    for (int from = begin; from < end; from += BATCH) {
        if (item == 0)
            open = 0;
        barrier(CLK_LOCAL_MEM_FENCE);
        if (veil.stop > 0.0f)
            atomic_or(&open, 1);
        if (from + item < end) {
            for (int j = 0; j < RECORD_USED; ++j)
                staged[RECORD_USED * item + j] =
                    records[RECORD_SIZE * (size_t)(from + item) + (size_t)j];
            owner[item] = gaussian[from + item];
        }
        barrier(CLK_LOCAL_MEM_FENCE);
        if (!open) /* the same for all work-items */
            break;
        for (int i = 0; i < min(BATCH, end - from); ++i) {
            __local const float *own = staged + RECORD_USED * i;
            if (!(as_uint(own[RECORD_UNITS]) & unit))
                continue;
            Record record;
            READ_RECORD(record, own);
            const Touch t = touch(&record, (float)x + 0.5f, (float)y + 0.5f, &constants);
            int stops;
            const float weight = veil_over(&veil, &t, from + i - begin + 1, &stops);
            if (weight == 0.0f)
                continue;
            float value[ALL_CHANNELS];
            load_channels(&palette, owner[i], value);
            for (int c = 0; c < ALL_CHANNELS; ++c)
                channel[c] = fma(weight, value[c], channel[c]);
        }
        barrier(CLK_LOCAL_MEM_FENCE);
    }
    if (inside) {
        const size_t at = (size_t)y * (size_t)width + (size_t)x;
        int last;
        const float rest = veil_rest(&veil, end - begin, &last);
        transmittance[at] = rest;
        alpha[at] = 1.0f - rest;
        last_contributor[at] = last;
        for (int c = 0; c < ALL_CHANNELS; ++c)
            image[at * (size_t)image_pitch + (size_t)(first + c)] =
                fma(rest, background[first + c], channel[c]);
    }
}
