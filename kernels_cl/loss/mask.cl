/* Masks of photos: the pixels of a picture that are not used become zero, and so do their
 * gradients.
 *
 * mask_apply: a work-item per vector of pixels. A number that is not finite stays not finite.
 */
#include "common/lanes.h"
#include "common/real.h"

/* masked = used * planes; three planes of `total` pixels, used 0 or 1. */
__kernel void mask_apply(__global const float *planes, __global const uchar *used, const uint total,
                         __global float *masked)
{
    const size_t vector = get_global_id(0);
    if (vector >= vectors_in(total))
        return;
    float lanes[VEC];
    for (size_t lane = 0; lane < VEC; ++lane)
        lanes[lane] = vector * VEC + lane < total ? (float)used[vector * VEC + lane] : 0.0f;
    const fv factor = LOAD_V(0, lanes);
    for (size_t k = 0; k < 3; ++k) {
        const size_t plane = k * (size_t)total;
        const fv value = load_lanes(planes + plane, vector, total);
        store_lanes(factor * value, vector, masked + plane, total);
    }
}
