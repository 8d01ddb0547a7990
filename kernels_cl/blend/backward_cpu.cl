/* Gradients of the blending, CPU form: back to front with T / (1 - alpha) and one scalar per pixel,
 * the colour behind the record dotted with d_image. Every entry of a list writes one row of moments
 * to a place of its own, and sums.cl adds the rows of each Gaussian: no atomics, the same bits in
 * every run.
 *
 * A work-item owns a tile: its pixels lie in private memory, cut into units of VEC lanes, and it
 * writes a row per entry of its list. Work-groups of one work-item; launch size: the number of
 * tiles. No local memory. */
#include "blend/moments.h"
#include "blend/observe.h"
#include "blend/rays.h"
#include "blend/record.h"
#include "blend/touch.h"
#include "blend/units.h"
#include "common/lanes.h"
#include "common/prefetch.h"
#include "common/real.h"
#include "common/tile_size.h"

/* Largest lane. */
static inline int max_lane(iv values)
{
    int lane[VEC];
    STORE_V(values, 0, lane);
    int largest = lane[0];
    for (int i = 1; i < VEC; ++i)
        largest = lane[i] > largest ? lane[i] : largest;
    return largest;
}

/* A unit of pixels on the way back, and their centres. */
typedef struct {
    Rays rays;
    fv x, y;
} RayUnit;

/* Rows of neighbouring entries lie far apart: without this every write waits for its cache line. */
#define ROWS_AHEAD 8
static inline void fetch_row(__global const float *rows, __global const float *records,
                             const int entry)
{
    __global const float *record = records + RECORD_SIZE * (size_t)entry;
    PREFETCH_WRITE(rows + ROW_SIZE * (size_t)as_int(record[RECORD_ROW]));
}

#if SUM_PARTS == 2
#define WHOLE(part, name) ((part)[0].name + (part)[1].name)
#else
#define WHOLE(part, name) ((part)[0].name)
#endif

static inline void store_moments(const Moments part[SUM_PARTS], __global float *row)
{
    vstore4(lane_sums(WHOLE(part, y1), WHOLE(part, y2), WHOLE(part, y11), WHOLE(part, y12)), 0,
            row);
    vstore4(lane_sums(WHOLE(part, y22), WHOLE(part, red), WHOLE(part, green), WHOLE(part, blue)), 1,
            row);
    row[8] = lane_sum(WHOLE(part, alpha));
}

__kernel void blend_backward(__global const float *records, __global const int *tile_range,
                             __global const float *background, const int width, const int height,
                             __global const float *transmittance,
                             __global const int *last_contributor, __global const float *d_image,
                             __global float *rows OBSERVE_PARAMETERS)
{
    const int tile = (int)get_global_id(0);
    const int columns = tiles_across(width);
    const int x = tile % columns * TILE_SIZE, y = tile / columns * TILE_SIZE;
    const int first = tile_range[tile], end = tile_range[tile + 1];
    if (SKIP_EMPTY_TILES && first == end)
        return;
    const size_t plane = (size_t)width * (size_t)height;
    const TouchConstants constants = touch_constants(width >> 31);
    RayUnit units[UNITS];
    int unit_last[UNITS];
    int tile_last = 0;
    for (int u = 0; u < UNITS; ++u) {
        const int ux = x + unit_x(u), uy = y + unit_y(u);
        Rays *rays = &units[u].rays;
        units[u].x = LANE_X + (float)ux;
        units[u].y = LANE_Y + (float)uy;
        rays->transmittance = load_unit(transmittance, ux, uy, width, height);
        rays->d_red = load_unit(d_image, ux, uy, width, height);
        rays->d_green = load_unit(d_image + plane, ux, uy, width, height);
        rays->d_blue = load_unit(d_image + 2 * plane, ux, uy, width, height);
        rays->last =
            AS_IV(load_unit((__global const float *)last_contributor, ux, uy, width, height));
        rays->behind = fma(rays->d_red, (fv)(background[0]),
                           fma(rays->d_green, (fv)(background[1]), rays->d_blue * background[2]));
        unit_last[u] = SKIP_CONTRIBUTORS ? max_lane(rays->last) : end - first;
        tile_last = max(tile_last, unit_last[u]);
    }
    const Moments zero = {(fv)(0.0f), (fv)(0.0f), (fv)(0.0f), (fv)(0.0f), (fv)(0.0f),
                          (fv)(0.0f), (fv)(0.0f), (fv)(0.0f), (fv)(0.0f)};
    for (int k = end - 1; k >= first; --k) {
        __global const float *from = records + RECORD_SIZE * (size_t)k;
        const int number = k - first + 1;
        fetch_row(rows, records, max(k - ROWS_AHEAD, first));
        PREFETCH(from - 3 * ROWS_AHEAD * RECORD_SIZE);
        const uint touched = number <= tile_last ? as_uint(from[RECORD_UNITS]) : 0u;
        Record record;
        READ_RECORD(record, from);
        Moments part[SUM_PARTS];
        for (int i = 0; i < SUM_PARTS; ++i) {
            uint left = touched & UNITS_OF_PART(i);
            Moments m = zero;
            while (left) {
                const int u = take_unit(&left);
                if (number > unit_last[u])
                    continue;
                const Touch t = touch(&record, units[u].x, units[u].y, &constants);
                const iv taken = blend_back(&units[u].rays, &record, &t, number, &m);
                OBSERVE(k, unit_x(u), unit_y(u), taken, t.saturated);
            }
            part[i] = m;
        }
        store_moments(part, rows + ROW_SIZE * (size_t)as_int(from[RECORD_ROW]));
    }
}
