/* Exclusive prefix sum with a 64-bit total, GPU form: every chunk is scanned from the sum of the
 * counts before it, which are parts whose sums are known (scan/part_sums.h), or are found by
 * scan_reduce, a part per chunk. Sums of integers: the result does not depend on parts and chunks.
 * Sums above the limit are of no use: all offsets are 0 then.
 *
 * A work-group of SCAN_GROUP_SIZE work-items owns a chunk, whole parts; launch size:
 * chunks * SCAN_GROUP_SIZE. Local memory holds a number per work-item. */
#include "common/chunk.h"
#include "scan/group_scan.h"

/* Neighbouring numbers that a work-item scans on its own. */
#define EACH 4

/* What this work-item takes part in adding up of the counts of a chunk. */
static inline long own_sum(__global const int *counts, const int first, const int end)
{
    long sum = 0;
    for (int i = first + (int)get_local_id(0); i < end; i += SCAN_GROUP_SIZE)
        sum += counts[i];
    return sum;
}

SCAN_GROUP __kernel void scan_reduce(__global const int *counts, const int count, const int chunk,
                                     __global long *sums)
{
    __local long scratch[SCAN_SCRATCH];
    const int group = (int)get_group_id(0), first = group * chunk;
    long sum;
    group_exclusive_scan(own_sum(counts, first, chunk_end(first, chunk, count)), scratch, &sum);
    if (get_local_id(0) == 0)
        sums[group] = sum;
}

SCAN_GROUP __kernel void scan_apply(__global const int *counts, const int count, const int chunk,
                                    __global const long *sums, const int parts, const int part,
                                    const long limit, __global long *total, __global int *offsets)
{
    __local long scratch[SCAN_SCRATCH];
    const int begin = (int)get_group_id(0) * chunk;
    const int end = chunk_end(begin, chunk, count);
    long own_all = 0, own_before = 0, all, carry;
    for (int i = (int)get_local_id(0); i < parts; i += SCAN_GROUP_SIZE) {
        own_all += sums[i];
        own_before += i < begin / part ? sums[i] : 0L;
    }
    group_exclusive_scan(own_all, scratch, &all);
    group_exclusive_scan(own_before, scratch, &carry);
    const bool fits = all <= limit;
    for (int first = begin; first < end; first += EACH * SCAN_GROUP_SIZE) {
        const int own = first + EACH * (int)get_local_id(0);
        long sum = 0, all_here;
        for (int i = own; i < min(own + EACH, end); ++i)
            sum += counts[i];
        long before = carry + group_exclusive_scan(sum, scratch, &all_here);
        for (int i = own; i < min(own + EACH, end); ++i) {
            offsets[i] = fits ? (int)before : 0;
            before += counts[i];
        }
        carry += all_here;
    }
    if (get_global_id(0) == 0) {
        offsets[count] = fits ? (int)all : 0;
        total[0] = all;
    }
}
