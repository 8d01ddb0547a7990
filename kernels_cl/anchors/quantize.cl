/* Rounding to integers, half to even, and back.
 *
 * Work-item: a vector of VEC elements. Work-group: any; no local memory.
 * Launch: a work-item per vector, rounded up; in quantize_forward every array's begin with a
 * work-group.
 */
#include "common/lanes.h"
#include "common/parts.h"
#include "common/real.h"

#if VEC == 1
#define TO_IV_SAT convert_int_sat_rte
#else
#define TO_IV_SAT CLGS_CAT(CLGS_CAT(convert_int, VEC), _sat_rte)
#endif

/* n / q, correctly rounded even if a device's own division is not. */
static inline fv divided(const fv n, const fv q)
{
    const fv quotient = n / q;
    const fv rest = fma(-quotient, q, n);
    const fv corrected = fma(rest, (fv)(1.0f) / q, quotient);
    /* keeps -0, and an infinite n, whose rest is NaN */
    return fabs(rest) > (fv)(0.0f) ? corrected : quotient;
}

/* The work-groups after those of other arrays belong to array n, if it has elements. */
#define CHOOSE_ARRAY(n)                                                                            \
    if (get_group_id(0) >= first_group) {                                                          \
        array_group = first_group;                                                                 \
        x = x##n;                                                                                  \
        rounded = rounded##n;                                                                      \
        total = sizes.s##n;                                                                        \
        q = scales.s##n;                                                                           \
    }                                                                                              \
    first_group += groups_of(vectors_in(sizes.s##n));

/* rint(x q) / q of up to three arrays. */
PARTS_GROUP __kernel void quantize_forward(__global const float *x0, __global const float *x1,
                                           __global const float *x2, const uint4 sizes,
                                           const float4 scales, __global float *rounded0,
                                           __global float *rounded1, __global float *rounded2)
{
    uint first_group = 0, array_group = 0;
    __global const float *x = x0;
    __global float *rounded = rounded0;
    uint total = 0;
    float q = 1.0f;
    CHOOSE_ARRAY(0)
    CHOOSE_ARRAY(1)
    CHOOSE_ARRAY(2)
    const size_t vector = item_of_part(array_group);
    if (vector >= vectors_in(total))
        return;
    const fv n = rint(load_lanes(x, vector, total) * q);
    store_lanes(divided(n, (fv)(q)), vector, rounded, total);
}

/* rint(x q) / q with a q for each element, and 0 instead of -0: integers do not keep that sign. */
__kernel void quantize_elements(__global const float *x, __global const float *q, const uint total,
                                __global float *rounded)
{
    const size_t vector = get_global_id(0);
    if (vector >= vectors_in(total))
        return;
    const fv scale = load_lanes(q, vector, total);
    const fv n = rint(load_lanes(x, vector, total) * scale);
    const fv result = n == (fv)(0.0f) ? (fv)(0.0f) : divided(n, scale);
    store_lanes(result, vector, rounded, total);
}

/* rint(x q); values beyond int32 saturate, NaN gives 0. */
__kernel void quantize_integers(__global const float *x, const uint total, const float q,
                                __global int *integers)
{
    const size_t vector = get_global_id(0);
    if (vector >= vectors_in(total))
        return;
    const iv n = TO_IV_SAT(load_lanes(x, vector, total) * q);
    if ((vector + 1) * VEC <= total) {
        STORE_V(n, vector, integers);
        return;
    }
    int lanes[VEC];
    STORE_V(n, 0, lanes);
    for (size_t lane = 0; lane < VEC && vector * VEC + lane < total; ++lane)
        integers[vector * VEC + lane] = lanes[lane];
}
