/* Which tiles Gaussians reach, VEC Gaussians or VEC tiles at a time. */
#ifndef CLGS_FOOTPRINT_H
#define CLGS_FOOTPRINT_H

#include "blend/splat.h"

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

/* VEC Gaussians: their Ellipses, and the tiles of their boxes. The last column of an ellipse is on
 * the row `tip` below its centre, its first on the row -tip. */
typedef struct {
    fv x, y, slope, squared, shrink, tip;
    fv margin;                   /* pixels, for the rounding of columns */
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
    const Ellipses e =
        load_ellipses(g->mean2d, g->whitening, g->opacity, (size_t)first, (size_t)used);
    fv extent[2];
    load_rows2(g->extent, (size_t)first, (size_t)used, extent);
    const fv half_x = e.reach * e.sigma_x;
    Footprints f;
    f.x = e.x;
    f.y = e.y;
    f.slope = e.slope;
    f.squared = e.squared;
    f.shrink = e.shrink;
    f.tip = e.lean * e.reach;
    f.margin = fma((fv)(1e-6f), fabs(f.x) + half_x, (fv)(1e-3f));
    const iv drawn = (extent[0] > (fv)(0.0f)) & (e.reach >= (fv)(0.0f));
    return add_boxes(f, half_x + f.margin, fma(e.reach, e.sigma_y, (fv)(1e-3f)), drawn, w);
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
    f.slope = spread(f.slope);
    f.squared = spread(f.squared);
    f.shrink = spread(f.shrink);
    f.tip = spread(f.tip);
    f.margin = spread(f.margin);
    const Large large = {f, first_lane(f.left), first_lane(f.right), first_lane(f.top),
                         first_lane(f.bottom)};
    return large;
}

/* Neighbouring tiles of a row: the first column, and how many. */
typedef struct {
    iv first, tiles;
} Columns;

inline fv half_width(const Footprints *f, const fv dy)
{
    const fv square = fma(-f->shrink * dy, dy, f->squared);
    return sqrt(square < (fv)(0.0f) ? (fv)(0.0f) : square);
}

/* The tiles of rows that ellipses reach, within [left, right]. A part of an ellipse between two
 * rows of pixels is convex: what it covers lies between its first and its last column. A NaN
 * leaves out nothing. */
inline Columns reached_columns(const Footprints *f, const iv row, const iv left, const iv right,
                               const Window w)
{
    iv first = left, last = right;
#if SKIP_EXACT_TILES
    const iv y = row * TILE_SIZE;
    const fv top = TO_FV(y) + 0.5f - f->y;
    const fv bottom = TO_FV(min(y + TILE_SIZE, (iv)(w.height)) - 1) + 0.5f - f->y;
    const fv low = clamp_lanes(-f->tip, top, bottom), high = clamp_lanes(f->tip, top, bottom);
    const fv before = fma(-f->slope, low, half_width(f, low)) + f->margin;
    const fv behind = fma(f->slope, high, half_width(f, high)) + f->margin;
    const iv first_x = first_pixel(f->x, before, w.width);
    const iv last_x = last_pixel(f->x, behind, w.width);
    first = max(first, first_x / TILE_SIZE);
    last = first_x <= last_x ? min(last, last_x / TILE_SIZE) : (iv)(-1);
#else
    (void)f, (void)row, (void)w;
#endif
    const Columns found = {first, max(last - first + 1, (iv)(0))};
    return found;
}

/* Columns of VEC rows of a large box, from `row` on. */
typedef struct {
    int first[VEC], tiles[VEC];
} Rows;

inline Rows rows_of(const Large *g, const int row, const Window w)
{
    Rows r;
    for (int lane = 0; lane < VEC; ++lane)
        r.first[lane] = row + lane;
    const iv rows = LOAD_V(0, r.first);
    const Columns found = reached_columns(&g->ellipse, rows, (iv)(g->left), (iv)(g->right), w);
    STORE_V(found.first, 0, r.first);
    STORE_V(rows <= (iv)(g->bottom) ? found.tiles : (iv)(0), 0, r.tiles);
    return r;
}

/* ---- a box is 4 words: its first row and column, 16 bits each; and a byte for each of up to 8
 * rows in the next two, the columns up to its first tile in the low half, its tiles in the high
 * half. A larger box has no bytes, and its tiles are found again where they are needed. ---- */
#define BOX_ROWS 8
#define BOX_COLUMNS 15

inline ulong bytes_of(const int4 box)
{
    return (ulong)(uint)box.y | (ulong)(uint)box.z << 32;
}

inline int top_of(const int4 box)
{
    return box.x >> 16;
}

inline int left_of(const int4 box)
{
    return box.x & 0xffff;
}

#endif
