/* Lists of the Gaussians that may touch each tile, in ascending depth.
 *
 * The footprint of a Gaussian is the set of tiles it reaches. Gaussians are sorted by depth, and
 * one stable pass by tile over their tiles in that order finishes the lists. Every entry also has a
 * row of its own, contiguous for every Gaussian and in the order of the Gaussians: there the
 * backward pass of blend leaves its gradients.
 */
#include "include/footprint.h"

/* A box is 4 words: its first tile, low and high word of the set of tiles that are reached, 0. A
 * box larger than a set has the empty one, and its tiles are found again where they are needed. */
inline ulong set_of(const int4 box)
{
    return (ulong)(uint)box.y | (ulong)(uint)box.z << 32;
}

/* Number of tiles that Gaussian i, whose box is too large for a set, reaches. */
inline int count_strips(const Geometry *g, const int i, const Window w)
{
    const Large f = load_large(g, i, w);
    int reached = 0;
    for (int row = f.top; row <= f.bottom; ++row)
        for (int column = f.left; column <= f.right; column += STRIP)
            reached += (int)popcount(strip_of(&f, column, row, w));
    return reached;
}

/* Sets of VEC boxes, and how many tiles they hold; empty for boxes that are larger than a set. */
typedef struct {
    iv low, high, tiles;
} Sets;

inline int largest_lane(const iv value)
{
    int lanes[VEC], largest = 0;
    STORE_V(value, 0, lanes);
    for (int lane = 0; lane < VEC; ++lane)
        largest = max(largest, lanes[lane]);
    return largest;
}

inline Sets sets_of(const Footprints *f, const Window w)
{
    const iv across = f->right - f->left + 1, down = f->bottom - f->top + 1;
    const iv one_set = (across <= (iv)(BOX_EDGE)) & (down <= (iv)(BOX_EDGE)) & (down > (iv)(0));
    const iv tiles = one_set ? across * down : (iv)(0);
    const int most = largest_lane(tiles);
    Sets s = {(iv)(0), (iv)(0), (iv)(0)};
    iv x = (iv)(0), y = (iv)(0);
    for (int k = 0; k < most; ++k) {
        const iv hit = reach_tiles(f, f->left + x, f->top + y, w) & (tiles > (iv)(k));
        const iv bit = (iv)(1) << (x + (y & (iv)(3)) * BOX_EDGE);
        s.low |= (hit & (y < (iv)(4))) ? bit : (iv)(0);
        s.high |= (hit & (y >= (iv)(4))) ? bit : (iv)(0);
        s.tiles += hit ? (iv)(1) : (iv)(0);
        const iv wrap = x + 1 == across;
        x = wrap ? (iv)(0) : x + 1;
        y = wrap ? y + 1 : y;
    }
    return s;
}

/* Footprint and number of tiles of every Gaussian; one work-item VEC of them. */
__kernel void tiles_footprint(__global const float *mean2d, __global const float *whitening,
                              __global const float *opacity, __global const float *extent,
                              const int width, const int height, const int first_row,
                              const int end_row, const int count, __global float *boxes,
                              __global int *counts)
{
    const int first = (int)get_global_id(0) * VEC;
    if (first >= count)
        return;
    const int used = min(VEC, count - first);
    const Geometry g = {mean2d, whitening, opacity, extent};
    const Window w = {width, height, first_row, end_row};
    const Footprints f = load_footprints(&g, first, used, w);
    const Sets s = sets_of(&f, w);
    const fv box[4] = {AS_FV(f.top * columns_of(w) + f.left), AS_FV(s.low), AS_FV(s.high),
                       (fv)(0.0f)};
    store_rows4(box, boxes, (size_t)first, (size_t)used);
    const iv some = (f.left <= f.right) & (f.top <= f.bottom);
    const iv wide = (f.right - f.left >= (iv)(BOX_EDGE)) | (f.bottom - f.top >= (iv)(BOX_EDGE));
    const iv large = (some & wide) ? (iv)(1) : (iv)(0);
    int tiles[VEC], is_large[VEC];
    STORE_V(s.tiles, 0, tiles);
    if (largest_lane(large)) {
        STORE_V(large, 0, is_large);
        for (int lane = 0; lane < VEC; ++lane)
            if (is_large[lane])
                tiles[lane] = count_strips(&g, first + lane, w);
    }
    for (int lane = 0; lane < used; ++lane)
        counts[first + lane] = tiles[lane];
}

/* How many tiles of every row of tiles are reached, (chunks, rows): one work-item a chunk. */
__kernel void tiles_by_row(__global const float *mean2d, __global const float *whitening,
                           __global const float *opacity, __global const float *extent,
                           const int width, const int height, const int first_row,
                           const int end_row, const int count, __global const int *boxes,
                           __global const int *counts, const int rows, __global long *reached)
{
    const Geometry g = {mean2d, whitening, opacity, extent};
    const Window w = {width, height, first_row, end_row};
    const int columns = columns_of(w), chunks = (int)get_global_size(0);
    __global long *own = reached + get_global_id(0) * (size_t)rows;
    for (int row = 0; row < rows; ++row)
        own[row] = 0;
    for (int i = (int)get_global_id(0); i < count; i += chunks) {
        const int4 box = vload4((size_t)i, boxes);
        ulong set = set_of(box);
        for (int row = box.x / columns; set; ++row, set >>= BOX_EDGE)
            own[row] += (long)popcount(set & 0xfful);
        if (counts[i] > 0 && set_of(box) == 0) {
            const Large f = load_large(&g, i, w);
            for (int row = f.top; row <= f.bottom; ++row)
                for (int column = f.left; column <= f.right; column += STRIP)
                    own[row] += (long)popcount(strip_of(&f, column, row, w));
        }
    }
}

#include "include/tiles_chunk.h"
#include "include/tiles_sorted.h"
