/* Lists of the Gaussians that may touch each tile, in ascending depth, CPU form: two stable passes
 * that count and place, so that nothing is sorted by tile. First every row of tiles collects its
 * spans in depth order; then every row hands them out to its tiles. Every entry also has a row of
 * gradients, contiguous for every Gaussian and in the order of the Gaussians: there the backward
 * pass of the blending leaves its moments.
 *
 * tiles_count, tiles_place: a work-item owns a chunk of the depth ranks and a counter per row of
 * tiles. tiles_enter: a work-item owns a row of tiles and a counter per column. So few lists are
 * written to at a time that all of them stay in the cache. tiles_starts: one work-item. Work-groups
 * of one work-item; launch size: the number of chunks or of rows. No local memory. */
#include "common/chunk.h"
#include "common/prefetch.h"
#include "common/real.h"
#include "tiles/box.h"
#include "tiles/footprints.h"
#include "tiles/large_footprint.h"

#define BATCH 256 /* boxes fetched at a time, so that many reads are under way */
#define RANKS_AHEAD 32

/* Adds a span to the counters of its row of tiles: spans and tiles. */
static inline void count_span(const int tiles, __global int *counter)
{
    counter[0] += tiles > 0;
    counter[1] += tiles;
}

static inline void count_box(const Geometry *g, const Frame frame, const int4 box, const int i,
                             __global int *counter)
{
    ulong bytes = bytes_of(box);
    if (bytes == 0) {
        const LargeFootprint f = load_large_footprint(g, i, frame);
        for (int row = f.top; row <= f.bottom; row += VEC) {
            const RowSpans r = row_spans(&f, row, frame);
            for (int lane = 0; lane < VEC && row + lane <= f.bottom; ++lane)
                count_span(r.tiles[lane], counter + 2 * (row + lane));
        }
    }
    for (int row = top_of(box); bytes; row += 2, bytes >>= 16) {
        count_span((int)(bytes >> 4 & 15ul), counter + 2 * row);
        count_span((int)(bytes >> 12 & 15ul), counter + 2 * row + 2);
    }
}

/* For every chunk, the spans and the tiles in every row of tiles: counters (chunks, pitch, 2), with
 * pitch above the number of rows. And for every rank its box, with its first row of gradients in
 * the fourth word. One work-item per chunk. */
__kernel void tiles_count(__global const float *mean2d, __global const float *whitening,
                          __global const float *opacity, __global const float *extent,
                          const int width, const int height, const int first_row, const int end_row,
                          __global const int *order, __global const int *ordered,
                          __global const int *boxes, __global const int *row_range, const int pitch,
                          __global int *ranked, __global int *counters)
{
    const Geometry g = {mean2d, whitening, opacity, extent};
    const Frame frame = {width, height, first_row, end_row};
    const Chunk own = own_chunk(ordered[0]);
    __global int *counter = counters + 2 * get_global_id(0) * (size_t)pitch;
    for (int k = 0; k < 2 * pitch; ++k)
        counter[k] = 0;
    for (int begin = own.begin; begin < own.end; begin += BATCH) {
        const int end = min(begin + BATCH, own.end);
        for (int rank = begin; rank < end; ++rank) {
            const int i = order[rank], next = order[min(rank + RANKS_AHEAD, own.end - 1)];
            PREFETCH(boxes + 4 * next);
            PREFETCH(row_range + next);
            vstore4((int4)(vload4((size_t)i, boxes).xyz, row_range[i]), (size_t)rank, ranked);
        }
        for (int rank = begin; rank < end; ++rank)
            count_box(&g, frame, vload4((size_t)rank, ranked), order[rank], counter);
    }
}

/* Counters of spans become places; starts (rows + 1, 2): where the spans and the entries of every
 * row start. Lists that do not fit stay empty. One work-item. */
__kernel void tiles_starts(__global int *counters, const int chunks, const int pitch,
                           const int rows, __global const long *total, const int capacity,
                           __global int *starts)
{
    const bool fits = total[0] <= (long)capacity;
    int2 place = (int2)(0);
    for (int row = 0; row < rows; ++row) {
        vstore2(place, (size_t)row, starts);
        for (int chunk = 0; chunk < chunks; ++chunk) {
            const size_t at = (size_t)chunk * (size_t)pitch + (size_t)row;
            const int2 own = fits ? vload2(at, counters) : (int2)(0);
            vstore2(place, at, counters);
            place += own;
        }
    }
    vstore2(place, (size_t)rows, starts);
}

/* The lists of spans that a chunk adds to. */
typedef struct {
    __global int *next; /* place of the next span of every row, 2 words each */
    __global int *spans;
    int spare; /* a place that no list uses */
} SpanLists;

