/* The GPU form of blend: one work-group of TILE_PIXELS work-items a tile, one
 * pixel each. */
#ifndef CLGS_BLEND_GROUP_H
#define CLGS_BLEND_GROUP_H

/* Copies the records [begin, begin + BATCH) of the list that ends at end; one a
 * work-item. */
inline void stage_record(__local float *staged, __global const float *records, int k, int end)
{
    const int item = (int)get_local_id(0);
    if (k < end)
        for (int j = 0; j < RECORD_USED; ++j)
            staged[RECORD_USED * item + j] = records[RECORD_SIZE * (size_t)k + (size_t)j];
}

__kernel void blend_forward(__global const float *records, __global const int *tile_range,
                            __global const float *background, const int width, const int height,
                            __global float *image, __global float *transmittance,
                            __global int *last_contributor OBSERVE_PARAMETERS)
{
    __local float staged[RECORD_USED * BATCH];
    __local int open;
    const int tile = (int)get_group_id(0), item = (int)get_local_id(0);
    const int columns = (width + TILE_SIZE - 1) / TILE_SIZE;
    const int x = tile % columns * TILE_SIZE + item % TILE_SIZE;
    const int y = tile / columns * TILE_SIZE + item / TILE_SIZE;
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
            Paint paint;
            READ_PAINT(paint, staged + RECORD_USED * (k - begin));
            const Touch t = touch(&paint.splat, (float)x + 0.5f, (float)y + 0.5f, &constants);
            OBSERVE(k, item % TILE_SIZE, item / TILE_SIZE, blended_over(&p, &t), t.saturated);
            blend_over(&p, &e, &paint, &t, k - first + 1);
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

/* Sums over the work-group of ROUND entries at a time, in two steps with a fixed order: PARTS
 * partial sums of every moment, then these. */
#define ROUND 3
#define PARTS 8
#define ROUND_MOMENTS (ROUND * ROW_USED)
#define BACKWARD_BATCH (16 * ROUND) /* records staged at a time */

inline void store_moments(const Moments *m, int slot, __local float *values)
{
    const float own[ROW_USED] = {m->y1,  m->y2,    m->y11,  m->y12,  m->y22,
                                 m->red, m->green, m->blue, m->alpha};
    for (int j = 0; j < ROW_USED; ++j)
        values[TILE_PIXELS * (ROW_USED * slot + j) + (int)get_local_id(0)] = own[j];
}

/* Contains barriers; afterwards values may be written again. */
inline void reduce_moments(__local const float *values, __local float *parts,
                           __local const float *staged, int entries, __global float *rows)
{
    const int item = (int)get_local_id(0);
    barrier(CLK_LOCAL_MEM_FENCE);
    if (item < ROUND_MOMENTS * PARTS) {
        float sum = 0.0f;
        for (int i = item % PARTS; i < TILE_PIXELS; i += PARTS)
            sum += values[TILE_PIXELS * (item / PARTS) + i];
        parts[item] = sum;
    }
    barrier(CLK_LOCAL_MEM_FENCE);
    if (item < entries * ROW_USED) {
        float sum = 0.0f;
        for (int i = 0; i < PARTS; ++i)
            sum += parts[PARTS * item + i];
        const int row = as_int(staged[RECORD_USED * (item / ROW_USED) + RECORD_ROW]);
        rows[ROW_SIZE * (size_t)row + (size_t)(item % ROW_USED)] = sum;
    }
}

inline Rays load_ray(__global const float *background, __global const float *transmittance,
                     __global const int *last_contributor, __global const float *d_image, size_t at,
                     size_t plane)
{
    Rays p;
    p.transmittance = transmittance[at];
    p.d_red = d_image[at];
    p.d_green = d_image[at + plane];
    p.d_blue = d_image[at + 2 * plane];
    p.behind = fma(p.d_red, background[0], fma(p.d_green, background[1], p.d_blue * background[2]));
    p.last = last_contributor[at];
    return p;
}

/* Copies `count` records from the one before stop on, backwards; one a work-item. */
inline void stage_backwards(__local float *staged, __global const float *records, int stop,
                            int count)
{
    const int item = (int)get_local_id(0);
    if (item < count)
        for (int j = 0; j < RECORD_USED; ++j)
            staged[RECORD_USED * item + j] =
                records[RECORD_SIZE * (size_t)(stop - 1 - item) + (size_t)j];
}

__kernel void blend_backward(__global const float *records, __global const int *tile_range,
                             __global const float *background, const int width, const int height,
                             __global const float *transmittance,
                             __global const int *last_contributor, __global const float *d_image,
                             __global float *rows OBSERVE_PARAMETERS)
{
    __local float staged[RECORD_USED * BACKWARD_BATCH];
    __local float values[ROUND_MOMENTS * TILE_PIXELS];
    __local float parts[ROUND_MOMENTS * PARTS];
    __local int tile_last;
    const int tile = (int)get_group_id(0), item = (int)get_local_id(0);
    const int columns = (width + TILE_SIZE - 1) / TILE_SIZE;
    const int x = tile % columns * TILE_SIZE + item % TILE_SIZE;
    const int y = tile / columns * TILE_SIZE + item / TILE_SIZE;
    const TouchConstants constants = touch_constants(0);
    Rays p = {1.0f, 0.0f, 0.0f, 0.0f, 0.0f, 0};
    if (x < width && y < height)
        p = load_ray(background, transmittance, last_contributor, d_image,
                     (size_t)y * (size_t)width + (size_t)x, (size_t)width * (size_t)height);
    if (item == 0)
        tile_last = 0;
    barrier(CLK_LOCAL_MEM_FENCE);
    atomic_max(&tile_last, p.last);
    barrier(CLK_LOCAL_MEM_FENCE);
    const int first = tile_range[tile], end = tile_range[tile + 1];
    /* an empty list may be that of another group of tiles, whose pixels have contributors */
    const int lit = SKIP_CONTRIBUTORS ? min(first + tile_last, end) : end;
    for (int k = end - 1; k >= lit; --k)
        if (item < ROW_USED)
            rows[ROW_SIZE * (size_t)as_int(records[RECORD_SIZE * (size_t)k + RECORD_ROW]) +
                 (size_t)item] = 0.0f;
    /* back to front: entry `stop - 1 - i` is staged at place i */
    for (int stop = lit; stop > first; stop -= BACKWARD_BATCH) {
        const int batch = min(stop - first, BACKWARD_BATCH);
        barrier(CLK_LOCAL_MEM_FENCE);
        stage_backwards(staged, records, stop, batch);
        barrier(CLK_LOCAL_MEM_FENCE);
        for (int i = 0; i < batch; i += ROUND) {
            const int entries = min(batch - i, ROUND);
            for (int slot = 0; slot < entries; ++slot) {
                const int k = stop - 1 - i - slot;
                Paint paint;
                READ_PAINT(paint, staged + RECORD_USED * (i + slot));
                Moments m = {0.0f, 0.0f, 0.0f, 0.0f, 0.0f, 0.0f, 0.0f, 0.0f, 0.0f};
                const Touch t = touch(&paint.splat, (float)x + 0.5f, (float)y + 0.5f, &constants);
                const iv taken = blend_back(&p, &paint, &t, k - first + 1, &m);
                OBSERVE(k, item % TILE_SIZE, item / TILE_SIZE, taken, t.saturated);
                store_moments(&m, slot, values);
            }
            reduce_moments(values, parts, staged + RECORD_USED * i, entries, rows);
        }
    }
}

#endif
