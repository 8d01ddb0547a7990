/* One pass of a stable radix sort, GPU form: histogram and scatter of one digit. The histograms lie
 * digit-major, histogram[digit * chunks + chunk], so that their exclusive prefix sum is the place
 * of the first key of each (digit, chunk).
 *
 * A work-group of GROUP_SIZE work-items owns a chunk of the keys. Local memory holds a counter per
 * digit, of which there are at most GROUP_SIZE, and the digits of GROUP_SIZE keys; its atomics only
 * count, so their order does not matter. Launch size: chunks * GROUP_SIZE. */
#include "common/chunk.h"
#include "sort/digit.h"

#define GROUP_SIZE 256

__kernel void sort_histogram(__global const uint *keys, const int count, const int chunk,
                             const int chunks, const int shift, const uint mask,
                             __global int *histogram)
{
    __local int counter[GROUP_SIZE];
    const int item = (int)get_local_id(0), group = (int)get_group_id(0);
    const int begin = group * chunk;
    const int end = chunk_end(begin, chunk, count);
    counter[item] = 0;
    barrier(CLK_LOCAL_MEM_FENCE);
    for (int i = begin + item; i < end; i += GROUP_SIZE)
        atomic_inc(&counter[digit_of(keys[i], shift, mask)]);
    barrier(CLK_LOCAL_MEM_FENCE);
    if ((uint)item <= mask)
        histogram[item * chunks + group] = counter[item];
}

/* Keys go to their places GROUP_SIZE at a time; the rank of a key among equal digits is counted. */
__kernel void sort_scatter(__global const uint *keys, __global const int *values, const int count,
                           const int chunk, const int chunks, const int shift, const uint mask,
                           __global const int *place, __global uint *sorted_keys,
                           __global int *sorted_values)
{
    __local int next[GROUP_SIZE];
    __local int digits[GROUP_SIZE];
    const int item = (int)get_local_id(0), group = (int)get_group_id(0);
    const int begin = group * chunk;
    const int end = chunk_end(begin, chunk, count);
    next[item] = (uint)item <= mask ? place[item * chunks + group] : 0;
    for (int first = begin; first < end; first += GROUP_SIZE) {
        const int i = first + item;
        const uint key = i < end ? keys[i] : 0u;
        const int digit = i < end ? digit_of(key, shift, mask) : -1;
        digits[item] = digit;
        barrier(CLK_LOCAL_MEM_FENCE);
        int rank = 0;
        for (int j = 0; j < GROUP_SIZE; ++j)
            rank += j < item && digits[j] == digit ? 1 : 0;
        const int to = i < end ? next[digit] + rank : 0;
        barrier(CLK_LOCAL_MEM_FENCE);
        if (i < end) {
            sorted_keys[to] = key;
            sorted_values[to] = values[i];
            atomic_inc(&next[digit]);
        }
        barrier(CLK_LOCAL_MEM_FENCE);
    }
}
