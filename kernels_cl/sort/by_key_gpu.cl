/* A stable radix sort, GPU form: the histogram of the first digit, then a launch per digit.
 *
 * Work-item: every SCAN_GROUP_SIZE-th key of the group's chunk.
 * Work-group: a chunk of the keys, SCAN_GROUP_SIZE work-items; local memory: see
 * sort/group_digit.h. Launch: a work-group per chunk.
 */
#include "sort/group_digit.h"

SORT_GROUP __kernel void sort_histogram(__global const uint *keys, const int count, const int chunk,
                                        const int width, const int bits, __global int *histograms)
{
    __local int counter[DIGITS];
    const SortItems items = {keys, 0, 0, count, chunk};
    const SortPass pass = {0, width, bits, histograms};
    count_digits(&items, &pass, counter);
}

SORT_GROUP __kernel void sort_scatter(__global const uint *keys, __global const int *values,
                                      const int count, const int chunk, const int width,
                                      const int bits, __global int *histograms, const int number,
                                      __global uint *sorted_keys, __global int *sorted_values)
{
    __local SortScratch scratch;
    const SortItems items = {keys, values, 0, count, chunk};
    const SortPass pass = {number, width, bits, histograms};
    const SortedItems sorted = {sorted_keys, sorted_values};
    place_keys(&items, &pass, &sorted, &scratch);
}
