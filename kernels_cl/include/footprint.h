/* Which tiles Gaussians reach, VEC Gaussians or VEC tiles at a time. */
#ifndef CLGS_FOOTPRINT_H
#define CLGS_FOOTPRINT_H

#include "include/rows.h"
#include "include/splat.h"

#ifndef SKIP_EXACT_TILES
#define SKIP_EXACT_TILES 1
#endif

/* What decides about the tiles of a Gaussian. */
typedef struct {
    __global const float *mean2d, *whitening, *opacity, *extent;
} Geometry;

/* Size of the image in pixels, and the rows of tiles that are wanted, [first, end). */
typedef struct {
    int width, height, first, end;
} Window;

/* VEC Gaussians: ellipses, a little too large (see reach_of), and the tiles of their boxes. */
typedef struct {
    fv x, y, r1, l, r2;
    fv squared;                  /* largest y1^2 + y2^2 */
    fv slope;                    /* dx / dy where y1^2 + y2^2 is smallest on a row of pixels */
    iv left, right, top, bottom; /* tiles; none where left > right */
} Footprints;

inline int columns_of(const Window w)
{
    return (w.width + TILE_SIZE - 1) / TILE_SIZE;
}

inline fv clamp_lanes(const fv x, const fv low, const fv high)
{
    const fv raised = x < low ? low : x;
    return raised > high ? high : raised;
}

/* As clamp_lanes, but a NaN becomes `low`. */
inline iv pixel_of(const fv x, const float low, const float high)
{
    const fv raised = x > (fv)(low) ? x : (fv)(low);
    return TO_IV(raised < (fv)(high) ? raised : (fv)(high));
}

/* First and last pixel whose centre lies in centre +- half_size, among [0, size). */
inline iv first_pixel(const fv centre, const fv half_size, const int size)
{
    return pixel_of(ceil(centre - half_size - 0.5f), 0.0f, (float)size);
}

inline iv last_pixel(const fv centre, const fv half_size, const int size)
{
    return -pixel_of(ceil(0.5f - centre - half_size), (float)(1 - size), 1.0f);
}

/* Tiles of the boxes; phrased so that a NaN has none. */
inline Footprints add_boxes(Footprints f, const fv half_x, const fv half_y, const iv drawn,
                            const Window w)
{
    const iv left = first_pixel(f.x, half_x, w.width), right = last_pixel(f.x, half_x, w.width);
    const iv top = first_pixel(f.y, half_y, w.height), bottom = last_pixel(f.y, half_y, w.height);
    const iv some = drawn & (left <= right) & (top <= bottom);
    f.left = some ? left / TILE_SIZE : (iv)(1);
    f.right = some ? right / TILE_SIZE : (iv)(0);
    f.top = some ? max(top / TILE_SIZE, (iv)(w.first)) : (iv)(1);
    f.bottom = some ? min(bottom / TILE_SIZE, (iv)(w.end - 1)) : (iv)(0);
    return f;
}

/* Footprints of Gaussians first to first + used - 1, at most VEC; the other lanes have no tiles. */
inline Footprints load_footprints(const Geometry *g, const int first, const int used,
                                  const Window w)
{
    fv centre[2], factor[3], opacity[1], extent[2];
    load_rows2(g->mean2d, (size_t)first, (size_t)used, centre);
    load_rows3(g->whitening, (size_t)first, (size_t)used, factor);
    load_rows1(g->opacity, (size_t)first, (size_t)used, opacity);
    load_rows2(g->extent, (size_t)first, (size_t)used, extent);
    const fv bias = opacity[0] > (fv)(0.0f) ? log_v(opacity[0]) * LOG2_E : (fv)(-INFINITY);
    const fv limit = bias - LOG2_ALPHA_CUT;
    Footprints f;
    f.x = centre[0];
    f.y = centre[1];
    f.r1 = factor[0] * WHITENING_UNIT;
    f.l = factor[1];
    f.r2 = factor[2] * WHITENING_UNIT;
    const fv sigma_x = 1.0f / f.r1, minor = 1.0f / f.r2;
    const fv lean = f.l * sigma_x, sigma_y = sqrt(fma(lean, lean, minor * minor));
    const fv error = 1e-6f * f.r2 * (fabs(lean) + sigma_y) * sqrt(limit + 1e-4f);
    const fv reach = sqrt(fma(limit, (fv)(1.00001f), (fv)(1e-5f))) + error;
    f.squared = reach * reach;
    f.slope = f.l * f.r2 * f.r2 / fma(f.r1, f.r1, f.l * f.r2 * f.l * f.r2);
    const iv drawn = (extent[0] > (fv)(0.0f)) & (f.squared >= (fv)(0.0f));
    return add_boxes(f, fma(reach, sigma_x, (fv)(1e-3f)), fma(reach, sigma_y, (fv)(1e-3f)), drawn,
                     w);
}

