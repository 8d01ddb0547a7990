/* Statistics that decide where anchors grow and which are pruned. Every anchor and every slot
 * appears at most once in a view: plain additions, no atomics. Nothing happens unless *stop is 0.
 */
#include "include/real.h"

#ifndef K_OFFSETS
#define K_OFFSETS 10
#endif

/* One work-item a visible anchor: the sum of its positive opacities, and one visit. An entry -1 of
 * visible is no anchor. */
__kernel void density_visit(__global const float *output, __global const int *visible,
                            const int count, const int padded, __global const int *stop,
                            __global float *opacity_sum, __global int *visits)
{
    const size_t v = get_global_id(0);
    if (v >= (size_t)count || visible[v] < 0 || *stop != 0)
        return;
    float sum = 0.0f;
    for (size_t j = 0; j < K_OFFSETS; ++j) {
        const float opacity = output[j * (size_t)padded + v];
        sum += opacity > 0.0f ? opacity : 0.0f;
    }
    opacity_sum[visible[v]] += sum;
    visits[visible[v]] += 1;
}

/* One work-item a Gaussian: the norm of its screen gradient in NDC units, where it is drawn.
 * Padding, of slot -1, never is. */
__kernel void density_gradient(__global const int *visible, __global const int *slot,
                               __global const float *extent, __global const float *d_mean2d,
                               const int count, const float2 half_size, __global const int *stop,
                               __global float *gradient_sum, __global int *gradient_count)
{
    const size_t n = get_global_id(0);
    if (n >= (size_t)count || !(extent[2 * n] > 0.0f) || *stop != 0)
        return;
    const size_t index =
        (size_t)visible[slot[n] / K_OFFSETS] * K_OFFSETS + (size_t)(slot[n] % K_OFFSETS);
    const float2 gradient = vload2(n, d_mean2d) * half_size;
    gradient_sum[index] += sqrt(fma(gradient.x, gradient.x, gradient.y * gradient.y));
    gradient_count[index] += 1;
}
