/* Small functions of lane vectors. */
#ifndef CLGS_LANE_MATH_H
#define CLGS_LANE_MATH_H

#include "common/real.h"

static inline fv dot3(const fv p[3], const fv q[3])
{
    return fma(p[2], q[2], fma(p[1], q[1], p[0] * q[0]));
}

/* x between low and high; NaN stays NaN. */
static inline fv clamp_lanes(const fv x, const fv low, const fv high)
{
    const fv raised = x < low ? low : x;
    return raised > high ? high : raised;
}

#endif
