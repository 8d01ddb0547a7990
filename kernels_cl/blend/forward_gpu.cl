/* Blend the records of every tile front to back, GPU form.
 *
 *     color += alpha T c,  T *= 1 - alpha;  a pixel stops before T < TRANSMITTANCE_STOP.
 * touch.h computes alpha, pixels.h blends; rays.h and sums.cl take the derivatives.
 *
 * A work-group owns a tile, each of its TILE_SIZE^2 work-items a pixel; 16 neighbouring ones are a
 * unit, which passes over records that do not touch it. Local memory holds BATCH records, which the
 * work-items load together. Launch size: tiles * TILE_SIZE^2. */
#include "blend/observe.h"
#include "blend/pixels.h"
#include "blend/record.h"
#include "blend/touch.h"
#include "blend/units.h"
#include "common/tile_size.h"

#define BATCH 256 /* records staged at a time, one per work-item */

/* Copies record k to the place of this work-item, if the list does not end before it. */
static inline void stage_record(__local float *staged, __global const float *records, int k,
                                int end)
{
    const int item = (int)get_local_id(0);
    __global const float4 *record = (__global const float4 *)records + RECORD_SIZE / 4 * (size_t)k;
    if (k < end)
        for (int j = 0; j < RECORD_USED / 4; ++j)
            vstore4(record[j], (size_t)j, staged + RECORD_USED * item);
}

TILE_GROUP __kernel void blend_forward(__global const float *records,
                                       __global const int *tile_range,
                                       __global const float *background, const int width,
                                       const int height, __global float *image,
                                       __global float *transmittance,
                                       __global int *last_contributor OBSERVE_PARAMETERS)
{
    __local float staged[RECORD_USED * BATCH];
    __local int open;
    const int tile = (int)get_group_id(0), item = (int)get_local_id(0);
    const int columns = tiles_across(width);
    const int tile_x = pixel_x(item), tile_y = pixel_y(item);
    const int x = tile % columns * TILE_SIZE + tile_x, y = tile / columns * TILE_SIZE + tile_y;
    const uint unit = unit_bit(item / UNIT_SIZE);
    const bool inside = x < width && y < height;
    const TouchConstants constants = touch_constants(0);
    Pixels p;
    Ends e;
    start_pixels(&p, &e, inside);
    const int first = tile_range[tile], end = tile_range[tile + 1];
    for (int begin = first; begin < end; begin += BATCH) {
        if (item == 0)
            open = 0;
        barrier(CLK_LOCAL_MEM_FENCE);
        if (p.stop > 0.0f)
            atomic_or(&open, 1);
        stage_record(staged, records, begin + item, end);
        barrier(CLK_LOCAL_MEM_FENCE);
        if (SKIP_FINISHED && !open) /* the same for all work-items */
            break;
        const int stop = end - begin < BATCH ? end : begin + BATCH;
        for (int k = begin; k < stop; ++k) {
            __local const float *from = staged + RECORD_USED * (k - begin);
            if (!(as_uint(from[RECORD_UNITS]) & unit))
                continue;
            Record record;
            READ_RECORD(record, from);
            const Touch t = touch(&record, (float)x + 0.5f, (float)y + 0.5f, &constants);
            OBSERVE(k, tile_x, tile_y, blended_over(&p, &t), t.saturated);
            blend_over(&p, &e, &record, &t, k - first + 1);
        }
        barrier(CLK_LOCAL_MEM_FENCE);
    }
    if (inside) {
        const size_t at = (size_t)y * (size_t)width + (size_t)x;
        const size_t plane = (size_t)width * (size_t)height;
        const bool open_to_the_end = e.transmittance < 0.0f;
        const float rest = open_to_the_end ? p.transmittance : e.transmittance;
        image[at] = fma(rest, background[0], p.red);
        image[at + plane] = fma(rest, background[1], p.green);
        image[at + 2 * plane] = fma(rest, background[2], p.blue);
        transmittance[at] = rest;
        last_contributor[at] = open_to_the_end ? end - first : e.last;
    }
}