inline fv spread(const fv value)
{
    float lanes[VEC];
    STORE_V(value, 0, lanes);
    return (fv)(lanes[0]);
}

/* One Gaussian in all lanes, and the tiles of its box. */
typedef struct {
    Footprints ellipse;
    int left, right, top, bottom;
} Large;

inline int first_lane(const iv value)
{
    int lanes[VEC];
    STORE_V(value, 0, lanes);
    return lanes[0];
}

inline Large load_large(const Geometry *g, const int i, const Window w)
{
    Footprints f = load_footprints(g, i, 1, w);
    f.x = spread(f.x);
    f.y = spread(f.y);
    f.r1 = spread(f.r1);
    f.l = spread(f.l);
    f.r2 = spread(f.r2);
    f.squared = spread(f.squared);
    f.slope = spread(f.slope);
    const Large large = {f, first_lane(f.left), first_lane(f.right), first_lane(f.top),
                         first_lane(f.bottom)};
    return large;
}

inline fv squared_at(const Footprints *f, const fv dx, const fv dy)
{
    const fv y1 = dx * f->r1, y2 = fma(-f->l, dx, dy) * f->r2;
    return fma(y1, y1, y2 * y2);
}

/* Whether Gaussians may touch a pixel of a tile: the smallest y1^2 + y2^2 over the rectangle of
 * pixel centres lies at its centre or on an edge facing it. */
inline iv reach_tiles(const Footprints *f, const iv column, const iv row, const Window w)
{
#if SKIP_EXACT_TILES
    const iv x = column * TILE_SIZE, y = row * TILE_SIZE;
    const fv left = TO_FV(x) + 0.5f - f->x, top = TO_FV(y) + 0.5f - f->y;
    const fv right = TO_FV(min(x + TILE_SIZE, (iv)(w.width)) - 1) + 0.5f - f->x;
    const fv bottom = TO_FV(min(y + TILE_SIZE, (iv)(w.height)) - 1) + 0.5f - f->y;
    const fv near_x = clamp_lanes((fv)(0.0f), left, right);
    const fv near_y = clamp_lanes((fv)(0.0f), top, bottom);
    const fv on_column = squared_at(f, near_x, clamp_lanes(f->l * near_x, top, bottom));
    const fv on_row = squared_at(f, clamp_lanes(f->slope * near_y, left, right), near_y);
    return (on_column <= f->squared) | (on_row <= f->squared);
#else
    (void)f, (void)row, (void)w;
    return column == column;
#endif
}

/* ---- sets of tiles as bits of a ulong: bit k is the tile (k % 2^shift, k >> shift) from a first
 * one on. A box of up to 8 x 8 tiles is one set (shift BOX_SHIFT), a row of a larger one is cut
 * into sets of up to 64 (shift STRIP_SHIFT); either way ascending bits are ascending tiles. ---- */
#define BOX_SHIFT 3
#define BOX_EDGE 8
#define STRIP_SHIFT 6
#define STRIP 64

inline int tile_of_bit(const int bit, const int shift, const int first, const int columns)
{
    return first + (bit >> shift) * columns + (bit & ((1 << shift) - 1));
}

/* Removes the lowest bit of a set and returns its number. */
inline int take_bit(ulong *set)
{
    const int bit = 63 - (int)clz(*set & (0ul - *set));
    *set &= *set - 1ul;
    return bit;
}

/* The tiles that a Gaussian reaches among [column, column + STRIP) of a row of its box. */
inline ulong strip_of(const Large *g, const int column, const int row, const Window w)
{
    ulong set = 0;
    for (int first = column; first <= g->right && first < column + STRIP; first += VEC) {
        int lanes[VEC];
        for (int lane = 0; lane < VEC; ++lane)
            lanes[lane] = first + lane;
        const iv columns = LOAD_V(0, lanes);
        const iv hit =
            reach_tiles(&g->ellipse, columns, (iv)(row), w) & (columns <= (iv)(g->right));
        STORE_V(hit ? (iv)(1) : (iv)(0), 0, lanes);
        for (int lane = 0; lane < VEC; ++lane)
            set |= (ulong)lanes[lane] << (first - column + lane);
    }
    return set;
}

#endif
