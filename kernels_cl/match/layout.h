/* Descriptors as bytes, and what a launch of match_nearest computes of them.
 *
 * `own` and `others` hold LANES descriptors per tile, two numbers of each next to each other:
 * number k of descriptor i is at place_of(i / LANES, k, i % LANES). Each photo has whole blocks of
 * BLOCK_ROWS descriptors, the last one filled with zeros.
 *
 * vload3(j, jobs): x: first tile in `own` of BLOCK_ROWS descriptors; y: first tile in `others` of
 * those that they are compared with; z: their tiles. Row i of job j is row BLOCK_ROWS * j + i of
 * the results.
 *
 * Products of bytes and their sums are integers below 2^24, which float32 holds exactly: results
 * depend neither on the order of the sums nor on their type. */
#ifndef CLGS_MATCH_LAYOUT_H
#define CLGS_MATCH_LAYOUT_H

#ifndef LENGTH
#define LENGTH 128
#endif
#ifndef LANES
#define LANES 16
#endif
#ifndef BLOCK_ROWS
#define BLOCK_ROWS 64
#endif
/* A key orders descriptors by their product, then by their tile, the first one first. */
#ifndef TILE_BITS
#define TILE_BITS 12
#endif
#define LAST_TILE ((1 << TILE_BITS) - 1)

static inline size_t place_of(const int tile, const int k, const int lane)
{
    return ((size_t)tile * LENGTH + (k & ~1)) * LANES + 2 * lane + (k & 1);
}

/* Results of row `row` from its largest key, that one's lane and the second largest product. */
static inline void store_nearest(const int key, const int lane, const int second_product,
                                 const size_t row, __global int *nearest, __global int *product,
                                 __global int *second)
{
    nearest[row] = (LAST_TILE - (key & LAST_TILE)) * LANES + lane;
    product[row] = key >> TILE_BITS;
    second[row] = second_product;
}

#endif
