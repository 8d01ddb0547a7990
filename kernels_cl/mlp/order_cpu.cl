/* Sort the samples of each chunk by the slots that they draw: CPU form, a counting sort.
 *
 * Work-item: a chunk of CHUNK samples, with its keys and one counter per key.
 * Work-group: one work-item; no local memory.
 * Launch: a work-item per chunk.
 */
#include "common/real.h"
#include "mlp/layout.h"
#include "mlp/order.h"

/* opacity: (K, padded), in the order of visible (count). output, whose first rows are the
 * opacities, and sorted get them in the new order; active: samples of each chunk that draw
 * something. */
__kernel void mlp_order(__global const float *opacity, __global const int *visible, const int count,
                        const int padded, __global float *output, __global int *sorted,
                        __global int *active)
{
    const size_t stride = (size_t)padded, chunk = get_group_id(0), first = chunk * CHUNK;
    const int samples = min(CHUNK, padded - (int)first);
    int keys[CHUNK], place[KEYS + 1]; /* of the next sample of each key */
    for (int key = 0; key <= KEYS; ++key)
        place[key] = 0;
    for (int i = 0; i < samples; i += VEC)
        STORE_V(sort_keys(opacity + first + i, stride), 0, keys + i);
    for (int i = 0; i < samples; ++i) {
        const size_t v = first + (size_t)i;
        keys[i] = v < (size_t)count && visible[v] >= 0 ? keys[i] : KEY_NO_ANCHOR;
        ++place[keys[i] + 1];
    }
    for (int key = 0; key < KEYS; ++key)
        place[key + 1] += place[key];
    active[chunk] = place[KEY_NONE];
    for (int i = 0; i < samples; ++i)
        move_sample(first + (size_t)i, first + (size_t)place[keys[i]]++, (size_t)count, stride,
                    opacity, visible, output, sorted);
}
