/* The gradient of the volume term, the mean product of the scales of the Gaussians.
 *
 * Work-item: VEC Gaussians. Work-group: any; no local memory.
 * Launch: a work-item per VEC Gaussians, rounded up.
 */
#include "common/real.h"
#include "common/rows.h"

/* d_scale += weight * d(product) / *total. Gaussians from number *total on have scales of zero and
 * add nothing. */
__kernel void loss_volume(__global const float *scale, const int count, const float weight,
                          __global const long *total, __global float *d_scale)
{
    const size_t first = get_global_id(0) * VEC;
    if (first >= (size_t)count)
        return;
    const float share = weight / (float)max(*total, 1L);
    const size_t used = min((size_t)VEC, (size_t)count - first);
    fv s[3], d[3];
    load_rows3(scale, first, used, s);
    load_rows3(d_scale, first, used, d);
    for (int i = 0; i < 3; ++i)
        d[i] = fma((fv)(share), s[(i + 1) % 3] * s[(i + 2) % 3], d[i]);
    store_rows3(d, d_scale, first, used);
}
