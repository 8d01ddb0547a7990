/* One pass of a stable radix sort, CPU form: histogram and scatter of one digit. The histograms lie
 * digit-major, histogram[digit * chunks + chunk], so that their exclusive prefix sum is the place
 * of the first key of each (digit, chunk).
 *
 * A work-item owns a chunk of the keys, with its counters in private memory. Work-groups of one
 * work-item; launch size: the number of chunks. No local memory. */
#include "common/chunk.h"
#include "sort/digit.h"

#define MAX_DIGITS 2048

__kernel void sort_histogram(__global const uint *keys, const int count, const int chunk,
                             const int chunks, const int shift, const uint mask,
                             __global int *histogram)
{
    int counter[MAX_DIGITS];
    const int index = (int)get_global_id(0);
    const int begin = index * chunk;
    const int end = chunk_end(begin, chunk, count);
    for (int digit = 0; digit <= (int)mask; ++digit)
        counter[digit] = 0;
    for (int i = begin; i < end; ++i)
        ++counter[digit_of(keys[i], shift, mask)];
    for (int digit = 0; digit <= (int)mask; ++digit)
        histogram[digit * chunks + index] = counter[digit];
}

__kernel void sort_scatter(__global const uint *keys, __global const int *values, const int count,
                           const int chunk, const int chunks, const int shift, const uint mask,
                           __global const int *place, __global uint *sorted_keys,
                           __global int *sorted_values)
{
    int next[MAX_DIGITS];
    const int index = (int)get_global_id(0);
    const int begin = index * chunk;
    const int end = chunk_end(begin, chunk, count);
    for (int digit = 0; digit <= (int)mask; ++digit)
        next[digit] = place[digit * chunks + index];
    for (int i = begin; i < end; ++i) {
        const uint key = keys[i];
        const int to = next[digit_of(key, shift, mask)]++;
        sorted_keys[to] = key;
        sorted_values[to] = values[i];
    }
}
