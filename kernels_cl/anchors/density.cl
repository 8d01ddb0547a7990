/* Statistics that decide where anchors grow and which are pruned. Every anchor and every slot
 * appears at most once in a view: plain additions, no atomics. In density_visit and
 * density_gradient nothing happens unless *stop is 0.
 *
 * density_visit, density_importance: a work-item per visible anchor.
 * density_gradient: a work-item per SHARE Gaussians, counted from the middle on.
 * density_curvature: a work-item per VEC elements.
 * Work-group: any; no local memory.
 */
#include "common/form.h"
#include "common/items.h"
#include "common/lanes.h"
#include "common/method.h"
#include "common/prefetch.h"
#include "common/real.h"

/* Gaussians of a work-item: a CPU prefetches their sums together. */
#ifndef SHARE
#define SHARE (USE_LOCAL ? 1 : 32)
#endif

/* Adds to each visible anchor the sum of its positive opacities, and one visit. An entry -1 of
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

/* Index of the sums of Gaussian n; -1 if it is not drawn. Padding, of slot -1, never is. */
static inline int place_of(__global const int *visible, __global const int *slot,
                           __global const float *extent, const size_t n)
{
    if (!(extent[2 * n] > 0.0f))
        return -1;
    return visible[slot[n] / K_OFFSETS] * K_OFFSETS + slot[n] % K_OFFSETS;
}

/* Adds to the slot of each Gaussian that is drawn the norm of its screen gradient, in NDC units,
 * and one view. */
__kernel void density_gradient(__global const int *visible, __global const int *slot,
                               __global const float *extent, __global const float *d_mean2d,
                               const int count, const float2 half_size, __global const int *stop,
                               __global float *gradient_sum, __global int *gradient_count)
{
    const size_t first = item_from_middle() * SHARE;
    if (first >= (size_t)count || *stop != 0)
        return;
    int place[SHARE];
    const size_t size = min((size_t)count - first, (size_t)SHARE);
    for (size_t i = 0; i < size; ++i) {
        place[i] = place_of(visible, slot, extent, first + i);
        PREFETCH_WRITE(gradient_sum + max(place[i], 0));
        PREFETCH_WRITE(gradient_count + max(place[i], 0));
    }
    for (size_t i = 0; i < size; ++i) {
        if (place[i] < 0)
            continue;
        const float2 gradient = vload2(first + i, d_mean2d) * half_size;
        gradient_sum[place[i]] += sqrt(fma(gradient.x, gradient.x, gradient.y * gradient.y));
        gradient_count[place[i]] += 1;
    }
}

/* Adds to each visible anchor the square of the sum of opacity times derivative by it over its
 * Gaussians, which are numbers first[v] to first[v + 1] of `gaussians`, and marks it as seen. */
__kernel void density_importance(__global const int *visible, __global const int *first,
                                 const int count, const int gaussians,
                                 __global const float *opacity, __global const float *d_opacity,
                                 __global float *importance, __global int *seen)
{
    const size_t v = get_global_id(0);
    if (v >= (size_t)count || visible[v] < 0)
        return;
    const int end = min(first[v + 1], gaussians);
    float sum = 0.0f;
    for (int n = first[v]; n < end; ++n)
        sum = fma(opacity[n], d_opacity[n], sum);
    importance[visible[v]] += sum * sum;
    seen[visible[v]] = 1;
}

/* Adds to each of `total` elements the square of the derivative by it. */
__kernel void density_curvature(__global const float *derivative, const uint total,
                                __global float *curvature)
{
    const size_t vector = get_global_id(0);
    if (vector * VEC >= (size_t)total)
        return;
    const fv d = load_lanes(derivative, vector, total);
    store_lanes(fma(d, d, load_lanes(curvature, vector, total)), vector, curvature, total);
}
