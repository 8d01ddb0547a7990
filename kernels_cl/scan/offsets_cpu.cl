/* Exclusive prefix sum with a 64-bit total, CPU form, in two passes over chunks: sum every chunk,
 * then scan every chunk from the sum of those before it. Sums of integers: the result does not
 * depend on the chunks. Sums above the limit are of no use: all offsets are 0 then.
 *
 * A work-item owns a chunk; launch size: the number of chunks, in work-groups of one work-item.
 * scan_reduce is not needed for a single chunk. No local memory. */
#include "common/chunk.h"

static inline long chunk_sum(__global const int *counts, const int first, const int end)
{
    long sum = 0;
    for (int i = first; i < end; ++i)
        sum += counts[i];
    return sum;
}

__kernel void scan_reduce(__global const int *counts, const int count, const int chunk,
                          __global long *sums)
{
    const int first = (int)get_global_id(0) * chunk;
    sums[get_global_id(0)] = chunk_sum(counts, first, chunk_end(first, chunk, count));
}

__kernel void scan_apply(__global const int *counts, const int count, const int chunk,
                         __global const long *sums, const long limit, __global long *total,
                         __global int *offsets)
{
    const size_t own = get_global_id(0), chunks = get_global_size(0);
    const int first = (int)own * chunk;
    const int end = chunk_end(first, chunk, count);
    long carry = 0, all = 0;
    for (size_t i = 0; i < chunks; ++i) {
        carry = i == own ? all : carry;
        all += chunks == 1 ? chunk_sum(counts, first, end) : sums[i];
    }
    const bool fits = all <= limit;
    for (int i = first; i < end; ++i) {
        offsets[i] = fits ? (int)carry : 0;
        carry += counts[i];
    }
    if (own == 0) {
        offsets[count] = fits ? (int)all : 0;
        total[0] = all;
    }
}
