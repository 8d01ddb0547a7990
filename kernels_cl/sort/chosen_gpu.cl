/* The chosen of some items in ascending order of their keys, GPU form: keys of the others become
 * KEY_LAST, which sorts them to the end; by_key_gpu.cl sorts.
 *
 * sort_choose: a work-item owns an item; launch size: at least the number of items. sort_end: one
 * work-item. No local memory. */
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
