/* The way back from the whitening factor and the kept share to the 2x3 factor J W R S, and from a
 * rotation matrix to its quaternion. */
#ifndef CLGS_FACTOR_GRADIENT_H
#define CLGS_FACTOR_GRADIENT_H

#include "common/lane_math.h"
#include "common/real.h"
#include "gaussian/projection.h"

/* Columns of the whitened factor: (r1 a_k, r2 (b_k - l a_k)). The difference is a sum of minors,
 * which keeps its digits if the two terms almost cancel. */
static inline void whitened_columns(const Projection *p, const fv factor[3], fv first[3],
                                    fv second[3])
{
    const fv r1 = factor[0] * p->unit, r2 = factor[2] * p->unit / p->cov_xx;
    for (int k = 0; k < 3; ++k) {
        const int next = (k + 1) % 3, last = (k + 2) % 3;
        const fv sum = fma(p->a[last], p->minor[next], -p->a[next] * p->minor[last]);
        first[k] = r1 * p->a[k];
        second[k] = r2 * (sum + p->blur * p->b[k]);
    }
}

/* dL/dq for q = (w, x, y, z), from dL/dR given by rows. */
static inline void quaternion_gradient(const fv q[4], const fv d[3][3], fv d_q[4])
{
    const fv turn_x = d[2][1] - d[1][2], turn_y = d[0][2] - d[2][0], turn_z = d[1][0] - d[0][1];
    const fv xy = d[0][1] + d[1][0], xz = d[0][2] + d[2][0], yz = d[1][2] + d[2][1];
    d_q[0] = 2.0f * (q[1] * turn_x + q[2] * turn_y + q[3] * turn_z);
    d_q[1] = 2.0f * (q[2] * xy + q[3] * xz + q[0] * turn_x - 2.0f * q[1] * (d[1][1] + d[2][2]));
    d_q[2] = 2.0f * (q[1] * xy + q[3] * yz + q[0] * turn_y - 2.0f * q[2] * (d[0][0] + d[2][2]));
    d_q[3] = 2.0f * (q[1] * xz + q[2] * yz + q[0] * turn_z - 2.0f * q[3] * (d[0][0] + d[1][1]));
}

/* dL/d(factor) by rows, and dL/d(log scale). */
static inline void factor_gradient(const Projection *p, const fv factor[3], const fv d_factor[3],
                                   fv d_a[3], fv d_b[3], fv d_log_scale[3])
{
    /* sums of alpha dL/d(alpha) y y^T over the pixels */
    const fv m11 = -d_factor[0] * factor[0];
    const fv m12 = d_factor[1] * factor[0] / factor[2];
    const fv m22 = -d_factor[2] * factor[2];
    const fv back = factor[1] * factor[2];
    fv first[3], second[3];
    whitened_columns(p, factor, first, second);
    for (int k = 0; k < 3; ++k) {
        const fv d_first = m11 * first[k] + m12 * second[k];
        const fv d_second = m12 * first[k] + m22 * second[k];
        d_a[k] = factor[0] * d_first - back * d_second;
        d_b[k] = factor[2] * d_second;
        d_log_scale[k] = first[k] * d_first + second[k] * d_second;
    }
}

/* Adds the gradient of the share that antialiased Gaussians keep to those of the factor's rows, and
 * to `along` the part along each column; d_share: by the share's logarithm. */
static inline void share_gradient(const Projection *p, const fv d_share, fv d_a[3], fv d_b[3],
                                  fv along[3])
{
    const fv sharp = dot3(p->minor, p->minor);
    const fv weight = sharp > (fv)(0.0f) ? 1.0f / sharp - 1.0f / p->det : (fv)(0.0f);
    fv by_a[3], by_b[3];
    cross3(p->b, p->minor, by_a);
    cross3(p->minor, p->a, by_b);
    for (int k = 0; k < 3; ++k) {
        const fv more_a = d_share * (weight * by_a[k] - p->blur * p->a[k] / p->det);
        const fv more_b = d_share * (weight * by_b[k] - p->blur * p->b[k] / p->det);
        d_a[k] += more_a * p->on_unit;
        d_b[k] += more_b * p->on_unit;
        along[k] += p->a[k] * more_a + p->b[k] * more_b;
    }
}

#endif
