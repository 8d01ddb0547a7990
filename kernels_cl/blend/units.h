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
#else
#define LANE_X                                                                                     \
    ((float16)(0.5f, 1.5f, 2.5f, 3.5f, 0.5f, 1.5f, 2.5f, 3.5f, 0.5f, 1.5f, 2.5f, 3.5f, 0.5f, 1.5f, \
               2.5f, 3.5f))
#define LANE_Y                                                                                     \
    ((float16)(0.5f, 0.5f, 0.5f, 0.5f, 1.5f, 1.5f, 1.5f, 1.5f, 2.5f, 2.5f, 2.5f, 2.5f, 3.5f, 3.5f, \
               3.5f, 3.5f))
#endif

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

/* VEC ellipses, see Ellipses; centres relative to the tile. */
typedef struct {
    fv x, y, slope, squared, shrink;
} TileEllipses;

/* Columns of units, four bits, that ellipses touch in a row of units; the first is the highest bit.
 */
static inline iv touched_columns(const TileEllipses *e, const int unit_row)
{
    const fv width = (fv)((float)TILE_SIZE), zero = (fv)(0.0f);
    fv low = width, high = zero;
    for (int row = 0; row < UNIT_HEIGHT; ++row) {
        const fv dy = ((float)(UNIT_HEIGHT * unit_row) + 0.5f) + ((float)row - e->y);
        const fv rest = fma(-e->shrink * dy, dy, e->squared);
        const fv radius = sqrt(rest);
        const fv middle = fma(e->slope, dy, e->x);
        const fv reach = fma(radius + fabs(middle), (fv)(1e-6f), radius + 1e-3f);
        const fv left = middle - reach, right = middle + reach;
        const iv none = rest < zero;
        /* phrased so that a NaN spans the row */
        const fv bound_left = none ? width : (left > zero ? left : zero);
        const fv bound_right = none ? zero : (right < width ? right : width);
        low = bound_left < low ? bound_left : low;
        high = bound_right > high ? bound_right : high;
    }
    const float scale = 1.0f / UNIT_WIDTH;
    const iv first = TO_IV((low + 0.5f) * scale);
    const iv end = TO_IV((high + (UNIT_WIDTH - 0.5f)) * scale);
    const iv bits = ((iv)(16) >> first) - ((iv)(16) >> end);
    return end > first ? bits : (iv)(0);
}

/* Units that ellipses touch. Of a number that is not finite, all. A little too large, so that
 * rounding never loses a pixel. */
static inline iv touched_units(const TileEllipses *e)
{
    iv units = (iv)(0);
    for (int row = 0; row < UNIT_ROWS; ++row)
        units |= touched_columns(e, row) << (28 - 4 * row);
    return units;
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
