/* Exclusive prefix sum with a 64-bit total, GPU form, in three passes over chunks: sum every chunk,
 * scan the sums, scan every chunk from its start. Sums of integers: the result does not depend on
 * the chunks. Sums above the limit are of no use: all offsets are 0 then.
 *
 * scan_reduce, scan_apply: a work-group of GROUP_SIZE work-items owns a chunk; launch size:
 * chunks * GROUP_SIZE. scan_spine: one work-group. Local memory holds a number per work-item. */
#include "common/chunk.h"
#include "scan/group_scan.h"

__kernel void scan_reduce(__global const int *counts, const int count, const int chunk,
                          __global long *sums)
{
    __local long scratch[GROUP_SIZE];
    const int group = (int)get_group_id(0);
    const int first = group * chunk;
    const int end = chunk_end(first, chunk, count);
    long sum = 0, total;
    for (int i = first + (int)get_local_id(0); i < end; i += GROUP_SIZE)
        sum += counts[i];
    group_exclusive_scan(sum, scratch, &total);
    if (get_local_id(0) == 0)
        sums[group] = total;
}

/* The sums become starts. */
__kernel void scan_spine(__global long *sums, const int chunks, __global long *total)
{
    __local long scratch[GROUP_SIZE];
    long carry = 0;
    for (int first = 0; first < chunks; first += GROUP_SIZE) {
        const int i = first + (int)get_local_id(0);
        long sum;
        const long own = i < chunks ? sums[i] : 0L;
        const long before = group_exclusive_scan(own, scratch, &sum);
        if (i < chunks)
            sums[i] = carry + before;
        carry += sum;
    }
    if (get_local_id(0) == 0)
        total[0] = carry;
}

__kernel void scan_apply(__global const int *counts, const int count, const int chunk,
                         __global const long *starts, __global const long *total, const long limit,
                         __global int *offsets)
{
    __local long scratch[GROUP_SIZE];
    const int group = (int)get_group_id(0);
    const int begin = group * chunk;
    const int end = chunk_end(begin, chunk, count);
    const bool fits = total[0] <= limit;
    long carry = starts[group];
    for (int first = begin; first < end; first += GROUP_SIZE) {
        const int i = first + (int)get_local_id(0);
        long sum;
        const long own = i < end ? (long)counts[i] : 0L;
        const long before = group_exclusive_scan(own, scratch, &sum);
        if (i < end)
            offsets[i] = fits ? (int)(carry + before) : 0;
        carry += sum;
    }
    if (group == 0 && get_local_id(0) == 0)
        offsets[count] = fits ? (int)total[0] : 0;
}
