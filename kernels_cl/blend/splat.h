/* A Gaussian on the screen: the decision which pixels it touches, made in one
 * place for forward, backward and tile lists.
 *
 * Whitened offsets are scaled by sqrt(log2(e) / 2), and the opacity joins the
 * exponent: y1 = dx * r1,  y2 = (dy - l * dx) * r2,  exponent = log2(opacity) -
 * y1^2 - y2^2, alpha = min(ALPHA_MAX, 2^exponent);  a pixel is touched where
 * exponent >= LOG2_ALPHA_CUT.
 */
#ifndef CLGS_SPLAT_H
#define CLGS_SPLAT_H

#include "common/rows.h"

#ifndef TILE_SIZE
#define TILE_SIZE 16
#endif
#ifndef ALPHA_MAX
#define ALPHA_MAX 0.99f
#endif
#ifndef LOG2_ALPHA_CUT
#define LOG2_ALPHA_CUT -7.99435344f
#endif
#ifndef EXP2_DEGREE
#define EXP2_DEGREE 6
#endif
#define BIAS_MAX 64.0f /* keeps 2^bias finite whatever the opacity */

#define WHITENING_UNIT 0.849321800f /* sqrt(log2(e) / 2) */

typedef struct {
    float x, y;      /* centre, pixels */
    float r1, l, r2; /* whitening factor, r1 and r2 times WHITENING_UNIT */
    float bias;      /* log2(opacity) */
} Splat;

/* What a splat does to VEC pixels; masks are non-zero (all bits set, in
 * vectors) where true. */
typedef struct {
    fv y1, y2;
    fv alpha;     /* meaningless where not touched */
    iv touched;   /* NaN anywhere: not touched */
    iv saturated; /* alpha was clamped to ALPHA_MAX */
} Touch;

/* 2^f for |f| <= 1/2, highest power first; relative errors of degree 6 to 3: 8e-8, 2e-7, 3e-6,
 * 8e-5. */
#if EXP2_DEGREE == 6
#define EXP2_TERMS                                                                                 \
    1.53458118e-04f, 1.33999309e-03f, 9.61848907e-03f, 5.55032864e-02f, 2.40226462e-01f,           \
        6.93147182e-01f, 1.0f
#elif EXP2_DEGREE == 5
#define EXP2_TERMS                                                                                 \
    1.32764725e-03f, 9.67554189e-03f, 5.55071309e-02f, 2.40221202e-01f, 6.93146944e-01f, 1.00000012f
#elif EXP2_DEGREE == 4
#define EXP2_TERMS                                                                                 \
    9.57010221e-03f, 5.59178628e-02f, 2.40247443e-01f, 6.93121791e-01f, 9.99999285e-01f
#elif EXP2_DEGREE == 3
#define EXP2_TERMS 5.51716723e-02f, 2.42611125e-01f, 6.93260968e-01f, 9.99928057e-01f
#else
#error EXP2_DEGREE must be 3 to 6
#endif

/* The constants of touch as vectors. */
typedef struct {
    fv exp2_terms[EXP2_DEGREE + 1];
    fv round, alpha_max, cut;
} TouchConstants;

inline fv hidden(float value, int zero)
{
    return (fv)(as_float(as_int(value) | zero));
}

/* zero is 0. Where the compiler cannot know that, it keeps these vectors as operands in memory
 * instead of building each anew from its scalar for every use, one instruction in ten. */
inline TouchConstants touch_constants(int zero)
{
    const float terms[EXP2_DEGREE + 1] = {EXP2_TERMS};
    TouchConstants c;
    for (int i = 0; i <= EXP2_DEGREE; ++i)
        c.exp2_terms[i] = hidden(terms[i], zero);
    c.round = hidden(ROUND_MAGIC, zero);
    c.alpha_max = hidden(ALPHA_MAX, zero);
    c.cut = hidden(LOG2_ALPHA_CUT, zero);
    return c;
}

/* 2^x for x in [-100, 100]; garbage elsewhere, which callers mask. */
inline fv exp2_in_range(fv x, const TouchConstants *c)
{
    const fv shifted = x + c->round;
    const fv f = x - (shifted - c->round);
    /* written out, as not every compiler would */
    fv p = fma(fma(c->exp2_terms[0], f, c->exp2_terms[1]), f, c->exp2_terms[2]);
    p = fma(p, f, c->exp2_terms[3]);
#if EXP2_DEGREE > 3
    p = fma(p, f, c->exp2_terms[4]);
#endif
#if EXP2_DEGREE > 4
    p = fma(p, f, c->exp2_terms[5]);
#endif
#if EXP2_DEGREE > 5
    p = fma(p, f, c->exp2_terms[6]);
#endif
    return AS_FV(AS_IV(p) + (AS_IV(shifted) << 23));
}

inline Touch touch(const Splat *s, fv pixel_x, fv pixel_y, const TouchConstants *c)
{
    Touch t;
    const fv dx = s->x - pixel_x;
    const fv dy = s->y - pixel_y;
    t.y1 = dx * s->r1;
    t.y2 = fma((fv)(-s->l), dx, dy) * s->r2;
    const fv exponent = fma(-t.y2, t.y2, fma(-t.y1, t.y1, (fv)(s->bias)));
    t.touched = exponent >= c->cut;
    const fv alpha = exp2_in_range(exponent, c);
    t.alpha = alpha < c->alpha_max ? alpha : c->alpha_max;
    t.saturated = t.alpha >= c->alpha_max;
    return t;
}

/* VEC splats, and the ellipses outside of which they touch no pixel, a little too large so that
 * rounding never loses one. On a row of pixels dy below its centre an ellipse lies around slope dy,
 * half as wide as sqrt(squared - shrink dy^2). */
typedef struct {
    fv x, y, r1, l, r2, bias; /* as of a Splat */
    fv reach;                 /* largest sqrt(y1^2 + y2^2); below zero or NaN: no ellipse */
    fv sigma_x, sigma_y;      /* half as wide and as high as one of reach 1 */
    fv lean;                  /* row of the last column, at reach 1 */
    fv slope, squared, shrink;
} Ellipses;

/* Splats first to first + used - 1, at most VEC. */
inline Ellipses load_ellipses(__global const float *mean2d, __global const float *whitening,
                              __global const float *opacity, const size_t first, const size_t used)
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
    /* The rounding error of y2 is that of dy - l * dx, a difference of terms as large as the box.
     */
    const fv error = 1e-6f * e.r2 * (fabs(e.lean) + e.sigma_y) * sqrt(limit + 1e-4f);
    e.reach = sqrt(fma(limit, (fv)(1.00001f), (fv)(1e-5f))) + error;
    const fv inverse = 1.0f / fma(e.r1, e.r1, lr2 * lr2);
    e.slope = lr2 * e.r2 * inverse;
    e.squared = e.reach * e.reach * 1.00001f * inverse;
    e.shrink = (e.r1 * e.r2 * inverse) * (e.r1 * e.r2 * inverse);
    return e;
}

#endif
