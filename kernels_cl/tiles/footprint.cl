/* The footprint of every projected Gaussian: which tiles it reaches, and how many.
 *
 * A work-item owns VEC Gaussians; launch size: at least Gaussians / VEC. Work-groups and local
 * memory: see scan/part_sums.h. */
#include "common/items.h"
#include "common/real.h"
#include "common/rows.h"
#include "scan/part_sums.h"
#include "tiles/box.h"
#include "tiles/footprints.h"
#include "tiles/large_footprint.h"

/* Number of tiles that Gaussian i, whose box is large, reaches. */
static inline int count_large(const Geometry *g, const int i, const Frame frame)
{
    const LargeFootprint f = load_large_footprint(g, i, frame);
    int reached = 0;
    for (int row = f.top; row <= f.bottom; row += VEC) {
        const RowSpans r = row_spans(&f, row, frame);
        for (int lane = 0; lane < VEC; ++lane)
            reached += r.tiles[lane];
    }
    return reached;
}

static inline int largest_lane(const iv value)
{
    int lanes[VEC], largest = 0;
    STORE_V(value, 0, lanes);
    for (int lane = 0; lane < VEC; ++lane)
        largest = max(largest, lanes[lane]);
    return largest;
}

/* The bytes of up to 4 rows of VEC boxes of `down` rows, at most `end`, from row `begin` of them
 * on; their tiles are added to `tiles`. */
static inline iv bytes_of_rows(const Footprints *f, const iv down, const int begin, const int end,
                               const Frame frame, iv *tiles)
{
    iv bytes = (iv)(0);
    for (int k = begin; k < end; ++k) {
        const Spans found = reached_spans(f, f->top + k, f->left, f->right, frame);
        const iv own = down > (iv)(k) ? found.tiles : (iv)(0);
        bytes |= (own > (iv)(0) ? (found.first - f->left) | own << 4 : (iv)(0)) << 8 * (k - begin);
        *tiles += own;
    }
    return bytes;
}

/* Writes boxes (see tiles/box.h) and numbers of tiles of `used` Gaussians from `first` on. Returns
 * the sum of the numbers. */
static inline int write_footprints(const Geometry *g, const int first, const int used,
                                   const Frame frame, __global float *boxes, __global int *counts)
{
    const Footprints f = load_footprints(g, first, used, frame);
    const iv across = f.right - f.left + 1, down = f.bottom - f.top + 1;
    const iv some = (across > (iv)(0)) & (down > (iv)(0));
    const iv large = some & ((across > (iv)(BOX_COLUMNS)) | (down > (iv)(BOX_ROWS)));
    const iv rows = some & ~large ? down : (iv)(0);
    const int most = largest_lane(rows);
    iv reached = (iv)(0);
    const iv low = bytes_of_rows(&f, rows, 0, min(most, 4), frame, &reached);
    const iv high = bytes_of_rows(&f, rows, 4, most, frame, &reached);
    const fv box[4] = {AS_FV(f.top << 16 | f.left), AS_FV(low), AS_FV(high), (fv)(0.0f)};
    store_rows4(box, boxes, (size_t)first, (size_t)used);
    int tiles[VEC], is_large[VEC];
    STORE_V(reached, 0, tiles);
    STORE_V(large ? (iv)(1) : (iv)(0), 0, is_large);
    for (int lane = 0; lane < used; ++lane)
        if (is_large[lane])
            tiles[lane] = count_large(g, first + lane, frame);
    int sum = 0;
    for (int lane = 0; lane < used; ++lane) {
        counts[first + lane] = tiles[lane];
        sum += tiles[lane];
    }
    return sum;
}

PART_GROUP __kernel void
tiles_footprint(__global const float *mean2d, __global const float *whitening,
                __global const float *opacity, __global const float *extent, const int width,
                const int height, const int first_row, const int end_row, const int count,
                __global int *boxes, __global int *counts, __global long *sums)
{
    DECLARE_PART_SCRATCH(scratch);
    const int first = (int)item_from_middle() * VEC, used = min(VEC, count - first);
    const Geometry g = {mean2d, whitening, opacity, extent};
    const Frame frame = {width, height, first_row, end_row};
    const int sum =
        used > 0 ? write_footprints(&g, first, used, frame, (__global float *)boxes, counts) : 0;
    write_part_sum(scratch, (size_t)first, count, sum, sums);
}
