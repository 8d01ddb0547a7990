/* Footprints: the tiles that projected Gaussians reach, VEC Gaussians or VEC rows of tiles at a
 * time. In every row of tiles they are a span of neighbours. */
#ifndef CLGS_FOOTPRINTS_H
#define CLGS_FOOTPRINTS_H

#include "common/ellipses.h"
#include "common/lane_math.h"
#include "common/real.h"
#include "common/rows.h"
#include "common/tile_size.h"

#ifndef SKIP_EXACT_TILES
#define SKIP_EXACT_TILES 1 /* see Skips in clgs/options.py */
#endif

/* What decides which tiles a Gaussian reaches; see clgs/ops/project.py. */
typedef struct {
    __global const float *mean2d, *whitening, *opacity, *extent;
} Geometry;

/* Size of the image in pixels, and the rows of tiles that are wanted, [first, end). */
typedef struct {
    int width, height, first, end;
} Frame;

/* VEC Gaussians: what is needed of their Ellipses, and the tiles of their boxes. The last column of
 * an ellipse is on the row `tip` below its centre, its first on the row -tip. */
typedef struct {
    fv x, y, slope, squared, shrink, tip;
    fv margin;                   /* pixels, for the rounding of columns */
    iv left, right, top, bottom; /* tiles; none if left > right */
} Footprints;

/* As clamp_lanes, but a NaN becomes `low`. */
static inline iv pixel_of(const fv x, const float low, const float high)
{
    const fv raised = x > (fv)(low) ? x : (fv)(low);
    return TO_IV(raised < (fv)(high) ? raised : (fv)(high));
}

/* First and last pixel whose centre lies in centre +- half_size, among [0, size). */
static inline iv first_pixel(const fv centre, const fv half_size, const int size)
{
    return pixel_of(ceil(centre - half_size - 0.5f), 0.0f, (float)size);
}

static inline iv last_pixel(const fv centre, const fv half_size, const int size)
{
    return -pixel_of(ceil(0.5f - centre - half_size), (float)(1 - size), 1.0f);
}

/* Tiles of the boxes; phrased so that a NaN has none. */
static inline Footprints add_boxes(Footprints f, const fv half_x, const fv half_y, const iv drawn,
                                   const Frame frame)
{
    const iv left = first_pixel(f.x, half_x, frame.width),
             right = last_pixel(f.x, half_x, frame.width);
    const iv top = first_pixel(f.y, half_y, frame.height),
             bottom = last_pixel(f.y, half_y, frame.height);
    const iv some = drawn & (left <= right) & (top <= bottom);
    f.left = some ? left / TILE_SIZE : (iv)(1);
    f.right = some ? right / TILE_SIZE : (iv)(0);
    f.top = some ? max(top / TILE_SIZE, (iv)(frame.first)) : (iv)(1);
    f.bottom = some ? min(bottom / TILE_SIZE, (iv)(frame.end - 1)) : (iv)(0);
    return f;
}

/* Footprints of Gaussians first to first + used - 1, at most VEC; the other lanes have no tiles. */
static inline Footprints load_footprints(const Geometry *g, const int first, const int used,
                                         const Frame frame)
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
    return add_boxes(f, half_x + f.margin, fma(e.reach, e.sigma_y, (fv)(1e-3f)), drawn, frame);
}

/* Spans of tiles in VEC rows: the first column, and how many. */
typedef struct {
    iv first, tiles;
} Spans;

static inline fv half_width(const Footprints *f, const fv dy)
{
    const fv square = fma(-f->shrink * dy, dy, f->squared);
    return sqrt(square < (fv)(0.0f) ? (fv)(0.0f) : square);
}

/* The tiles of rows that ellipses reach, within [left, right]. The part of an ellipse between two
 * rows of pixels is convex: it covers all between its first and its last column. A NaN leaves out
 * nothing. */
static inline Spans reached_spans(const Footprints *f, const iv row, const iv left, const iv right,
                                  const Frame frame)
{
    iv first = left, last = right;
#if SKIP_EXACT_TILES
    const iv y = row * TILE_SIZE;
    const fv top = TO_FV(y) + 0.5f - f->y;
    const fv bottom = TO_FV(min(y + TILE_SIZE, (iv)(frame.height)) - 1) + 0.5f - f->y;
    const fv low = clamp_lanes(-f->tip, top, bottom), high = clamp_lanes(f->tip, top, bottom);
    const fv before = fma(-f->slope, low, half_width(f, low)) + f->margin;
    const fv after = fma(f->slope, high, half_width(f, high)) + f->margin;
    const iv first_x = first_pixel(f->x, before, frame.width);
    const iv last_x = last_pixel(f->x, after, frame.width);
    first = max(first, first_x / TILE_SIZE);
    last = first_x <= last_x ? min(last, last_x / TILE_SIZE) : (iv)(-1);
#else
    (void)f, (void)row, (void)frame;
#endif
    const Spans found = {first, max(last - first + 1, (iv)(0))};
    return found;
}

#endif
