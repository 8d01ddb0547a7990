/* Lists of the Gaussians that may touch each tile, in ascending depth.
 *
 * A drawn Gaussian has extent > 0. Gaussians are sorted by depth, then emit their tiles in that
 * order, so that one stable sort by tile finishes the lists. Every entry also has a row of its own,
 * contiguous for every Gaussian and in the order of the Gaussians: there the backward pass of blend
 * leaves its gradients.
 */
#include "include/splat.h"

#define KEY_LAST 0xffffffffu

/* Sort keys by depth: the bits of a positive float keep its order; Gaussians not drawn go last. */
__kernel void tiles_keys(__global const float *depth, __global const float *extent, const int count,
                         __global uint *keys, __global int *index)
{
    const int i = (int)get_global_id(0);
    if (i >= count)
        return;
    keys[i] = extent[2 * i] > 0.0f ? as_uint(depth[i]) : KEY_LAST;
    index[i] = i;
}

/* What a Gaussian needs to emit its tiles, 8 floats: x, y, r1, l, r2, the largest y1^2 + y2^2, and
 * the tiles that its box overlaps as two words (first + 65536 * last) of columns and of rows. */
#define FOOTPRINT_SIZE 8

typedef struct {
    Splat splat; /* without bias */
    float squared;
    int2 columns, rows; /* first, last; none where first > last */
} Footprint;

inline float pack_range(int2 range)
{
    return as_float(range.x | (range.y << 16));
}

inline int2 unpack_range(float word)
{
    return (int2)(as_int(word) & 0xffff, as_int(word) >> 16);
}

/* Footprint of every Gaussian; of one that is not drawn, without tiles. */
__kernel void tiles_footprint(__global const float *mean2d, __global const float *whitening,
                              __global const float *opacity, __global const float *extent,
                              const int count, const int width, const int height,
                              __global float *footprints)
{
    const int i = (int)get_global_id(0);
    if (i >= count)
        return;
    const Splat s = make_splat2d(mean2d, whitening, opacity, i);
    const Reach r = reach_of(&s);
    const int4 box = pixel_box((float2)(s.x, s.y), (float2)(r.half_x, r.half_y),
                               (float2)((float)width, (float)height));
    /* phrased so that NaN has no tiles */
    const bool drawn = (extent[2 * i] > 0.0f) & (r.squared >= 0.0f);
    const bool some = drawn & (box.x <= box.z) & (box.y <= box.w);
    const int4 tiles = some ? box / TILE_SIZE : (int4)(1, 1, 0, 0);
    vstore8(
        (float8)(s.x, s.y, s.r1, s.l, s.r2, r.squared, pack_range(tiles.xz), pack_range(tiles.yw)),
        (size_t)i, footprints);
}

inline Footprint load_footprint(__global const float *footprints, int i)
{
    const float8 v = vload8((size_t)i, footprints);
    const Footprint f = {
        {v.s0, v.s1, v.s2, v.s3, v.s4, 0.0f}, v.s5, unpack_range(v.s6), unpack_range(v.s7)};
    return f;
}

inline int tiles_of_box(const Footprint *f)
{
    return (f->columns.y - f->columns.x + 1) * (f->rows.y - f->rows.x + 1);
}

/* The tile after this one in the box, row by row. */
inline int2 next_tile(const Footprint *f, int2 tile)
{
    const bool wrap = tile.x == f->columns.y;
    return (int2)(wrap ? f->columns.x : tile.x + 1, tile.y + (wrap ? 1 : 0));
}

inline bool reaches_tile(const Footprint *f, int2 tile, int width, int height)
{
    const int2 first = tile * TILE_SIZE;
    const int2 last = min(first + TILE_SIZE, (int2)(width, height)) - 1;
    return reaches_pixels(&f->splat, f->squared, first, last);
}

/* Number of tiles of every Gaussian. */
__kernel void tiles_count(__global const float *footprints, const int count, const int width,
                          const int height, __global int *counts)
{
    const int i = (int)get_global_id(0);
    if (i >= count)
        return;
    const Footprint f = load_footprint(footprints, i);
    int2 tile = (int2)(f.columns.x, f.rows.x);
    int reached = 0;
    for (int left = tiles_of_box(&f); left > 0; --left) {
        reached += reaches_tile(&f, tile, width, height) ? 1 : 0;
        tile = next_tile(&f, tile);
    }
    counts[i] = reached;
}

/* Counts and footprints in depth order, for tiles_emit to read them as a stream. */
__kernel void tiles_rank(__global const int *order, __global const int *counts,
                         __global const float *footprints, const int count,
                         __global int *ranked_counts, __global float *ranked_footprints)
{
    const int rank = (int)get_global_id(0);
    if (rank >= count)
        return;
    const int i = order[rank];
    ranked_counts[rank] = counts[i];
    vstore8(vload8((size_t)i, footprints), (size_t)rank, ranked_footprints);
}

/* Entries of the Gaussian of every depth rank, from place[rank] on. */
__kernel void tiles_emit(__global const int *order, __global const float *ranked_footprints,
                         const int count, const int width, const int height,
                         __global const int *place, __global const int *row_range,
                         __global uint *tile_number, __global int *rows,
                         __global int *gaussian_of_row)
{
    const int rank = (int)get_global_id(0);
    if (rank >= count)
        return;
    const int i = order[rank];
    const Footprint f = load_footprint(ranked_footprints, rank);
    const int columns = (width + TILE_SIZE - 1) / TILE_SIZE;
    int2 tile = (int2)(f.columns.x, f.rows.x);
    int to = place[rank], row = row_range[i];
    for (int left = tiles_of_box(&f); left > 0; --left) {
        if (reaches_tile(&f, tile, width, height)) {
            tile_number[to] = (uint)(tile.y * columns + tile.x);
            gaussian_of_row[row] = i;
            rows[to++] = row++;
        }
        tile = next_tile(&f, tile);
    }
}

/* From entries sorted by tile: where the list of every tile starts, and the Gaussian of every
 * entry. Work-item i handles the boundary before entry i; the one after the last entry exists. */
__kernel void tiles_ranges(__global const uint *tile, __global const int *row, const int entries,
                           const int tiles, __global const int *gaussian_of_row,
                           __global int *tile_range, __global int *gaussian)
{
    const int i = (int)get_global_id(0);
    if (i > entries)
        return;
    const int before = i > 0 ? (int)tile[i - 1] : -1;
    const int here = i < entries ? (int)tile[i] : tiles;
    for (int t = before + 1; t <= here; ++t)
        tile_range[t] = i;
    if (i < entries)
        gaussian[i] = gaussian_of_row[row[i]];
}
