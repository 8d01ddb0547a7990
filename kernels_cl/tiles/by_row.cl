/* How many entries every row of tiles will have, for pictures whose lists are made in groups of
 * rows.
 *
 * A work-item owns every get_global_size-th Gaussian and counts on its own; the host adds the
 * counts. Work-groups of one work-item; launch size: any. No local memory. */
#include "tiles/box.h"
#include "tiles/footprints.h"
#include "tiles/large_footprint.h"

/* Adds the tiles of Gaussian i, whose box is large. */
static inline void add_large(const Geometry *g, const int i, const Frame frame,
                             __global long *by_row)
{
    const LargeFootprint f = load_large_footprint(g, i, frame);
    for (int row = f.top; row <= f.bottom; row += VEC) {
        const RowSpans r = row_spans(&f, row, frame);
        for (int lane = 0; lane < VEC && row + lane <= f.bottom; ++lane)
            by_row[row + lane] += r.tiles[lane];
    }
}

/* reached: (chunks, rows). */
__kernel void tiles_by_row(__global const float *mean2d, __global const float *whitening,
                           __global const float *opacity, __global const float *extent,
                           const int width, const int height, const int first_row,
                           const int end_row, const int count, __global const int *boxes,
                           __global const int *counts, const int rows, __global long *reached)
{
    const Geometry g = {mean2d, whitening, opacity, extent};
    const Frame frame = {width, height, first_row, end_row};
    const int chunks = (int)get_global_size(0);
    __global long *own = reached + get_global_id(0) * (size_t)rows;
    for (int row = 0; row < rows; ++row)
        own[row] = 0;
    for (int i = (int)get_global_id(0); i < count; i += chunks) {
        if (counts[i] == 0)
            continue;
        const int4 box = vload4((size_t)i, boxes);
        ulong bytes = bytes_of(box);
        if (bytes == 0)
            add_large(&g, i, frame, own);
        for (int row = top_of(box); bytes; ++row, bytes >>= 8)
            own[row] += (long)(bytes >> 4 & 15ul);
    }
}
