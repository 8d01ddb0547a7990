/* What a device can do at most: bytes copied and float32 operations per second; and how it rounds.
 *
 * limits_copy, limits_rounding: a work-item takes VEC numbers; launch size: at least total / VEC,
 * in work-groups of any size. limits_fma: a work-item computes on VEC lanes; launch size: any. No
 * local memory. */
#include "common/lanes.h"
#include "common/real.h"

/* target = source. */
__kernel void limits_copy(__global const float *source, const uint total, __global float *target)
{
    const size_t vector = get_global_id(0);
    if (vector < vectors_in(total))
        store_lanes(load_lanes(source, vector, total), vector, target, total);
}

/* Six independent chains x <- x factor + term, which begin at (1 .. 6) / 8, and their sum: enough
 * to hide the latency of an FMA, few enough to stay in registers. */
__kernel void limits_fma(const float factor, const float term, const int steps,
                         __global float *result)
{
    const fv f = (fv)(factor), t = (fv)(term);
    fv a = (fv)(0.125f), b = (fv)(0.25f), c = (fv)(0.375f);
    fv d = (fv)(0.5f), e = (fv)(0.625f), g = (fv)(0.75f);
    for (int step = 0; step < steps; ++step) {
        a = fma(a, f, t);
        b = fma(b, f, t);
        c = fma(c, f, t);
        d = fma(d, f, t);
        e = fma(e, f, t);
        g = fma(g, f, t);
    }
    STORE_V(((a + b) + (c + d)) + (e + g), get_global_id(0), result);
}

/* rounded (4, total): x / y, sqrt(y), x y + z in two roundings, and in one. */
__kernel void limits_rounding(__global const float *x, __global const float *y,
                              __global const float *z, const uint total, __global float *rounded)
{
    const size_t vector = get_global_id(0);
    if (vector >= vectors_in(total))
        return;
    const fv a = load_lanes(x, vector, total), b = load_lanes(y, vector, total);
    const fv c = load_lanes(z, vector, total);
    store_lanes(a / b, vector, rounded, total);
    store_lanes(sqrt(b), vector, rounded + (size_t)total, total);
    store_lanes(a * b + c, vector, rounded + 2 * (size_t)total, total);
    store_lanes(fma(a, b, c), vector, rounded + 3 * (size_t)total, total);
}
