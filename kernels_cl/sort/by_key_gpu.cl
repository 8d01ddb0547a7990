/* One pass of a stable radix sort, GPU form: histogram and scatter of one digit. The histograms lie
 * chunk by chunk, histogram[chunk * DIGITS + digit]; every work-group of the scatter adds up the
 * counts before its own, which is less work than another launch.
 *
 * A work-group of GROUP_SIZE work-items owns a chunk of the keys. Local memory holds a counter per
 * digit, of which there are GROUP_SIZE, and for every SEGMENT keys which of them have each digit;
 * its atomics only count or set bits, so their order does not matter. Launch size:
 * chunks * GROUP_SIZE. */
#include "common/form.h"
#include "common/chunk.h"
#include "scan/group_scan.h"
#include "sort/digit.h"

#define DIGITS GROUP_SIZE
#define SORT_GROUP GROUP_OF(GROUP_SIZE)
#define SEGMENT 32
#define SEGMENTS (GROUP_SIZE / SEGMENT)

SORT_GROUP __kernel void sort_histogram(__global const uint *keys, const int count, const int chunk,
                                        const int shift, const uint mask, __global int *histogram)
{
    __local int counter[DIGITS];
    const int item = (int)get_local_id(0), group = (int)get_group_id(0);
    const int begin = group * chunk;
    const int end = chunk_end(begin, chunk, count);
    counter[item] = 0;
    barrier(CLK_LOCAL_MEM_FENCE);
    for (int i = begin + item; i < end; i += GROUP_SIZE)
        atomic_inc(&counter[digit_of(keys[i], shift, mask)]);
    barrier(CLK_LOCAL_MEM_FENCE);
    histogram[group * DIGITS + item] = counter[item];
}

/* Where the chunk's first key of each digit goes: after all keys of smaller digits, and those of
 * the same digit in chunks before. Every work-item of the group must call it, for its own digit. */
static inline int first_place(__global const int *histogram, __local long *scratch)
{
    const int digit = (int)get_local_id(0);
    int before = 0, all = 0;
    for (int chunk = 0; chunk < (int)get_num_groups(0); ++chunk) {
        const int own = histogram[chunk * DIGITS + digit];
        before += chunk < (int)get_group_id(0) ? own : 0;
        all += own;
    }
    long total;
    return (int)group_exclusive_scan(all, scratch, &total) + before;
}

/* Keys go to their places GROUP_SIZE at a time. The rank of a key among equal digits is the number
 * of bits set before its own: for each SEGMENT keys and each digit, `having` has a bit per key. */
SORT_GROUP __kernel void sort_scatter(__global const uint *keys, __global const int *values,
                                      const int count, const int chunk, const int shift,
                                      const uint mask, __global const int *histogram,
                                      __global uint *sorted_keys, __global int *sorted_values)
{
    __local long scratch[GROUP_SIZE];
    __local int next[DIGITS];
    __local uint having[SEGMENTS * DIGITS];
    const int item = (int)get_local_id(0), group = (int)get_group_id(0);
    const int begin = group * chunk;
    const int end = chunk_end(begin, chunk, count);
    const int segment = item / SEGMENT;
    const uint own_bit = 1u << item % SEGMENT;
    next[item] = first_place(histogram, scratch);
    for (int i = item; i < SEGMENTS * DIGITS; i += GROUP_SIZE)
        having[i] = 0u;
    barrier(CLK_LOCAL_MEM_FENCE);
    for (int first = begin; first < end; first += GROUP_SIZE) {
        const int i = first + item;
        const uint key = i < end ? keys[i] : 0u;
        const int digit = digit_of(key, shift, mask);
        if (i < end)
            atomic_or(&having[segment * DIGITS + digit], own_bit);
        barrier(CLK_LOCAL_MEM_FENCE);
        int rank = 0, all = 0;
        for (int s = 0; s < SEGMENTS; ++s) {
            const uint bits = having[s * DIGITS + digit];
            rank += (int)popcount(s < segment ? bits : s == segment ? bits & (own_bit - 1u) : 0u);
            all += (int)popcount(bits);
        }
        const int to = next[digit] + rank;
        barrier(CLK_LOCAL_MEM_FENCE);
        if (i < end) {
            sorted_keys[to] = key;
            sorted_values[to] = values[i];
            having[segment * DIGITS + digit] = 0u;
            if (rank + 1 == all)
                next[digit] += all;
        }
        barrier(CLK_LOCAL_MEM_FENCE);
    }
}
