/* One counting pass by tile, CPU form: a work-item owns a chunk of the depth ranks and a counter of
 * every tile. */
#ifndef CLGS_TILES_CHUNK_H
#define CLGS_TILES_CHUNK_H

#include "include/chunk.h"

#define BATCH 256          /* boxes fetched at a time, so that many reads are under way */
#define PAIR_OF_ROWS 0x303 /* sets of up to 2 x 2 tiles, most of all, need no loop */

inline void count_set(ulong set, const int shift, const int first, const int columns,
                      __global int *counter)
{
    while (set)
        ++counter[tile_of_bit(take_bit(&set), shift, first, columns)];
}

inline void count_box(const Geometry *g, const Window w, const int4 box, const int i,
                      __global int *counter)
{
    const int columns = columns_of(w);
    const ulong set = set_of(box);
    if ((set & ~(ulong)PAIR_OF_ROWS) == 0 && set) {
        counter[box.x] += box.y & 1;
        counter[box.x + 1] += (box.y >> 1) & 1;
        counter[box.x + columns] += (box.y >> 8) & 1;
        counter[box.x + columns + 1] += (box.y >> 9) & 1;
    } else if (set) {
        count_set(set, BOX_SHIFT, box.x, columns, counter);
    } else {
        const Large f = load_large(g, i, w);
        for (int row = f.top; row <= f.bottom; ++row)
            for (int x = f.left; x <= f.right; x += STRIP)
                count_set(strip_of(&f, x, row, w), STRIP_SHIFT, row * columns + x, columns,
                          counter);
    }
}

/* Tiles of every chunk, (chunks, pitch), at least columns + 1 more than there are; and the boxes
 * of every rank with their first row. */
__kernel void tiles_count(__global const float *mean2d, __global const float *whitening,
                          __global const float *opacity, __global const float *extent,
                          const int width, const int height, const int first_row, const int end_row,
                          __global const int *order, __global const int *ordered,
                          __global const int *boxes, __global const int *row_range, const int pitch,
                          __global int *ranked, __global int *counters)
{
    const Geometry g = {mean2d, whitening, opacity, extent};
    const Window w = {width, height, first_row, end_row};
    const Chunk own = own_chunk(ordered[0]);
    __global int *counter = counters + get_global_id(0) * (size_t)pitch;
    for (int tile = 0; tile < pitch; ++tile)
        counter[tile] = 0;
    for (int begin = own.begin; begin < own.end; begin += BATCH) {
        const int end = min(begin + BATCH, own.end);
        for (int rank = begin; rank < end; ++rank) {
            const int i = order[rank];
            vstore4((int4)(vload4((size_t)i, boxes).xyz, row_range[i]), (size_t)rank, ranked);
        }
        for (int rank = begin; rank < end; ++rank)
            count_box(&g, w, vload4((size_t)rank, ranked), order[rank], counter);
    }
}

/* Counters become places, tile by tile; one work-item. Lists that do not fit stay empty. */
__kernel void tiles_starts(__global int *counters, const int chunks, const int pitch,
                           const int tiles, __global const long *total, const int capacity,
                           __global int *tile_range)
{
    const bool fits = total[0] <= (long)capacity;
    int place = 0;
    for (int tile = 0; tile < tiles; ++tile) {
        tile_range[tile] = place;
        for (int chunk = 0; chunk < chunks; ++chunk) {
            const size_t at = (size_t)chunk * (size_t)pitch + (size_t)tile;
            const int own = fits ? counters[at] : 0;
            counters[at] = place;
            place += own;
        }
    }
    tile_range[tiles] = place;
}

typedef struct {
    __global int *next; /* place of the next entry of every tile */
    __global int *gaussian, *row;
    int unused; /* a place that is none */
} Lists;

/* Enters Gaussian i into the lists of a set; returns the row after its last. */
inline int enter_set(ulong set, const int shift, const int first, const int columns, const int i,
                     int row, const Lists lists)
{
    while (set) {
        const int to = lists.next[tile_of_bit(take_bit(&set), shift, first, columns)]++;
        lists.gaussian[to] = i;
        lists.row[to] = row++;
    }
    return row;
}

/* The same for a single tile where `taken` is 1, without a branch where it is 0. */
inline int enter_tile(const int tile, const int taken, const int i, const int row,
                      const Lists lists)
{
    const int to = taken ? lists.next[tile] : lists.unused;
    lists.gaussian[to] = i;
    lists.row[to] = row;
    lists.next[tile] += taken;
    return row + taken;
}

inline void enter_box(const Geometry *g, const Window w, const int4 box, const int i,
                      const Lists lists)
{
    const int columns = columns_of(w);
    const ulong set = set_of(box);
    int row = box.w;
    if ((set & ~(ulong)PAIR_OF_ROWS) == 0 && set) {
        row = enter_tile(box.x, box.y & 1, i, row, lists);
        row = enter_tile(box.x + 1, (box.y >> 1) & 1, i, row, lists);
        row = enter_tile(box.x + columns, (box.y >> 8) & 1, i, row, lists);
        enter_tile(box.x + columns + 1, (box.y >> 9) & 1, i, row, lists);
    } else if (set) {
        enter_set(set, BOX_SHIFT, box.x, columns, i, row, lists);
    } else {
        const Large f = load_large(g, i, w);
        for (int y = f.top; y <= f.bottom; ++y)
            for (int x = f.left; x <= f.right; x += STRIP)
                row = enter_set(strip_of(&f, x, y, w), STRIP_SHIFT, y * columns + x, columns, i,
                                row, lists);
    }
}

/* The lists, chunk by chunk; their arrays have UNUSED more places a chunk. */
#define UNUSED 16
__kernel void tiles_enter(__global const float *mean2d, __global const float *whitening,
                          __global const float *opacity, __global const float *extent,
                          const int width, const int height, const int first_row, const int end_row,
                          __global const int *order, __global const int *ordered,
                          __global const int *ranked, const int pitch, __global const long *total,
                          const int capacity, __global int *places, __global int *gaussian,
                          __global int *row)
{
    if (total[0] > (long)capacity)
        return;
    const Geometry g = {mean2d, whitening, opacity, extent};
    const Window w = {width, height, first_row, end_row};
    const Chunk own = own_chunk(ordered[0]);
    const Lists lists = {places + get_global_id(0) * (size_t)pitch, gaussian, row,
                         capacity + (int)get_global_id(0) * UNUSED};
    for (int rank = own.begin; rank < own.end; ++rank)
        enter_box(&g, w, vload4((size_t)rank, ranked), order[rank], lists);
}

/* Entries from total to capacity: of no Gaussian, each with a row of its own. */
__kernel void tiles_pad_lists(__global const long *total, const int capacity,
                              __global int *gaussian, __global int *row)
{
    const int k = (int)get_global_id(0);
    if (k >= capacity || (total[0] <= (long)capacity && (long)k < total[0]))
        return;
    gaussian[k] = 0;
    row[k] = k;
}

#endif
