/* One pass of a stable radix sort: histogram and scatter of one digit. The histograms lie
 * digit-major, histogram[digit * chunks + chunk], so that their exclusive prefix sum is the place
 * of the first key of each (digit, chunk). A chunk belongs to one work-item on a CPU, to one
 * work-group on a GPU. Local atomics only count: their order does not matter. */

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
