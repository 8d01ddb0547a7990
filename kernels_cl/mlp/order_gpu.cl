/* Sort the samples of each chunk by the slots that they draw: GPU form, by counting for each sample
 * how many others come before it.
 *
 * Work-item: every GROUP_SIZE-th sample of the chunk.
 * Work-group: a chunk of CHUNK samples, GROUP_SIZE work-items; the keys lie in local memory.
 * Launch: a work-group per chunk.
 */
#include "common/form.h"
#include "mlp/layout.h"
#include "mlp/order.h"

#define ORDER_GROUP GROUP_OF(GROUP_SIZE)

/* opacity: (K, padded), in the order of visible (count). output, whose first rows are the
 * opacities, and sorted get them in the new order; active: samples of each chunk that draw
 * something. */
ORDER_GROUP __kernel void mlp_order(__global const float *opacity, __global const int *visible,
                                    const int count, const int padded, __global float *output,
                                    __global int *sorted, __global int *active)
{
    const size_t stride = (size_t)padded, chunk = get_group_id(0), first = chunk * CHUNK;
    const int samples = min(CHUNK, padded - (int)first);
    __local int keys[CHUNK];
    for (int i = (int)get_local_id(0); i < samples; i += GROUP_SIZE) {
        const size_t v = first + (size_t)i;
        const bool anchor = v < (size_t)count && visible[v] >= 0;
        keys[i] = anchor ? sort_keys(opacity + v, stride) : KEY_NO_ANCHOR;
    }
    barrier(CLK_LOCAL_MEM_FENCE);
    for (int i = (int)get_local_id(0); i < samples; i += GROUP_SIZE) {
        int rank = 0, drawn = 0;
        for (int other = 0; other < samples; ++other) {
            rank += keys[other] < keys[i] || (keys[other] == keys[i] && other < i) ? 1 : 0;
            drawn += keys[other] < KEY_NONE ? 1 : 0;
        }
        move_sample(first + (size_t)i, first + (size_t)rank, (size_t)count, stride, opacity,
                    visible, output, sorted);
        if (i == 0)
            active[chunk] = drawn;
    }
}
