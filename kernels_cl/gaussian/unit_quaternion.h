/* Quaternions of length 1. */
#ifndef CLGS_UNIT_QUATERNION_H
#define CLGS_UNIT_QUATERNION_H

#include "common/real.h"

/* A quaternion whose largest component is not between these has no direction. */
#define QUATERNION_MIN 1e-35f
#define QUATERNION_MAX 1e37f

static inline fv larger(const fv a, const fv b)
{
    return a > b ? a : b;
}

/* Makes unit quaternions, zero if there is no direction, and returns the reciprocals of their
 * lengths. Division by the largest component keeps squares from overflow and underflow. */
static inline fv make_unit(fv unit[4])
{
    const fv largest =
        larger(larger(fabs(unit[0]), fabs(unit[1])), larger(fabs(unit[2]), fabs(unit[3])));
    const fv shrink = 1.0f / largest;
    fv square = (fv)(0.0f);
    for (int i = 0; i < 4; ++i) {
        unit[i] *= shrink;
        square = fma(unit[i], unit[i], square);
    }
    /* written so that a NaN in any component fails */
    const iv valid = (largest > (fv)(QUATERNION_MIN)) & (largest < (fv)(QUATERNION_MAX)) &
                     (square >= (fv)(0.99f));
    const fv on_length = 1.0f / sqrt(square);
    for (int i = 0; i < 4; ++i)
        unit[i] = valid ? unit[i] * on_length : (fv)(0.0f);
    return valid ? on_length * shrink : (fv)(0.0f);
}

/* dL/d(quaternion) from dL/d(unit quaternion): the part across it, by the length. */
static inline void unit_gradient(fv quaternion[4], fv d[4])
{
    const fv on_length = make_unit(quaternion);
    fv along = (fv)(0.0f);
    for (int i = 0; i < 4; ++i)
        along = fma(d[i], quaternion[i], along);
    for (int i = 0; i < 4; ++i)
        d[i] = (d[i] - along * quaternion[i]) * on_length;
}

#endif
