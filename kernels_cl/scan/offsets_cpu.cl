/* Exclusive prefix sum with a 64-bit total, CPU form, in three passes over chunks: sum every chunk,
 * scan the sums, scan every chunk from its start. Sums of integers: the result does not depend on
 * the chunks. Sums above the limit are of no use: all offsets are 0 then.
 *
 * scan_reduce, scan_apply: a work-item owns a chunk; launch size: the number of chunks, in
 * work-groups of one work-item. scan_spine: one work-item. No local memory. */
#include "common/chunk.h"

__kernel void scan_reduce(__global const int *counts, const int count, const int chunk,
                          __global long *sums)
{
    const int first = (int)get_global_id(0) * chunk;
    const int end = chunk_end(first, chunk, count);
    long sum = 0;
    for (int i = first; i < end; ++i)
        sum += counts[i];
    sums[get_global_id(0)] = sum;
}

/* The sums become starts. */
__kernel void scan_spine(__global long *sums, const int chunks, __global long *total)
{
    long carry = 0;
    for (int i = 0; i < chunks; ++i) {
        const long own = sums[i];
        sums[i] = carry;
        carry += own;
    }
    total[0] = carry;
}

__kernel void scan_apply(__global const int *counts, const int count, const int chunk,
                         __global const long *starts, __global const long *total, const long limit,
                         __global int *offsets)
{
    const int first = (int)get_global_id(0) * chunk;
    const int end = chunk_end(first, chunk, count);
    const bool fits = total[0] <= limit;
    long carry = starts[get_global_id(0)];
    for (int i = first; i < end; ++i) {
        offsets[i] = fits ? (int)carry : 0;
        carry += counts[i];
    }
    if (first == 0)
        offsets[count] = fits ? (int)total[0] : 0;
}
