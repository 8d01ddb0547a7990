/* Which pixels a record touches, and with which alpha: decided in one place for the forward and the
 * backward pass, by the formulas of common/ellipses.h. */
#ifndef CLGS_TOUCH_H
#define CLGS_TOUCH_H

#include "blend/record.h"
#include "common/ellipses.h"
#include "common/real.h"

#ifndef ALPHA_MAX
#define ALPHA_MAX 0.99f
#endif
#ifndef EXP2_DEGREE
#define EXP2_DEGREE 6
#endif

/* What a record does to VEC pixels; masks are non-zero (all bits set, in vectors) if true. */
typedef struct {
    fv y1, y2;
    fv alpha;     /* meaningless if not touched */
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

static inline fv hidden(float value, int zero)
{
    return (fv)(as_float(as_int(value) | zero));
}

/* `zero` is 0. A compiler that cannot know this keeps these vectors as operands in memory; else it
 * would build each of them from its scalar for every use, one instruction in ten. */
static inline TouchConstants touch_constants(int zero)
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
static inline fv exp2_in_range(fv x, const TouchConstants *c)
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

/* What record r does to pixels with centres (pixel_x, pixel_y). The exponent is log2 of alpha:
 * bias - y1^2 - y2^2. dx and dy, and so y1 and y2, have the other sign than in the op and the
 * reference; sums.cl takes care of it. */
static inline Touch touch(const Record *r, fv pixel_x, fv pixel_y, const TouchConstants *c)
{
    Touch t;
    const fv dx = r->x - pixel_x;
    const fv dy = r->y - pixel_y;
    t.y1 = dx * r->r1;
    t.y2 = fma((fv)(-r->l), dx, dy) * r->r2;
    const fv exponent = fma(-t.y2, t.y2, fma(-t.y1, t.y1, (fv)(r->bias)));
    t.touched = exponent >= c->cut;
    const fv alpha = exp2_in_range(exponent, c);
    t.alpha = alpha < c->alpha_max ? alpha : c->alpha_max;
    t.saturated = t.alpha >= c->alpha_max;
    return t;
}

#endif
