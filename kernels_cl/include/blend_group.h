/* The GPU form of blend: one work-group of TILE_PIXELS work-items a tile, one pixel each. */
#ifndef CLGS_BLEND_GROUP_H
#define CLGS_BLEND_GROUP_H

/* Copies the records [begin, begin + BATCH) of the list that ends at end; one a work-item. */
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
    Pixels p = {inside ? 1.0f : -1.0f, 0.0f, 0.0f, 0.0f, 0};
    const int first = tile_range[tile], end = tile_range[tile + 1];
    for (int begin = first; begin < end; begin += BATCH) {
        if (item == 0)
            open = 0;
        barrier(CLK_LOCAL_MEM_FENCE);
        if (p.transmittance > 0.0f)
            atomic_or(&open, 1);
        stage_record(staged, records, begin + item, end);
        barrier(CLK_LOCAL_MEM_FENCE);
        if (!open) /* the same for all work-items */
            break;
        const int stop = end - begin < BATCH ? end : begin + BATCH;
        for (int k = begin; k < stop; ++k) {
            Paint paint;
            READ_PAINT(paint, staged + RECORD_USED * (k - begin));
            const Touch t = touch(&paint.splat, (float)x + 0.5f, (float)y + 0.5f);
            const iv taken = blend_over(&p, &paint, &t, k - first + 1);
            OBSERVE(k, item % TILE_SIZE, item / TILE_SIZE, taken, t.saturated);
        }
        barrier(CLK_LOCAL_MEM_FENCE);
    }
    if (inside) {
        const size_t at = (size_t)y * (size_t)width + (size_t)x;
        const size_t plane = (size_t)width * (size_t)height;
        const float rest = fabs(p.transmittance);
        image[at] = fma(rest, background[0], p.red);
        image[at + plane] = fma(rest, background[1], p.green);
        image[at + 2 * plane] = fma(rest, background[2], p.blue);
        transmittance[at] = rest;
        last_contributor[at] = p.last;
    }
}

/* Sums over the work-group in two steps: work-items 0..9*PARTS-1 first, then 0..8. */
#define PARTS 16
#define PART_SIZE (TILE_PIXELS / PARTS)

inline void reduce_moments(const Moments *m, __local float *values, __local float *parts,
                           __global float *row)
{
    const int item = (int)get_local_id(0);
    const float own[ROW_USED] = {m->y1,  m->y2,    m->y11,  m->y12,  m->y22,
                                 m->red, m->green, m->blue, m->alpha};
    for (int j = 0; j < ROW_USED; ++j)
        values[TILE_PIXELS * j + item] = own[j];
    barrier(CLK_LOCAL_MEM_FENCE);
    if (item < ROW_USED * PARTS) {
        float sum = 0.0f;
        for (int i = 0; i < PART_SIZE; ++i)
            sum += values[TILE_PIXELS * (item / PARTS) + item % PARTS + PARTS * i];
        parts[item] = sum;
    }
    barrier(CLK_LOCAL_MEM_FENCE);
    if (item < ROW_USED) {
        float sum = 0.0f;
        for (int i = 0; i < PARTS; ++i)
            sum += parts[PARTS * item + i];
        row[item] = sum;
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

__kernel void blend_backward(__global const float *records, __global const int *tile_range,
                             __global const float *background, const int width, const int height,
                             __global const float *transmittance,
                             __global const int *last_contributor, __global const float *d_image,
                             __global float *rows OBSERVE_PARAMETERS)
{
    __local float staged[RECORD_USED];
    __local float values[ROW_USED * TILE_PIXELS];
    __local float parts[ROW_USED * PARTS];
    __local int tile_last;
    const int tile = (int)get_group_id(0), item = (int)get_local_id(0);
    const int columns = (width + TILE_SIZE - 1) / TILE_SIZE;
    const int x = tile % columns * TILE_SIZE + item % TILE_SIZE;
    const int y = tile / columns * TILE_SIZE + item / TILE_SIZE;
    Rays p = {1.0f, 0.0f, 0.0f, 0.0f, 0.0f, 0};
    if (x < width && y < height)
        p = load_ray(background, transmittance, last_contributor, d_image,
                     (size_t)y * (size_t)width + (size_t)x, (size_t)width * (size_t)height);
    if (item == 0)
        tile_last = 0;
    barrier(CLK_LOCAL_MEM_FENCE);
    atomic_max(&tile_last, p.last);
    barrier(CLK_LOCAL_MEM_FENCE);
    const int first = tile_range[tile], lit = first + tile_last;
    for (int k = tile_range[tile + 1] - 1; k >= lit; --k)
        if (item < ROW_USED)
            rows[ROW_SIZE * (size_t)as_int(records[RECORD_SIZE * (size_t)k + RECORD_ROW]) +
                 (size_t)item] = 0.0f;
    for (int k = lit - 1; k >= first; --k) {
        if (item < RECORD_USED)
            staged[item] = records[RECORD_SIZE * (size_t)k + (size_t)item];
        barrier(CLK_LOCAL_MEM_FENCE);
        Paint paint;
        READ_PAINT(paint, staged);
        const int row = as_int(staged[RECORD_ROW]);
        Moments m = {0.0f, 0.0f, 0.0f, 0.0f, 0.0f, 0.0f, 0.0f, 0.0f, 0.0f};
        const Touch t = touch(&paint.splat, (float)x + 0.5f, (float)y + 0.5f);
        const iv taken = blend_back(&p, &paint, &t, k - first + 1, &m);
        OBSERVE(k, item % TILE_SIZE, item / TILE_SIZE, taken, t.saturated);
        reduce_moments(&m, values, parts, rows + ROW_SIZE * (size_t)row);
    }
}

#endif
