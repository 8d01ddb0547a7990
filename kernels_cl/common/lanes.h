/* Flat arrays by lane vectors, with their last, partial vector. */
#ifndef CLGS_LANES_H
#define CLGS_LANES_H

#include "common/real.h"

/* Vector number `vector` of an array whose address is a multiple of a vector's size: compilers for
 * CPUs that do not know this load two halves. */
#define LOAD_ALIGNED(vector, pointer) (((__global const fv *)(pointer))[vector])
#define STORE_ALIGNED(value, vector, pointer) (((__global fv *)(pointer))[vector] = (value))

/* Number k of each of VEC rows, one row per lane. */
#if VEC == 1
#define GATHER_V(rows, k) ((rows)[0][k])
#elif VEC == 16
#define GATHER_V(rows, k) ((fv)(GATHER_8(rows, k), GATHER_8((rows) + 8, k)))
#elif VEC == 8
#define GATHER_V(rows, k) GATHER_8(rows, k)
#else
#define GATHER_V(rows, k) GATHER_4(rows, k)
#endif
#define GATHER_8(rows, k) ((float8)(GATHER_4(rows, k), GATHER_4((rows) + 4, k)))
#define GATHER_4(rows, k) ((float4)((rows)[0][k], (rows)[1][k], (rows)[2][k], (rows)[3][k]))

/* Vectors that hold an array of `total` floats. */
static inline size_t vectors_in(size_t total)
{
    return (total + VEC - 1) / VEC;
}

/* Vector number `vector` of `values`; lanes at or past `total` are zero. */
static inline fv load_lanes(__global const float *values, size_t vector, size_t total)
{
    if ((vector + 1) * VEC <= total)
        return LOAD_V(vector, values);
    float lanes[VEC];
    for (size_t lane = 0; lane < VEC; ++lane)
        lanes[lane] = vector * VEC + lane < total ? values[vector * VEC + lane] : 0.0f;
    return LOAD_V(0, lanes);
}

/* The mirror of load_lanes; lanes at or past `total` are not written. */
static inline void store_lanes(fv value, size_t vector, __global float *values, size_t total)
{
    if ((vector + 1) * VEC <= total) {
        STORE_V(value, vector, values);
        return;
    }
    float lanes[VEC];
    STORE_V(value, 0, lanes);
    for (size_t lane = 0; lane < VEC && vector * VEC + lane < total; ++lane)
        values[vector * VEC + lane] = lanes[lane];
}

/* Sums over lanes go by a tree of 16 of them, so that gradients have the same bits for every
 * width of vectors: narrower ones sum each SUM_PARTS-th vector apart, and then the first half of
 * the parts to the second until one is left. In the GPU form work-items are the lanes. */
#define SUM_LANES 16
#define LANES_PITCH                                                                                \
    (SUM_LANES + 1) /* in local memory, so that each list starts in another bank                   \
                     */
#if VEC == 1
#define SUM_PARTS 1
#else
#define SUM_PARTS (SUM_LANES / VEC)
#endif

#if VEC == 1
static inline float lane_sum(fv value)
{
    return value;
}

static inline float4 lane_sums(fv a, fv b, fv c, fv d)
{
    return (float4)(a, b, c, d);
}
#else
/* The first steps of the sums of the lanes of a and of b: four numbers each. */
static inline float8 halves(const fv a, const fv b)
{
#if VEC == 16
    const float8 c = a.lo + a.hi, d = b.lo + b.hi;
    return (float8)(c.lo, d.lo) + (float8)(c.hi, d.hi);
#elif VEC == 8
    return (float8)(a.lo, b.lo) + (float8)(a.hi, b.hi);
#else
    return (float8)(a, b);
#endif
}

/* Sum of the lanes, by halves. */
static inline float lane_sum(fv value)
{
#if VEC == 16
    const float8 eight = value.lo + value.hi;
    const float4 four = eight.lo + eight.hi;
#elif VEC == 8
    const float4 four = value.lo + value.hi;
#else
    const float4 four = value;
#endif
    const float2 two = four.lo + four.hi;
    return two.x + two.y;
}

/* Sums of the lanes of four vectors. */
static inline float4 lane_sums(fv a, fv b, fv c, fv d)
{
    const float8 ac = halves(a, c), bd = halves(b, d);
    const float8 two =
        (float8)(ac.s01, bd.s01, ac.s45, bd.s45) + (float8)(ac.s23, bd.s23, ac.s67, bd.s67);
    return two.even + two.odd;
}
#endif

/* Smallest lane that is not NaN, by halves. */
static inline float lane_min(fv value)
{
    float lanes[VEC];
    STORE_V(value, 0, lanes);
    for (int reach = VEC / 2; reach > 0; reach /= 2)
        for (int lane = 0; lane < reach; ++lane)
            lanes[lane] = lanes[lane + reach] < lanes[lane] ? lanes[lane + reach] : lanes[lane];
    return lanes[0];
}

#if VEC > 1
/* Sum of all lanes of all parts, which it changes. */
static inline float parts_sum(fv part[SUM_PARTS])
{
    for (int reach = SUM_PARTS / 2; reach > 0; reach /= 2)
        for (int i = 0; i < reach; ++i)
            part[i] += part[i + reach];
    return lane_sum(part[0]);
}
#else
/* sum[i] += sum[i + reach], for a constant reach: else the sums would not stay in registers. */
#define ADD_HALVES(sum, reach)                                                                     \
    for (int i = 0; i < (reach); ++i)                                                              \
    (sum)[i] += (sum)[i + (reach)]

/* Sum of SUM_LANES numbers, by halves. */
static inline float lane_tree(__local const float *lanes)
{
    float sum[SUM_LANES / 2];
#pragma unroll
    for (int i = 0; i < SUM_LANES / 2; ++i)
        sum[i] = lanes[i] + lanes[i + SUM_LANES / 2];
#pragma unroll
    ADD_HALVES(sum, SUM_LANES / 4);
#pragma unroll
    ADD_HALVES(sum, SUM_LANES / 8);
#pragma unroll
    ADD_HALVES(sum, SUM_LANES / 16);
    return sum[0];
}

/* The same of four vectors, the lanes in their order. */
static inline float quads_tree(float4 a, float4 b, float4 c, float4 d)
{
    const float4 four = (a + c) + (b + d);
    const float2 two = four.lo + four.hi;
    return two.x + two.y;
}
#endif

#endif
