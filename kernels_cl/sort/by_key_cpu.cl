/* One pass of a stable radix sort, CPU form: histogram and scatter of one digit. The histograms lie
 * chunk by chunk, histogram[chunk * DIGITS + digit]; every chunk adds up the counts before its own.
 *
 * A work-item owns a chunk of the keys, with its counters in private memory. Work-groups of one
 * work-item; launch size: the number of chunks. No local memory. */
#include "common/chunk.h"
#include "sort/digit.h"

#ifndef DIGIT_BITS
#define DIGIT_BITS 11
#endif
#define DIGITS (1 << DIGIT_BITS)

__kernel void sort_histogram(__global const uint *keys, const int count, const int chunk,
                             const int shift, const uint mask, __global int *histogram)
{
    int counter[DIGITS];
    const int index = (int)get_global_id(0);
    const int begin = index * chunk;
    const int end = chunk_end(begin, chunk, count);
    for (int digit = 0; digit <= (int)mask; ++digit)
        counter[digit] = 0;
    for (int i = begin; i < end; ++i)
        ++counter[digit_of(keys[i], shift, mask)];
    for (int digit = 0; digit <= (int)mask; ++digit)
        histogram[index * DIGITS + digit] = counter[digit];
}

__kernel void sort_scatter(__global const uint *keys, __global const int *values, const int count,
                           const int chunk, const int shift, const uint mask,
                           __global const int *histogram, __global uint *sorted_keys,
                           __global int *sorted_values)
{
    int next[DIGITS];
    const int index = (int)get_global_id(0), chunks = (int)get_global_size(0);
    const int begin = index * chunk;
    const int end = chunk_end(begin, chunk, count);
    int smaller = 0; /* keys of smaller digits */
    for (int digit = 0; digit <= (int)mask; ++digit) {
        next[digit] = smaller;
        for (int other = 0; other < chunks; ++other) {
            const int own = histogram[other * DIGITS + digit];
            next[digit] += other < index ? own : 0;
            smaller += own;
        }
    }
    for (int i = begin; i < end; ++i) {
        const uint key = keys[i];
        const int to = next[digit_of(key, shift, mask)]++;
        sorted_keys[to] = key;
        sorted_values[to] = values[i];
    }
}
