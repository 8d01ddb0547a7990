/* The chosen of some items in ascending order of their keys, CPU form: a stable radix sort in two
 * passes, with digits as wide as the range of the chosen keys needs. Its first pass leaves the
 * others out. Nothing waits for the host: the passes are planned on the device.
 *
 * sort_starts: one work-item. The others: a work-item owns a chunk of the items and counters of its
 * own. Work-groups of one work-item; launch size: the number of chunks. No local memory. */
#include "common/chunk.h"

#define PLAN_CHOSEN 0 /* number of chosen items, known after the first pass */
#define PLAN_LOW 1    /* smallest key */
#define PLAN_WIDTH 2  /* bits of a digit, at most MAX_WIDTH */
#ifndef PLAN_SIZE
#define PLAN_SIZE 3
#endif
#ifndef MAX_WIDTH
#define MAX_WIDTH 16
#endif
#define COUNTERS (1 << MAX_WIDTH)

static inline int planned_digit(const uint key, __global const int *plan, const int pass)
{
    return (int)(((key - (uint)plan[PLAN_LOW]) >> (pass * plan[PLAN_WIDTH])) &
                 ((1u << plan[PLAN_WIDTH]) - 1u));
}

static inline void clear_counters(__global int *counter, const int width)
{
    for (int digit = 0; digit < 1 << width; ++digit)
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

/* Smallest chosen key, and bits of a digit. */
static inline int2 planned(__global const uint *ranges)
{
    uint low = 0xffffffffu, high = 0u;
    for (size_t chunk = 0; chunk < get_global_size(0); ++chunk) {
        low = min(low, ranges[2 * chunk]);
        high = max(high, ranges[2 * chunk + 1]);
    }
    const int bits = high > low ? 32 - (int)clz(high - low) : 1;
    return (int2)((int)low, (bits + 1) / 2);
}

/* Keys of every digit in every chunk, (chunks, COUNTERS); and the plan for what follows. */
__kernel void sort_count_chosen(__global const uint *keys, __global const int *chosen,
                                const int count, __global const uint *ranges, __global int *plan,
                                __global int *counters)
{
    const Chunk own = own_chunk(count);
    const int2 plan_of_all = planned(ranges);
    const uint low = (uint)plan_of_all.x, mask = (1u << plan_of_all.y) - 1u;
    __global int *counter = counters + get_global_id(0) * COUNTERS;
    clear_counters(counter, plan_of_all.y);
    for (int i = own.begin; i < own.end; ++i)
        if (chosen[i] > 0)
            ++counter[(keys[i] - low) & mask];
    if (get_global_id(0) == 0) {
        plan[PLAN_LOW] = plan_of_all.x;
        plan[PLAN_WIDTH] = plan_of_all.y;
    }
}

__kernel void sort_count_pairs(__global const uint *pairs, __global const int *plan,
                               __global int *counters)
{
    const Chunk own = own_chunk(plan[PLAN_CHOSEN]);
    __global int *counter = counters + get_global_id(0) * COUNTERS;
    clear_counters(counter, plan[PLAN_WIDTH]);
    for (int i = own.begin; i < own.end; ++i)
        ++counter[planned_digit(pairs[2 * (size_t)i], plan, 1)];
}

/* Counters become places, digit by digit; one work-item. */
__kernel void sort_starts(__global int *counters, const int chunks, __global int *plan)
{
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

/* Second pass: the indices alone. */
__kernel void sort_place_pairs(__global const uint *pairs, __global const int *plan,
                               __global int *places, __global int *order)
{
    const Chunk own = own_chunk(plan[PLAN_CHOSEN]);
    __global int *next = places + get_global_id(0) * COUNTERS;
    for (int i = own.begin; i < own.end; ++i) {
        const uint2 pair = vload2((size_t)i, pairs);
        order[next[planned_digit(pair.x, plan, 1)]++] = (int)pair.y;
    }
}
