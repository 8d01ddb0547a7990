/* The chosen of some items in ascending order of their keys, GPU form: a stable radix sort whose
 * first pass leaves the others out. Nothing waits for the host: later passes divide what is left
 * among the same number of work-groups.
 *
 * Work-item: every SCAN_GROUP_SIZE-th item of the group's chunk.
 * Work-group: a chunk of the items, SCAN_GROUP_SIZE work-items; local memory: see
 * sort/group_digit.h. Launch: a work-group per chunk.
 */
#include "sort/group_digit.h"

SORT_GROUP __kernel void sort_count_chosen(__global const uint *keys, __global const int *chosen,
                                           const int count, const int chunk, const int width,
                                           const int bits, __global int *histograms)
{
    __local int counter[DIGITS];
    const SortItems items = {keys, 0, chosen, count, chunk};
    const SortPass pass = {0, width, bits, histograms};
    count_digits(&items, &pass, counter);
}

/* First pass: keys and numbers of the chosen items, and how many they are. */
SORT_GROUP __kernel void sort_place_chosen(__global const uint *keys, __global const int *chosen,
                                           const int count, const int chunk, const int width,
                                           const int bits, __global int *histograms,
                                           __global int *chosen_count, __global uint *sorted_keys,
                                           __global int *order)
{
    __local SortScratch scratch;
    const SortItems items = {keys, 0, chosen, count, chunk};
    const SortPass pass = {0, width, bits, histograms};
    const SortedItems sorted = {sorted_keys, order};
    const int total = place_keys(&items, &pass, &sorted, &scratch);
    if (get_global_id(0) == 0)
        chosen_count[0] = total;
}

/* A later pass, over as many items as there are. */
SORT_GROUP __kernel void sort_place_next(__global const uint *keys, __global const int *values,
                                         const int width, const int bits, __global int *histograms,
                                         __global const int *chosen_count, const int number,
                                         __global uint *sorted_keys, __global int *order)
{
    __local SortScratch scratch;
    const int count = chosen_count[0], groups = (int)get_num_groups(0);
    const SortItems items = {keys, values, 0, count, max(1, (count + groups - 1) / groups)};
    const SortPass pass = {number, width, bits, histograms};
    const SortedItems sorted = {sorted_keys, order};
    place_keys(&items, &pass, &sorted, &scratch);
}
