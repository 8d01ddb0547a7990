/* Exclusive prefix sum with a 64-bit total, CPU form: every chunk is scanned from the sum of the
 * counts before it, which are parts whose sums are known (scan/part_sums.h), or are found by
 * scan_reduce, a part per chunk. Sums of integers: the result does not depend on parts and chunks.
 * Sums above the limit are of no use: all offsets are 0 then.
 *
 * A work-item owns a chunk, whole parts; launch size: the number of chunks, in work-groups of one
 * work-item. No local memory. */
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
                         __global const long *sums, const int parts, const int part,
                         const long limit, __global long *total, __global int *offsets)
{
    const int first = (int)get_global_id(0) * chunk;
    const int end = chunk_end(first, chunk, count);
    long carry = 0, all = 0;
    for (int i = 0; i < parts; ++i) {
        carry += i < first / part ? sums[i] : 0L;
        all += sums[i];
    }
    const bool fits = all <= limit;
    for (int i = first; i < end; ++i) {
        offsets[i] = fits ? (int)carry : 0;
        carry += counts[i];
    }
    if (get_global_id(0) == 0) {
        offsets[count] = fits ? (int)all : 0;
        total[0] = all;
    }
}
