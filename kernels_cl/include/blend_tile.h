/* The CPU form of blend: one work-item a tile, its pixels in private memory. */
#ifndef CLGS_BLEND_TILE_H
#define CLGS_BLEND_TILE_H

/* Units with a pixel that is not finished. */
inline uint open_units(const Pixels *pixels)
{
    uint open = 0;
    for (int u = 0; u < UNITS; ++u)
        open |= sum_v(fmax(pixels[u].transmittance, (fv)(0.0f))) > 0.0f ? 1u << u : 0u;
    return open;
}

inline iv inside_image(int x, int y, int width, int height)
{
    return ((LANE_X + (float)x) < (fv)((float)width)) & ((LANE_Y + (float)y) < (fv)((float)height));
}

inline void blend_forward_entry(Pixels *pixels, uint open, __global const float *record, int x,
                                int y, int entry, int number OBSERVE_PARAMETERS)
{
    Paint paint;
    READ_PAINT(paint, record);
    uint units = as_uint(record[RECORD_UNITS]) & open;
    while (units) {
        const int u = take_unit(&units);
        const Touch t =
            touch(&paint.splat, LANE_X + (float)(x + unit_x(u)), LANE_Y + (float)(y + unit_y(u)));
        const iv taken = blend_over(&pixels[u], &paint, &t, number);
        OBSERVE(entry, unit_x(u), unit_y(u), taken, t.saturated);
    }
}

__kernel void blend_forward(__global const float *records, __global const int *tile_range,
                            __global const float *background, const int width, const int height,
                            __global float *image, __global float *transmittance,
                            __global int *last_contributor OBSERVE_PARAMETERS)
{
    const int tile = (int)get_global_id(0);
    const int columns = (width + TILE_SIZE - 1) / TILE_SIZE;
    const int x = tile % columns * TILE_SIZE, y = tile / columns * TILE_SIZE;
    Pixels pixels[UNITS];
    for (int u = 0; u < UNITS; ++u) {
        const iv inside = inside_image(x + unit_x(u), y + unit_y(u), width, height);
        pixels[u].transmittance = inside ? (fv)(1.0f) : (fv)(-1.0f);
        pixels[u].red = pixels[u].green = pixels[u].blue = (fv)(0.0f);
        pixels[u].last = (iv)(0);
    }
    const int first = tile_range[tile], end = tile_range[tile + 1];
    uint open = open_units(pixels);
    for (int begin = first; begin < end && open; begin += OPEN_CHECK) {
        const int stop = end - begin < OPEN_CHECK ? end : begin + OPEN_CHECK;
        for (int k = begin; k < stop; ++k)
            blend_forward_entry(pixels, open, records + RECORD_SIZE * (size_t)k, x, y, k,
                                k - first + 1 OBSERVE_ARGUMENTS);
        open = open_units(pixels);
    }
    const size_t plane = (size_t)width * (size_t)height;
    for (int u = 0; u < UNITS; ++u) {
        const Pixels p = pixels[u];
        const fv rest = fabs(p.transmittance);
        const int ux = x + unit_x(u), uy = y + unit_y(u);
        store_unit(fma(rest, (fv)(background[0]), p.red), image, ux, uy, width, height);
        store_unit(fma(rest, (fv)(background[1]), p.green), image + plane, ux, uy, width, height);
        store_unit(fma(rest, (fv)(background[2]), p.blue), image + 2 * plane, ux, uy, width,
                   height);
        store_unit(rest, transmittance, ux, uy, width, height);
        store_unit(AS_FV(p.last), (__global float *)last_contributor, ux, uy, width, height);
    }
}

/* Largest lane. */
inline int max_lane(iv values)
{
    int lane[VEC];
    STORE_V(values, 0, lane);
    int largest = lane[0];
    for (int i = 1; i < VEC; ++i)
        largest = lane[i] > largest ? lane[i] : largest;
    return largest;
}

inline void store_moments(const Moments *m, __global float *row)
{
    vstore4(sum_v4(m->y1, m->y2, m->y11, m->y12), 0, row);
    vstore4(sum_v4(m->y22, m->red, m->green, m->blue), 1, row);
    row[8] = sum_v(m->alpha);
}

__kernel void blend_backward(__global const float *records, __global const int *tile_range,
                             __global const float *background, const int width, const int height,
                             __global const float *transmittance,
                             __global const int *last_contributor, __global const float *d_image,
                             __global float *rows OBSERVE_PARAMETERS)
{
    const int tile = (int)get_global_id(0);
    const int columns = (width + TILE_SIZE - 1) / TILE_SIZE;
    const int x = tile % columns * TILE_SIZE, y = tile / columns * TILE_SIZE;
    const size_t plane = (size_t)width * (size_t)height;
    Rays rays[UNITS];
    int unit_last[UNITS];
    int tile_last = 0;
    for (int u = 0; u < UNITS; ++u) {
        const int ux = x + unit_x(u), uy = y + unit_y(u);
        rays[u].transmittance = load_unit(transmittance, ux, uy, width, height);
        rays[u].d_red = load_unit(d_image, ux, uy, width, height);
        rays[u].d_green = load_unit(d_image + plane, ux, uy, width, height);
        rays[u].d_blue = load_unit(d_image + 2 * plane, ux, uy, width, height);
        rays[u].last =
            AS_IV(load_unit((__global const float *)last_contributor, ux, uy, width, height));
        rays[u].behind =
            fma(rays[u].d_red, (fv)(background[0]),
                fma(rays[u].d_green, (fv)(background[1]), rays[u].d_blue * background[2]));
        unit_last[u] = max_lane(rays[u].last);
        tile_last = max(tile_last, unit_last[u]);
    }
    const int first = tile_range[tile];
    const Moments zero = {(fv)(0.0f), (fv)(0.0f), (fv)(0.0f), (fv)(0.0f), (fv)(0.0f),
                          (fv)(0.0f), (fv)(0.0f), (fv)(0.0f), (fv)(0.0f)};
    for (int k = tile_range[tile + 1] - 1; k >= first; --k) {
        __global const float *record = records + RECORD_SIZE * (size_t)k;
        const int number = k - first + 1;
        uint units = number <= tile_last ? as_uint(record[RECORD_UNITS]) : 0u;
        Paint paint;
        READ_PAINT(paint, record);
        Moments m = zero;
        while (units) {
            const int u = take_unit(&units);
            if (number > unit_last[u])
                continue;
            const Touch t = touch(&paint.splat, LANE_X + (float)(x + unit_x(u)),
                                  LANE_Y + (float)(y + unit_y(u)));
            const iv taken = blend_back(&rays[u], &paint, &t, number, &m);
            OBSERVE(k, unit_x(u), unit_y(u), taken, t.saturated);
        }
        store_moments(&m, rows + ROW_SIZE * (size_t)as_int(record[RECORD_ROW]));
    }
}

#endif
