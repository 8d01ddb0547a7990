/* The footprint of a Gaussian whose box is too large to pack (see tiles/box.h), VEC rows of tiles
 * at a time. */
#ifndef CLGS_LARGE_FOOTPRINT_H
#define CLGS_LARGE_FOOTPRINT_H

#include "common/real.h"
#include "tiles/footprints.h"

/* One Gaussian in all lanes, and the tiles of its box. */
typedef struct {
    Footprints ellipse;
    int left, right, top, bottom;
} LargeFootprint;

/* The first lane in all lanes. */
static inline fv spread(const fv value)
{
    float lanes[VEC];
    STORE_V(value, 0, lanes);
    return (fv)(lanes[0]);
}

static inline int first_lane(const iv value)
{
    int lanes[VEC];
    STORE_V(value, 0, lanes);
    return lanes[0];
}

static inline LargeFootprint load_large_footprint(const Geometry *g, const int i, const Frame frame)
{
    Footprints f = load_footprints(g, i, 1, frame);
    f.x = spread(f.x);
    f.y = spread(f.y);
    f.slope = spread(f.slope);
    f.squared = spread(f.squared);
    f.shrink = spread(f.shrink);
    f.tip = spread(f.tip);
    f.margin = spread(f.margin);
    const LargeFootprint large = {f, first_lane(f.left), first_lane(f.right), first_lane(f.top),
                                  first_lane(f.bottom)};
    return large;
}

/* The spans of VEC rows of one footprint. */
typedef struct {
    int first[VEC], tiles[VEC];
} RowSpans;

/* Those from `row` on; rows below the box have no tiles. */
static inline RowSpans row_spans(const LargeFootprint *g, const int row, const Frame frame)
{
    RowSpans r;
    for (int lane = 0; lane < VEC; ++lane)
        r.first[lane] = row + lane;
    const iv rows = LOAD_V(0, r.first);
    const Spans found = reached_spans(&g->ellipse, rows, (iv)(g->left), (iv)(g->right), frame);
    STORE_V(found.first, 0, r.first);
    STORE_V(rows <= (iv)(g->bottom) ? found.tiles : (iv)(0), 0, r.tiles);
    return r;
}

#endif