/* Adds a span to a row if it has tiles, without a branch; returns the row of gradients after
 * it. */
static inline int place_span(const int row, const int4 span, const SpanLists s)
{
    const int to = span.w ? s.next[2 * row] : s.spare;
    vstore4(span, (size_t)to, s.spans);
    s.next[2 * row] += span.w > 0;
    return span.y + span.w;
}

static inline void place_box(const Geometry *g, const Frame frame, const int4 box, const int i,
                             const SpanLists s)
{
    ulong bytes = bytes_of(box);
    int at = box.w;
    if (bytes == 0) {
        const LargeFootprint f = load_large_footprint(g, i, frame);
        for (int row = f.top; row <= f.bottom; row += VEC) {
            const RowSpans r = row_spans(&f, row, frame);
            for (int lane = 0; lane < VEC && row + lane <= f.bottom; ++lane)
                at = place_span(row + lane, (int4)(i, at, r.first[lane], r.tiles[lane]), s);
        }
    }
    const int left = left_of(box);
    for (int row = top_of(box); bytes; row += 2, bytes >>= 16) {
        const int4 bits = (int4)((int)bytes) >> (int4)(0, 4, 8, 12) & 15;
        at = place_span(row, (int4)(i, at, left + bits.x, bits.y), s);
        at = place_span(row + 1, (int4)(i, at, left + bits.z, bits.w), s);
    }
}

/* The spans of every row: Gaussian, its first row of gradients there, first column, tiles. The
 * array has SPARE more places per chunk. One work-item per chunk. */
#ifndef SPARE
#define SPARE 4
#endif
__kernel void tiles_place(__global const float *mean2d, __global const float *whitening,
                          __global const float *opacity, __global const float *extent,
                          const int width, const int height, const int first_row, const int end_row,
                          __global const int *order, __global const int *ordered,
                          __global const int *ranked, const int pitch, __global const long *total,
                          const int capacity, __global int *places, __global int *spans)
{
    if (total[0] > (long)capacity)
        return;
    const Geometry g = {mean2d, whitening, opacity, extent};
    const Frame frame = {width, height, first_row, end_row};
    const Chunk own = own_chunk(ordered[0]);
    const SpanLists s = {places + 2 * get_global_id(0) * (size_t)pitch, spans,
                         capacity + (int)get_global_id(0) * SPARE};
    for (int rank = own.begin; rank < own.end; ++rank)
        place_box(&g, frame, vload4((size_t)rank, ranked), order[rank], s);
}

/* Places of the first entries of the tiles of a row, from how many spans start and end there. */
static inline void start_tiles(__global const int *spans, const int2 range, int place,
                               const int columns, __global int *next)
{
    for (int column = 0; column <= columns; ++column)
        next[column] = 0;
    for (int k = range.x; k < range.y; ++k) {
        const int2 span = vload4((size_t)k, spans).zw;
        ++next[span.x];
        --next[span.x + span.y];
    }
    int tiles = 0;
    for (int column = 0; column < columns; ++column) {
        tiles += next[column];
        next[column] = place;
        place += tiles;
    }
}

/* The lists of every row of tiles. One work-item per row: rows of even number first, as the halves
 * of a picture may differ. */
__kernel void tiles_enter(__global const int *spans, __global const int *starts, const int columns,
                          const int rows, const int pitch, __global int *places,
                          __global int *tile_range, __global int *gaussian, __global int *row)
{
    const int item = (int)get_global_id(0), even = (rows + 1) / 2;
    const int own = item < even ? 2 * item : 2 * (item - even) + 1;
    const int4 range = vload4(0, starts + 2 * own);
    __global int *next = places + (size_t)own * (size_t)pitch;
    start_tiles(spans, range.xz, range.y, columns, next);
    for (int column = 0; column < columns; ++column)
        tile_range[own * columns + column] = next[column];
    if (own == rows - 1)
        tile_range[rows * columns] = range.w;
    for (int k = range.x; k < range.z; ++k) {
        const int4 span = vload4((size_t)k, spans);
        for (int tile = 0; tile < span.w; ++tile) {
            const int to = next[span.z + tile]++;
            gaussian[to] = span.x;
            row[to] = span.y + tile;
        }
    }
}

/* Entries from total to capacity: padding, each with a row of gradients of its own. Any number of
 * work-items. */
__kernel void tiles_pad_lists(__global const long *total, const int capacity,
                              __global int *gaussian, __global int *row)
{
    const int first = total[0] <= (long)capacity ? (int)total[0] : 0;
    for (int k = first + (int)get_global_id(0); k < capacity; k += (int)get_global_size(0)) {
        gaussian[k] = 0;
        row[k] = k;
    }
}
