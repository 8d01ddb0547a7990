/* Three-vectors in packed arrays: element i occupies floats 3 i to 3 i + 2. */
#ifndef CLGS_VECTOR3_H
#define CLGS_VECTOR3_H

#include "common/real.h"

inline float dot3(float3 p, float3 q)
{
    return fma(p.z, q.z, fma(p.y, q.y, p.x * q.x));
}

inline float3 load3(__global const float *values, size_t i)
{
    return (float3)(values[3 * i], values[3 * i + 1], values[3 * i + 2]);
}

inline void store3(float3 value, __global float *values, size_t i)
{
    values[3 * i] = value.x;
    values[3 * i + 1] = value.y;
    values[3 * i + 2] = value.z;
}

#endif
