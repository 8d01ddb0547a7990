/* The volume term: the mean product of the scales of the Gaussians.
 *
 * A work-group owns VOLUME_BLOCK Gaussians: on a CPU one work-item, VEC Gaussians at a time; on a
 * GPU ITEMS work-items, with local memory for the sum. Launch size: blocks * work-items of a
 * group. */
#include "common/lanes.h"
#include "common/real.h"
#include "common/rows.h"
#include "loss/group.h"

#ifndef VOLUME_BLOCK
#define VOLUME_BLOCK 256
#endif

/* Block sums of the product of the three scales; d_scale += weight * d(product) / *total. Gaussians
 * from number *total on have scales of zero and add nothing. */
GROUP_SIZED __kernel void loss_volume(__global const float *scale, const int count,
                                      const float weight, __global const long *total,
                                      __global float *d_scale, __global float *sums)
{
    SPACE float4 scratch[ITEMS];
    const float share = weight / (float)max(*total, 1L);
    fv sum = (fv)(0.0f);
    for (int unit = ITEM * VEC; unit < VOLUME_BLOCK; unit += ITEMS * VEC) {
        const size_t first = get_group_id(0) * VOLUME_BLOCK + (size_t)unit;
        if (first >= (size_t)count)
            continue;
        const size_t used = min((size_t)VEC, (size_t)count - first);
        fv s[3], d[3];
        load_rows3(scale, first, used, s);
        load_rows3(d_scale, first, used, d);
        sum += s[0] * s[1] * s[2];
        for (int i = 0; i < 3; ++i)
            d[i] = fma((fv)(share), s[(i + 1) % 3] * s[(i + 2) % 3], d[i]);
        store_rows3(d, d_scale, first, used);
    }
    const float4 block = group_sum((float4)(lane_sum(sum), 0.0f, 0.0f, 0.0f), scratch);
    if (ITEM == 0)
        sums[get_group_id(0)] = block.x;
}
