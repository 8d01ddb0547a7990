/* The pixels of a tile are cut into units, 4 pixels wide: small Gaussians touch fewer such blocks
 * than rows. In the CPU form they have VEC lanes, in the GPU form 16 work-items. A tile has at most
 * 32 units, so that a set of them is the bits of a uint. */
#ifndef CLGS_UNITS_H
#define CLGS_UNITS_H

#include "common/real.h"
#include "common/tile_size.h"

#ifndef SKIP_EMPTY_TILES
#define SKIP_EMPTY_TILES 1 /* see Skips in clgs/options.py */
#endif

#define UNIT_SIZE (VEC == 1 ? 16 : VEC)
#define UNIT_WIDTH 4
#define UNIT_HEIGHT (UNIT_SIZE / UNIT_WIDTH)
#define UNIT_COLUMNS (TILE_SIZE / UNIT_WIDTH)
#define UNIT_ROWS (TILE_SIZE / UNIT_HEIGHT)
#define UNITS (UNIT_COLUMNS * UNIT_ROWS)
#define ALL_UNITS (0xffffffffu << (32 - UNITS))

#if VEC == 8
#define LANE_X ((float8)(0.5f, 1.5f, 2.5f, 3.5f, 0.5f, 1.5f, 2.5f, 3.5f))
#define LANE_Y ((float8)(0.5f, 0.5f, 0.5f, 0.5f, 1.5f, 1.5f, 1.5f, 1.5f))
#define ROW_F float8
#define ROW_I int8
#define CONVERT_ROWS convert_int8
#define ROW_Y ((float8)(0.5f, 2.5f, 4.5f, 6.5f, 8.5f, 10.5f, 12.5f, 14.5f))
#define ROW_SHIFT ((int8)(28, 24, 20, 16, 12, 8, 4, 0))
#else
#define LANE_X                                                                                     \
    ((float16)(0.5f, 1.5f, 2.5f, 3.5f, 0.5f, 1.5f, 2.5f, 3.5f, 0.5f, 1.5f, 2.5f, 3.5f, 0.5f, 1.5f, \
               2.5f, 3.5f))
#define LANE_Y                                                                                     \
    ((float16)(0.5f, 0.5f, 0.5f, 0.5f, 1.5f, 1.5f, 1.5f, 1.5f, 2.5f, 2.5f, 2.5f, 2.5f, 3.5f, 3.5f, \
               3.5f, 3.5f))
#define ROW_F float4
#define ROW_I int4
#define CONVERT_ROWS convert_int4
#define ROW_Y ((float4)(0.5f, 4.5f, 8.5f, 12.5f))
#define ROW_SHIFT ((int4)(28, 24, 20, 16))
#endif

static inline uint or_rows(ROW_I rows)
{
#if VEC == 8
    const int4 four = rows.lo | rows.hi;
#else
    const int4 four = rows;
#endif
    const int2 pair = four.lo | four.hi;
    return (uint)(pair.x | pair.y);
}

static inline int unit_x(int unit)
{
    return (int)((uint)unit % UNIT_COLUMNS * UNIT_WIDTH);
}

static inline int unit_y(int unit)
{
    return (int)((uint)unit / UNIT_COLUMNS * UNIT_HEIGHT);
}

/* Pixel of a tile that belongs to a work-item of the GPU form: unit after unit. */
static inline int pixel_x(int item)
{
    return unit_x(item / UNIT_SIZE) + item % UNIT_WIDTH;
}

static inline int pixel_y(int item)
{
    return unit_y(item / UNIT_SIZE) + item % UNIT_SIZE / UNIT_WIDTH;
}

/* Units that an ellipse touches, its centre relative to the tile; see Ellipses. Of a number that is
 * not finite, all. A little too large, so that rounding never loses a pixel. */
static inline uint units_of(float2 centre, float slope, float squared, float shrink)
{
    const ROW_F width = (ROW_F)((float)TILE_SIZE);
    ROW_F low = width, high = (ROW_F)(0.0f);
    for (int row = 0; row < UNIT_HEIGHT; ++row) {
        const ROW_F dy = ROW_Y + (ROW_F)((float)row - centre.y);
        const ROW_F rest = fma((ROW_F)(-shrink) * dy, dy, (ROW_F)(squared));
        const ROW_F radius = sqrt(rest);
        const ROW_F middle = fma((ROW_F)(slope), dy, (ROW_F)(centre.x));
        const ROW_F reach = fma(radius + fabs(middle), (ROW_F)(1e-6f), radius + 1e-3f);
        const ROW_F left = middle - reach, right = middle + reach;
        const ROW_I none = rest < (ROW_F)(0.0f);
        /* phrased so that a NaN spans the row */
        const ROW_F bound_left = none ? width : (left > (ROW_F)(0.0f) ? left : (ROW_F)(0.0f));
        const ROW_F bound_right = none ? (ROW_F)(0.0f) : (right < width ? right : width);
        low = bound_left < low ? bound_left : low;
        high = bound_right > high ? bound_right : high;
    }
    const ROW_F scale = (ROW_F)(1.0f / UNIT_WIDTH);
    const ROW_I first = CONVERT_ROWS((low + (ROW_F)(0.5f)) * scale);
    const ROW_I end = CONVERT_ROWS((high + (ROW_F)(UNIT_WIDTH - 0.5f)) * scale);
    /* the first column is the highest of four bits */
    const ROW_I bits = ((ROW_I)(16) >> first) - ((ROW_I)(16) >> end);
    return or_rows((end > first ? bits : (ROW_I)(0)) << ROW_SHIFT);
}

/* Sets of units: unit 0 is the highest bit of a uint. */
static inline uint unit_bit(int unit)
{
    return 0x80000000u >> unit;
}

#if VEC > 1
/* Units whose pixels are the same lanes of 16: each second row of them if vectors have 8. */
#if VEC == 8
#define UNITS_OF_PART(part) ((part) == 0 ? 0xf0f0f0f0u : 0x0f0f0f0fu)
#else
#define UNITS_OF_PART(part) ALL_UNITS
#endif

/* Removes the first unit of a non-empty set and returns it. */
static inline int take_unit(uint *units)
{
    const int unit = (int)clz(*units);
    *units ^= unit_bit(unit);
    return unit;
}

/* The pixels of the unit at (x, y) of an image; those outside of it read as zero. */
static inline fv load_unit(__global const float *plane, int x, int y, int width, int height)
{
    float lane[VEC];
    for (int i = 0; i < VEC; ++i) {
        const int column = x + i % UNIT_WIDTH, row = y + i / UNIT_WIDTH;
        const bool inside = column < width && row < height;
        lane[i] = inside ? plane[(size_t)row * (size_t)width + (size_t)column] : 0.0f;
    }
    return LOAD_V(0, lane);
}

static inline void store_unit(fv value, __global float *plane, int x, int y, int width, int height)
{
    float lane[VEC];
    STORE_V(value, 0, lane);
    for (int i = 0; i < VEC; ++i) {
        const int column = x + i % UNIT_WIDTH, row = y + i / UNIT_WIDTH;
        if (column < width && row < height)
            plane[(size_t)row * (size_t)width + (size_t)column] = lane[i];
    }
}

#endif
#endif
