/* Gradients of the views of a batch, added up one view after the other.
 *
 * batch_add: a work-item per vector of VEC elements.
 * Work-group: any; no local memory.
 */
#include "common/lanes.h"
#include "common/real.h"

/* sum = (sum + gradient) * scale, `total` elements. */
__kernel void batch_add(__global float *sum, __global const float *gradient, const uint total,
                        const float scale)
{
    const size_t vector = get_global_id(0);
    if (vector >= vectors_in(total))
        return;
    const fv added = load_lanes(sum, vector, total) + load_lanes(gradient, vector, total);
    store_lanes(added * scale, vector, sum, total);
}
