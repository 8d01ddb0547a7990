/* Exclusive prefix sum with a 64-bit total, GPU form, in two passes over chunks: sum every chunk,
 * then scan every chunk from the sum of those before it. Sums of integers: the result does not
 * depend on the chunks. Sums above the limit are of no use: all offsets are 0 then.
 *
 * A work-group of GROUP_SIZE work-items owns a chunk; launch size: chunks * GROUP_SIZE.
 * scan_reduce is not needed for a single chunk. Local memory holds a number per work-item. */
#include "common/chunk.h"
#include "scan/group_scan.h"

/* What this work-item takes part in adding up of the counts of a chunk. */
static inline long own_sum(__global const int *counts, const int first, const int end)
{
    long sum = 0;
    for (int i = first + (int)get_local_id(0); i < end; i += GROUP_SIZE)
        sum += counts[i];
    return sum;
}

SCAN_GROUP __kernel void scan_reduce(__global const int *counts, const int count, const int chunk,
                                     __global long *sums)
{
    __local long scratch[GROUP_SIZE];
    const int group = (int)get_group_id(0), first = group * chunk;
    long sum;
    group_exclusive_scan(own_sum(counts, first, chunk_end(first, chunk, count)), scratch, &sum);
    if (get_local_id(0) == 0)
        sums[group] = sum;
}

SCAN_GROUP __kernel void scan_apply(__global const int *counts, const int count, const int chunk,
                                    __global const long *sums, const long limit,
                                    __global long *total, __global int *offsets)
{
    __local long scratch[GROUP_SIZE];
    const int group = (int)get_group_id(0), chunks = (int)get_num_groups(0);
    const int begin = group * chunk;
    const int end = chunk_end(begin, chunk, count);
    long own_all = chunks == 1 ? own_sum(counts, begin, end) : 0L, own_before = 0, all, carry;
    for (int i = (int)get_local_id(0); chunks > 1 && i < chunks; i += GROUP_SIZE) {
        own_all += sums[i];
        own_before += i < group ? sums[i] : 0L;
    }
    group_exclusive_scan(own_all, scratch, &all);
    group_exclusive_scan(own_before, scratch, &carry);
    const bool fits = all <= limit;
    for (int first = begin; first < end; first += GROUP_SIZE) {
        const int i = first + (int)get_local_id(0);
        long sum;
        const long own = i < end ? (long)counts[i] : 0L;
        const long before = group_exclusive_scan(own, scratch, &sum);
        if (i < end)
            offsets[i] = fits ? (int)(carry + before) : 0;
        carry += sum;
    }
    if (group == 0 && get_local_id(0) == 0) {
        offsets[count] = fits ? (int)all : 0;
        total[0] = all;
    }
}
