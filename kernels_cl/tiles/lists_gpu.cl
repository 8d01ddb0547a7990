/* Lists of the Gaussians that may touch each tile, in ascending depth, GPU form: the entries are
 * written in depth order, sorted by tile (sort/by_key_gpu.cl), and the ends of the lists found from
 * the sorted tiles. Every entry also has a row of gradients, contiguous for every Gaussian and in
 * the order of the Gaussians: there the backward pass of the blending leaves its moments.
 *
 * A work-item owns a Gaussian or an entry, or one of each; launch size: at least their number.
 * Work-groups of any size without local memory, but for tiles_rank (scan/part_sums.h). */
#include "common/real.h"
#include "common/tile_size.h"
#include "scan/part_sums.h"
#include "tiles/box.h"
#include "tiles/footprints.h"
#include "tiles/large_footprint.h"

/* Numbers of tiles in depth order; 0 after the drawn Gaussians. One work-item per rank. */
PART_GROUP __kernel void tiles_rank(__global const int *order, __global const int *ordered,
                                    __global const int *counts, const int count,
                                    __global int *ranked_counts, __global long *sums)
{
    DECLARE_PART_SCRATCH(scratch);
    const int rank = (int)get_global_id(0);
    const int tiles = rank < ordered[0] ? counts[order[rank]] : 0;
    if (rank < count)
        ranked_counts[rank] = tiles;
    write_part_sum(scratch, (size_t)rank, count, tiles, sums);
}

/* The arrays of entries: tile and row in depth order, Gaussian by row of gradients. */
typedef struct {
    __global uint *tile;
    __global int *row, *gaussian_of_row;
} Entries;

/* Writes the entries of `tiles` tiles of Gaussian i, from place to.x and row to.y on. */
static inline int2 emit_tiles(const int first, const int tiles, const int i, int2 to,
                              const Entries entries)
{
    for (int tile = first; tile < first + tiles; ++tile, to += 1) {
        entries.tile[to.x] = (uint)tile;
        entries.row[to.x] = to.y;
        entries.gaussian_of_row[to.y] = i;
    }
    return to;
}

/* Entry k belongs to no tile, but has a row of gradients of its own. */
static inline void pad_entry(const int k, const int tile, const Entries entries)
{
    entries.tile[k] = (uint)tile;
    entries.row[k] = k;
    entries.gaussian_of_row[k] = 0;
}

/* Entries of the Gaussian of every depth rank, from place[rank] on; and padding, from total to
 * capacity, of all if they do not fit. A work-item per rank and per entry, whichever are more. */
__kernel void tiles_emit(__global const float *mean2d, __global const float *whitening,
                         __global const float *opacity, __global const float *extent,
                         const int width, const int height, const int first_row, const int end_row,
                         __global const int *order, __global const int *ordered,
                         __global const int *boxes, __global const int *place,
                         __global const int *row_range, __global const long *total,
                         const int capacity, const int padding_tile, __global uint *tile,
                         __global int *row, __global int *gaussian_of_row)
{
    const int rank = (int)get_global_id(0);
    const Entries entries = {tile, row, gaussian_of_row};
    const bool fits = total[0] <= (long)capacity;
    if (rank < capacity && (!fits || (long)rank >= total[0]))
        pad_entry(rank, padding_tile, entries);
    if (rank >= ordered[0] || !fits)
        return;
    const Geometry g = {mean2d, whitening, opacity, extent};
    const Frame frame = {width, height, first_row, end_row};
    const int i = order[rank], columns = tiles_across(width);
    const int4 box = vload4((size_t)i, boxes);
    int2 to = (int2)(place[rank], row_range[i]);
    ulong bytes = bytes_of(box);
    for (int first = top_of(box) * columns + left_of(box); bytes; first += columns, bytes >>= 8)
        to = emit_tiles(first + (int)(bytes & 15ul), (int)(bytes >> 4 & 15ul), i, to, entries);
    if (bytes_of(box))
        return;
    const LargeFootprint f = load_large_footprint(&g, i, frame);
    for (int y = f.top; y <= f.bottom; y += VEC) {
        const RowSpans r = row_spans(&f, y, frame);
        for (int lane = 0; lane < VEC; ++lane)
            to = emit_tiles((y + lane) * columns + r.first[lane], r.tiles[lane], i, to, entries);
    }
}

/* From entries sorted by tile: where the list of every tile starts, and the Gaussian of every
 * entry. Work-item i handles the boundary before entry i, work-item `entries` that after the last.
 */
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
