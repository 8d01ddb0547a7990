/* The ellipses outside of which projected Gaussians touch no pixel, made in one place for the
 * blending and for the tile lists.
 *
 * Whitened offsets are scaled by sqrt(log2(e) / 2), and the opacity joins the exponent:
 *     y1 = dx * r1,  y2 = (dy - l * dx) * r2,  exponent = log2(opacity) - y1^2 - y2^2,
 *     alpha = min(ALPHA_MAX, 2^exponent);
 * a pixel is touched if exponent >= LOG2_ALPHA_CUT. */
#ifndef CLGS_ELLIPSES_H
#define CLGS_ELLIPSES_H

#include "common/real.h"
#include "common/rows.h"

#ifndef LOG2_ALPHA_CUT
#define LOG2_ALPHA_CUT -7.99435344f
#endif

#define WHITENING_UNIT 0.849321800f /* sqrt(log2(e) / 2) */
#define BIAS_MAX 64.0f              /* keeps 2^bias finite for any opacity */

/* VEC projected Gaussians and their ellipses, a little too large so that rounding never loses a
 * pixel. On a row of pixels dy below its centre an ellipse lies around slope dy, and half its width
 * there is sqrt(squared - shrink dy^2). */
typedef struct {
    fv x, y;             /* centre, pixels */
    fv r1, l, r2;        /* whitening factor, r1 and r2 times WHITENING_UNIT */
    fv bias;             /* log2(opacity) */
    fv reach;            /* largest sqrt(y1^2 + y2^2); below zero or NaN: no ellipse */
    fv sigma_x, sigma_y; /* half the width and half the height of the ellipse of reach 1 */
    fv lean;             /* row of its last column, at reach 1 */
    fv slope, squared, shrink;
} Ellipses;

/* Ellipses of Gaussians first to first + used - 1, at most VEC. */
static inline Ellipses load_ellipses(__global const float *mean2d, __global const float *whitening,
                                     __global const float *opacity, const size_t first,
                                     const size_t used)
{
    fv centre[2], factor[3], alpha[1];
    load_rows2(mean2d, first, used, centre);
    load_rows3(whitening, first, used, factor);
    load_rows1(opacity, first, used, alpha);
    const fv bias = alpha[0] > (fv)(0.0f) ? log_v(alpha[0]) * LOG2_E : (fv)(-INFINITY); /* NaN */
    Ellipses e;
    e.x = centre[0];
    e.y = centre[1];
    e.r1 = factor[0] * WHITENING_UNIT;
    e.l = factor[1];
    e.r2 = factor[2] * WHITENING_UNIT;
    e.bias = bias < (fv)(BIAS_MAX) ? bias : (fv)(BIAS_MAX);
    const fv limit = e.bias - LOG2_ALPHA_CUT;
    const fv minor = 1.0f / e.r2, lr2 = e.l * e.r2;
    e.sigma_x = 1.0f / e.r1;
    e.lean = e.l * e.sigma_x;
    e.sigma_y = sqrt(fma(e.lean, e.lean, minor * minor));
    /* y2 has the rounding error of dy - l * dx, a difference of terms as large as the box */
    const fv error = 1e-6f * e.r2 * (fabs(e.lean) + e.sigma_y) * sqrt(limit + 1e-4f);
    e.reach = sqrt(fma(limit, (fv)(1.00001f), (fv)(1e-5f))) + error;
    const fv inverse = 1.0f / fma(e.r1, e.r1, lr2 * lr2);
    e.slope = lr2 * e.r2 * inverse;
    e.squared = e.reach * e.reach * 1.00001f * inverse;
    e.shrink = (e.r1 * e.r2 * inverse) * (e.r1 * e.r2 * inverse);
    return e;
}

#endif
