/* Flat arrays by lane vectors, with their last, partial vector. */
#ifndef CLGS_LANES_H
#define CLGS_LANES_H

#include "include/real.h"

/* Vectors that hold an array of `total` floats. */
inline size_t vectors_in(size_t total)
{
    return (total + VEC - 1) / VEC;
}

/* Vector number `vector` of `values`; lanes at or past `total` are zero. */
inline fv load_lanes(__global const float *values, size_t vector, size_t total)
{
    if ((vector + 1) * VEC <= total)
        return LOAD_V(vector, values);
    float lanes[VEC];
    for (size_t lane = 0; lane < VEC; ++lane)
        lanes[lane] = vector * VEC + lane < total ? values[vector * VEC + lane] : 0.0f;
    return LOAD_V(0, lanes);
}

/* The mirror of load_lanes: lanes at or past `total` are not written. */
inline void store_lanes(fv value, size_t vector, __global float *values, size_t total)
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

/* Sum of the lanes, by halves. */
inline float lane_sum(fv value)
{
    float lanes[VEC];
    STORE_V(value, 0, lanes);
    for (int reach = VEC / 2; reach > 0; reach /= 2)
        for (int lane = 0; lane < reach; ++lane)
            lanes[lane] += lanes[lane + reach];
    return lanes[0];
}

/* Smallest lane that is not NaN, by halves. */
inline float lane_min(fv value)
{
    float lanes[VEC];
    STORE_V(value, 0, lanes);
    for (int reach = VEC / 2; reach > 0; reach /= 2)
        for (int lane = 0; lane < reach; ++lane)
            lanes[lane] = lanes[lane + reach] < lanes[lane] ? lanes[lane + reach] : lanes[lane];
    return lanes[0];
}

#endif
