/* Adam on parameters that live on the device. No fma and no reordering: NumPy in float32 gives the
 * same bits where division and square root are correctly rounded. */
#include "include/lanes.h"
#include "include/real.h"

/* Smaller moments are zero: they would decay into subnormals, which cost ten times the time.
 * m below this moves a parameter by less than a part in 1e15 of the step; v, whose root meets an
 * epsilon of 1e-15, must reach lower. */
#ifndef MIN_FIRST_MOMENT
#define MIN_FIRST_MOMENT 1e-30f
#define MIN_SECOND_MOMENT 1e-36f
#endif

/* One work-item a vector of the `total` elements from `start` on; nothing happens where *finite is
 * 0. correction = 1/sqrt(1 - beta2^t). */
__kernel void adam_step(__global float *parameter, __global const float *gradient,
                        __global float *first, __global float *second, const uint start,
                        const uint total, const float4 betas, const float correction,
                        const float epsilon, const float step, __global const int *finite)
{
    const size_t vector = get_global_id(0);
    if (vector >= vectors_in(total) || *finite == 0)
        return;
    parameter += start;
    gradient += start;
    first += start;
    second += start;
    const fv g = load_lanes(gradient, vector, total);
    fv m = load_lanes(first, vector, total) * betas.x + g * betas.y;
    fv v = load_lanes(second, vector, total) * betas.z + g * g * betas.w;
    m = fabs(m) < (fv)(MIN_FIRST_MOMENT) ? (fv)(0.0f) : m;
    v = v < (fv)(MIN_SECOND_MOMENT) ? (fv)(0.0f) : v;
    const fv root = sqrt(v) * correction + epsilon;
    const fv p = load_lanes(parameter, vector, total) - m / root * step;
    store_lanes(m, vector, first, total);
    store_lanes(v, vector, second, total);
    store_lanes(p, vector, parameter, total);
}

#define ELEMENTS_PER_ITEM 256

/* Clears *finite where an element of `values` is infinite or NaN. */
__kernel void adam_check(__global const float *values, const uint total, __global int *finite)
{
    const size_t first = get_global_id(0) * ELEMENTS_PER_ITEM;
    int largest = 0;
    for (size_t i = first; i < first + ELEMENTS_PER_ITEM && i < total; ++i) {
        const int exponent = as_int(values[i]) & 0x7f800000;
        largest = exponent > largest ? exponent : largest;
    }
    if (largest == 0x7f800000)
        atomic_and(finite, 0);
}
