/* One digit of a stable radix sort by work-groups (GPU form only).
 *
 * Histograms lie pass by pass and chunk by chunk, histogram[chunk * DIGITS + digit]. The first one
 * is counted by a launch of its own; each pass that writes keys to their places counts the digits
 * of the next one there. A work-group of SCAN_GROUP_SIZE work-items owns a chunk of the keys.
 * Atomics only count or set bits, so their order does not matter. */
#ifndef CLGS_GROUP_DIGIT_H
#define CLGS_GROUP_DIGIT_H

#include "common/chunk.h"
#include "common/form.h"
#include "scan/group_scan.h"
#include "sort/digit.h"

#define DIGITS SCAN_GROUP_SIZE
#define SORT_GROUP GROUP_OF(SCAN_GROUP_SIZE)
#define SEGMENT 32
#define SEGMENTS (SCAN_GROUP_SIZE / SEGMENT)

/* What a launch sorts. chosen: items with a number above 0 take part; null: all. values: null: the
 * value of an item is its number. */
typedef struct {
    __global const uint *keys;
    __global const int *values, *chosen;
    int count, chunk;
} SortItems;

/* A pass of a sort by the low `bits` bits of the keys, `width` of them at a time. */
typedef struct {
    int number, width, bits;
    volatile __global int *histograms;
} SortPass;

typedef struct {
    __global uint *keys;
    __global int *values;
} SortedItems;

/* Local memory of a pass. next: the place of the next key of each digit. having: for each SEGMENT
 * keys and each digit, which of them have it, a bit per key. */
typedef struct {
    long scan[SCAN_SCRATCH];
    int next[DIGITS];
    uint having[SEGMENTS * DIGITS];
} SortScratch;

static inline int digit_of_pass(const uint key, const SortPass *pass, const int number)
{
    const int shift = number * pass->width;
    return digit_of(key, shift, (1u << min(pass->width, pass->bits - shift)) - 1u);
}

static inline volatile __global int *histogram_of(const SortPass *pass, const int number)
{
    return pass->histograms + number * (int)get_num_groups(0) * DIGITS;
}

static inline bool has_pass(const SortPass *pass, const int number)
{
    return number * pass->width < pass->bits;
}

static inline bool takes_part(const SortItems *items, const int i, const int end)
{
    return i < end && (items->chosen == 0 || items->chosen[i] > 0);
}

/* Counts the first digit in the group's chunk, and clears its part of the later histograms. */
static inline void count_digits(const SortItems *items, const SortPass *pass, __local int *counter)
{
    const int item = (int)get_local_id(0), group = (int)get_group_id(0);
    const int begin = group * items->chunk;
    const int end = chunk_end(begin, items->chunk, items->count);
    counter[item] = 0;
    barrier(CLK_LOCAL_MEM_FENCE);
    for (int i = begin + item; i < end; i += SCAN_GROUP_SIZE)
        if (takes_part(items, i, end))
            atomic_inc(&counter[digit_of_pass(items->keys[i], pass, 0)]);
    barrier(CLK_LOCAL_MEM_FENCE);
    for (int number = 0; has_pass(pass, number); ++number)
        histogram_of(pass, number)[group * DIGITS + item] = number == 0 ? counter[item] : 0;
}

/* Sets the place of the chunk's first key of each digit: after all keys of smaller digits, and
 * those of the same digit in chunks before. Returns how many keys there are. */
static inline int find_places(volatile __global const int *histogram, __local SortScratch *scratch)
{
    const int digit = (int)get_local_id(0);
    int before = 0, all = 0;
    for (int chunk = 0; chunk < (int)get_num_groups(0); ++chunk) {
        const int own = histogram[chunk * DIGITS + digit];
        before += chunk < (int)get_group_id(0) ? own : 0;
        all += own;
    }
    long total;
    scratch->next[digit] = (int)group_exclusive_scan(all, scratch->scan, &total) + before;
    return (int)total;
}

/* Where the key of a work-item goes: the rank among equal digits is the number of bits set before
 * its own. The last of each digit moves its next place on. Every work-item of the group must call
 * it; one without a key gets a number that means nothing. */
static inline int next_place(__local SortScratch *scratch, const bool used, const int digit)
{
    const int segment = (int)get_local_id(0) / SEGMENT;
    const uint own_bit = 1u << (int)get_local_id(0) % SEGMENT;
    if (used)
        atomic_or(&scratch->having[segment * DIGITS + digit], own_bit);
    barrier(CLK_LOCAL_MEM_FENCE);
    int rank = 0, all = 0;
    for (int s = 0; s < SEGMENTS; ++s) {
        const uint bits = scratch->having[s * DIGITS + digit];
        rank += (int)popcount(s < segment ? bits : s == segment ? bits & (own_bit - 1u) : 0u);
        all += (int)popcount(bits);
    }
    const int to = scratch->next[digit] + rank;
    barrier(CLK_LOCAL_MEM_FENCE);
    if (used) {
        scratch->having[segment * DIGITS + digit] = 0u;
        if (rank + 1 == all)
            scratch->next[digit] += all;
    }
    barrier(CLK_LOCAL_MEM_FENCE);
    return to;
}

/* Writes the keys of the group's chunk to their places, SCAN_GROUP_SIZE at a time, and counts there
 * the digits of the next pass. Returns how many keys all chunks have. */
static inline int place_keys(const SortItems *items, const SortPass *pass, const SortedItems *out,
                             __local SortScratch *scratch)
{
    const int item = (int)get_local_id(0), groups = (int)get_num_groups(0);
    const int begin = (int)get_group_id(0) * items->chunk;
    const int end = chunk_end(begin, items->chunk, items->count);
    const int total = find_places(histogram_of(pass, pass->number), scratch);
    volatile __global int *next = histogram_of(pass, pass->number + 1);
    const int next_chunk = max(1, (total + groups - 1) / groups);
    for (int i = item; i < SEGMENTS * DIGITS; i += SCAN_GROUP_SIZE)
        scratch->having[i] = 0u;
    barrier(CLK_LOCAL_MEM_FENCE);
    for (int first = begin; first < end; first += SCAN_GROUP_SIZE) {
        const int i = first + item;
        const bool used = takes_part(items, i, end);
        const uint key = used ? items->keys[i] : 0u;
        const int to = next_place(scratch, used, digit_of_pass(key, pass, pass->number));
        if (!used)
            continue;
        out->keys[to] = key;
        out->values[to] = items->values == 0 ? i : items->values[i];
        if (has_pass(pass, pass->number + 1)) {
            const int digit = digit_of_pass(key, pass, pass->number + 1);
            atomic_inc(&next[to / next_chunk * DIGITS + digit]);
        }
    }
    return total;
}

#endif
