/* One pass of a stable radix sort: histogram and scatter of one digit. The histograms lie
 * digit-major, histogram[digit * chunks + chunk], so that their exclusive prefix sum is the place
 * of the first key of each (digit, chunk). A chunk belongs to one work-item on a CPU, to one
 * work-group on a GPU. Local atomics only count: their order does not matter. */
#include "common/chunk.h"

#ifndef USE_LOCAL
#define USE_LOCAL 0
#endif
#ifndef GROUP_SIZE
#define GROUP_SIZE 256
#endif
#ifndef MAX_DIGITS
#define MAX_DIGITS 2048
#endif

inline int digit_of(uint key, int shift, uint mask)
{
    return (int)((key >> shift) & mask);
}

#if USE_LOCAL

__kernel void sort_histogram(__global const uint *keys, const int count, const int chunk,
                             const int chunks, const int shift, const uint mask,
                             __global int *histogram)
{
    __local int counter[GROUP_SIZE];
    const int item = (int)get_local_id(0), group = (int)get_group_id(0);
    const int begin = group * chunk;
    const int end = count - begin < chunk ? count : begin + chunk;
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
    const int end = count - begin < chunk ? count : begin + chunk;
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

#else

__kernel void sort_histogram(__global const uint *keys, const int count, const int chunk,
                             const int chunks, const int shift, const uint mask,
                             __global int *histogram)
{
    int counter[MAX_DIGITS];
    const int index = (int)get_global_id(0);
    const int begin = index * chunk;
    const int end = count - begin < chunk ? count : begin + chunk;
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
    const int end = count - begin < chunk ? count : begin + chunk;
    for (int digit = 0; digit <= (int)mask; ++digit)
        next[digit] = place[digit * chunks + index];
    for (int i = begin; i < end; ++i) {
        const uint key = keys[i];
        const int to = next[digit_of(key, shift, mask)]++;
        sorted_keys[to] = key;
        sorted_values[to] = values[i];
    }
}

#endif

/* ---- the chosen of some items, for a sort by key ---- */
#define KEY_LAST 0xffffffffu

/* Keys of the chosen items, KEY_LAST of the others; and their indices. */
__kernel void sort_choose(__global const uint *keys, __global const int *chosen, const int count,
                          __global uint *chosen_keys, __global int *index)
{
    const int i = (int)get_global_id(0);
    if (i >= count)
        return;
    chosen_keys[i] = chosen[i] > 0 ? keys[i] : KEY_LAST;
    index[i] = i;
}

/* Number of sorted keys before KEY_LAST, by halving; one work-item. */
__kernel void sort_end(__global const uint *sorted_keys, const int count, __global int *end)
{
    int low = 0, high = count;
    while (low < high) {
        const int middle = low + (high - low) / 2;
        if (sorted_keys[middle] < KEY_LAST)
            low = middle + 1;
        else
            high = middle;
    }
    end[0] = low;
}

/* ---- the chosen of some items in ascending order of their keys, in 2 or 3 passes: the fewest that
 * the range of their keys needs. The first pass leaves the others out. ---- */
#define PLAN_CHOSEN 0 /* number of chosen items, known after the first pass */
#define PLAN_LOW 1    /* smallest key */
#define PLAN_PASSES 2 /* 2 or 3 */
#define PLAN_WIDTH 3  /* bits of a digit, at most MAX_WIDTH */
#define MAX_WIDTH 13
#define COUNTERS (1 << MAX_WIDTH)

inline int planned_digit(const uint key, __global const int *plan, const int pass)
{
    return (int)(((key - (uint)plan[PLAN_LOW]) >> (pass * plan[PLAN_WIDTH])) &
                 ((1u << plan[PLAN_WIDTH]) - 1u));
}

inline void clear_counters(__global int *counter, __global const int *plan)
{
    for (int digit = 0; digit < 1 << plan[PLAN_WIDTH]; ++digit)
        counter[digit] = 0;
}

/* Smallest and largest chosen key of every chunk. */
__kernel void sort_range(__global const uint *keys, __global const int *chosen, const int count,
                         __global uint *ranges)
{
    const Chunk own = own_chunk(count);
    uint low = 0xffffffffu, high = 0u;
    for (int i = own.begin; i < own.end; ++i) {
        low = chosen[i] > 0 ? min(low, keys[i]) : low;
        high = chosen[i] > 0 ? max(high, keys[i]) : high;
    }
    ranges[2 * get_global_id(0)] = low;
    ranges[2 * get_global_id(0) + 1] = high;
}

/* One work-item. */
__kernel void sort_plan(__global const uint *ranges, const int chunks, __global int *plan)
{
    uint low = 0xffffffffu, high = 0u;
    for (int chunk = 0; chunk < chunks; ++chunk) {
        low = min(low, ranges[2 * chunk]);
        high = max(high, ranges[2 * chunk + 1]);
    }
    const int bits = high > low ? 32 - (int)clz(high - low) : 1;
    plan[PLAN_LOW] = (int)low;
    plan[PLAN_PASSES] = bits <= 2 * MAX_WIDTH ? 2 : 3;
    plan[PLAN_WIDTH] = (bits + plan[PLAN_PASSES] - 1) / plan[PLAN_PASSES];
}

/* Keys of every digit in every chunk, (chunks, COUNTERS). */
__kernel void sort_count_chosen(__global const uint *keys, __global const int *chosen,
                                const int count, __global const int *plan, __global int *counters)
{
    const Chunk own = own_chunk(count);
    __global int *counter = counters + get_global_id(0) * COUNTERS;
    clear_counters(counter, plan);
    for (int i = own.begin; i < own.end; ++i)
        if (chosen[i] > 0)
            ++counter[planned_digit(keys[i], plan, 0)];
}

__kernel void sort_count_pairs(__global const uint *pairs, __global const int *plan, const int pass,
                               __global int *counters)
{
    if (pass >= plan[PLAN_PASSES])
        return;
    const Chunk own = own_chunk(plan[PLAN_CHOSEN]);
    __global int *counter = counters + get_global_id(0) * COUNTERS;
    clear_counters(counter, plan);
    for (int i = own.begin; i < own.end; ++i)
        ++counter[planned_digit(pairs[2 * i], plan, pass)];
}

/* Counters become places, digit by digit; one work-item. */
__kernel void sort_starts(__global int *counters, const int chunks, const int pass,
                          __global int *plan)
{
    if (pass >= plan[PLAN_PASSES])
        return;
    int place = 0;
    for (int digit = 0; digit < 1 << plan[PLAN_WIDTH]; ++digit)
        for (int chunk = 0; chunk < chunks; ++chunk) {
            const int own = counters[chunk * COUNTERS + digit];
            counters[chunk * COUNTERS + digit] = place;
            place += own;
        }
    plan[PLAN_CHOSEN] = place;
}

/* First pass: (key, index) of the chosen items. */
__kernel void sort_place_chosen(__global const uint *keys, __global const int *chosen,
                                const int count, __global const int *plan, __global int *places,
                                __global uint *pairs)
{
    const Chunk own = own_chunk(count);
    __global int *next = places + get_global_id(0) * COUNTERS;
    for (int i = own.begin; i < own.end; ++i)
        if (chosen[i] > 0) {
            const int to = next[planned_digit(keys[i], plan, 0)]++;
            vstore2((uint2)(keys[i], (uint)i), (size_t)to, pairs);
        }
}

/* A further pass; the last one writes the indices alone. */
__kernel void sort_place_pairs(__global const uint *pairs, __global const int *plan, const int pass,
                               __global int *places, __global uint *placed, __global int *order)
{
    const int passes = plan[PLAN_PASSES];
    if (pass >= passes)
        return;
    const Chunk own = own_chunk(plan[PLAN_CHOSEN]);
    __global int *next = places + get_global_id(0) * COUNTERS;
    for (int i = own.begin; i < own.end; ++i) {
        const uint2 pair = vload2((size_t)i, pairs);
        const int to = next[planned_digit(pair.x, plan, pass)]++;
        if (pass + 1 == passes)
            order[to] = (int)pair.y;
        else
            vstore2(pair, (size_t)to, placed);
    }
}
