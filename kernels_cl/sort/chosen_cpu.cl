/* The chosen of some items in ascending order of their keys, CPU form: a stable radix sort in 2 or
 * 3 passes, the fewest that the range of the chosen keys needs. Its first pass leaves the others
 * out. Nothing waits for the host: the passes are planned on the device.
 *
 * sort_plan, sort_starts: one work-item. The others: a work-item owns a chunk of the items and
 * counters of its own. Work-groups of one work-item; launch size: the number of chunks. No local
 * memory. */
#include "common/chunk.h"
#include "sort/digit.h"

#define PLAN_CHOSEN 0 /* number of chosen items, known after the first pass */
#define PLAN_LOW 1    /* smallest key */
#define PLAN_PASSES 2 /* 2 or 3 */
#define PLAN_WIDTH 3  /* bits of a digit, at most MAX_WIDTH */
#define MAX_WIDTH 13
#define COUNTERS (1 << MAX_WIDTH)

static inline int planned_digit(const uint key, __global const int *plan, const int pass)
{
    return (int)(((key - (uint)plan[PLAN_LOW]) >> (pass * plan[PLAN_WIDTH])) &
                 ((1u << plan[PLAN_WIDTH]) - 1u));
}

static inline void clear_counters(__global int *counter, __global const int *plan)
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
