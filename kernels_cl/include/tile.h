/* How the pixels of a tile are cut into units of VEC lanes: 4 pixels wide, VEC/4 high on a CPU
 * (small Gaussians touch fewer such blocks than rows), one pixel on a GPU. A tile has at most 32
 * units, so that a set of them is the bits of a uint. */
#ifndef CLGS_TILE_H
#define CLGS_TILE_H

#include "include/real.h"

#ifndef TILE_SIZE
#define TILE_SIZE 16
#endif
#define TILE_PIXELS (TILE_SIZE * TILE_SIZE)

#if VEC == 1

inline float sum_v(float x)
{
    return x;
}

#else

#define UNIT_WIDTH 4
#define UNIT_HEIGHT (VEC / UNIT_WIDTH)
#define UNIT_COLUMNS (TILE_SIZE / UNIT_WIDTH)
#define UNIT_ROWS (TILE_SIZE / UNIT_HEIGHT)
#define UNITS (UNIT_COLUMNS * UNIT_ROWS)

#if VEC == 8
#define LANE_X ((float8)(0.5f, 1.5f, 2.5f, 3.5f, 0.5f, 1.5f, 2.5f, 3.5f))
#define LANE_Y ((float8)(0.5f, 0.5f, 0.5f, 0.5f, 1.5f, 1.5f, 1.5f, 1.5f))
#define FIRST_COLUMN_UNITS 0x11111111u
#elif VEC == 16
#define LANE_X                                                                                     \
    ((float16)(0.5f, 1.5f, 2.5f, 3.5f, 0.5f, 1.5f, 2.5f, 3.5f, 0.5f, 1.5f, 2.5f, 3.5f, 0.5f, 1.5f, \
               2.5f, 3.5f))
#define LANE_Y                                                                                     \
    ((float16)(0.5f, 0.5f, 0.5f, 0.5f, 1.5f, 1.5f, 1.5f, 1.5f, 2.5f, 2.5f, 2.5f, 2.5f, 3.5f, 3.5f, \
               3.5f, 3.5f))
#define FIRST_COLUMN_UNITS 0x1111u
#endif

inline int unit_x(int unit)
{
    return unit % UNIT_COLUMNS * UNIT_WIDTH;
}

inline int unit_y(int unit)
{
    return unit / UNIT_COLUMNS * UNIT_HEIGHT;
}

/* Units that hold pixels of a box of the tile: first column and row, last column and row. */
inline uint units_of(int4 box)
{
    const bool some = (box.x <= box.z) & (box.y <= box.w);
    /* vector bounds: Oclgrind 21.10 reads the scalar ones of an integer clamp past their end */
    const int4 inside = clamp(box, (int4)(0), (int4)(TILE_SIZE - 1));
    const uint columns = (2u << (inside.z / UNIT_WIDTH)) - (1u << (inside.x / UNIT_WIDTH));
    const uint below = UNIT_COLUMNS * (uint)(inside.y / UNIT_HEIGHT);
    const uint above = UNIT_COLUMNS * (uint)(UNIT_ROWS - 1 - inside.w / UNIT_HEIGHT);
    const uint rows = (FIRST_COLUMN_UNITS << below) & (FIRST_COLUMN_UNITS >> above);
    return some ? columns * rows : 0u;
}

/* Removes the highest unit of a non-empty set and returns it. */
inline int take_unit(uint *units)
{
    const int unit = 31 - (int)clz(*units);
    *units ^= 1u << unit;
    return unit;
}

inline float sum8(float8 x)
{
    const float4 four = x.lo + x.hi;
    const float2 pair = four.lo + four.hi;
    return pair.x + pair.y;
}

/* (sum of a, b, c, d), as a tree over the lanes. */
inline float4 sum8x4(float8 a, float8 b, float8 c, float8 d)
{
    const float4 p = a.lo + a.hi, q = b.lo + b.hi, r = c.lo + c.hi, s = d.lo + d.hi;
    const float4 even = (float4)(p.x, q.x, r.x, s.x) + (float4)(p.z, q.z, r.z, s.z);
    const float4 odd = (float4)(p.y, q.y, r.y, s.y) + (float4)(p.w, q.w, r.w, s.w);
    return even + odd;
}

#if VEC == 8
#define FOLD_TO_8(x) (x)
#else
#define FOLD_TO_8(x) ((x).lo + (x).hi)
#endif

inline float sum_v(fv x)
{
    return sum8(FOLD_TO_8(x));
}

inline float4 sum_v4(fv a, fv b, fv c, fv d)
{
    return sum8x4(FOLD_TO_8(a), FOLD_TO_8(b), FOLD_TO_8(c), FOLD_TO_8(d));
}

/* The pixels of a unit at (x, y) of an image; those outside of it read as zero. */
inline fv load_unit(__global const float *plane, int x, int y, int width, int height)
{
    float lane[VEC];
    for (int i = 0; i < VEC; ++i) {
        const int column = x + i % UNIT_WIDTH, row = y + i / UNIT_WIDTH;
        const bool inside = column < width && row < height;
        lane[i] = inside ? plane[(size_t)row * (size_t)width + (size_t)column] : 0.0f;
    }
    return LOAD_V(0, lane);
}

inline void store_unit(fv value, __global float *plane, int x, int y, int width, int height)
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
