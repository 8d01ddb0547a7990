/* Scales from their logarithms. */
#ifndef CLGS_LOG_SCALE_H
#define CLGS_LOG_SCALE_H

#include "common/lane_math.h"
#include "common/method.h"
#include "common/real.h"

/* e^x of VEC log scales, clamped; NaN stays NaN. */
static inline fv exp_log_scale(const fv log_scale)
{
    return exp_v(clamp_lanes(log_scale, (fv)(-LOG_SCALE_LIMIT), (fv)(LOG_SCALE_LIMIT)));
}

#endif
