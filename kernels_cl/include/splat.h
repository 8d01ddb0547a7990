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

#include "include/real.h"

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

inline Splat make_splat2d(__global const float *mean2d, __global const float *whitening,
                          __global const float *opacity, int i)
{
    Splat s;
    s.x = mean2d[2 * i];
    s.y = mean2d[2 * i + 1];
    s.r1 = whitening[3 * i] * WHITENING_UNIT;
    s.l = whitening[3 * i + 1];
    s.r2 = whitening[3 * i + 2] * WHITENING_UNIT;
    const float bias = opacity[i] > 0.0f ? log_s(opacity[i]) * LOG2_E : -INFINITY; /* NaN, too */
    s.bias = bias < BIAS_MAX ? bias : BIAS_MAX;
    return s;
}

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

/* Where a splat can touch pixels at all, a little too large so that rounding
 * never loses one. */
typedef struct {
    float squared;        /* largest y1^2 + y2^2 */
    float half_x, half_y; /* of the bounding box, pixels */
} Reach;

inline Reach reach_of(const Splat *s)
{
    Reach r;
    /* The rounding error of y2 is that of dy - l * dx, a difference of terms as
     * large as the box.
     */
    const float limit = s->bias - LOG2_ALPHA_CUT;
    const float sigma_x = 1.0f / s->r1, minor = 1.0f / s->r2;
    const float lean = s->l * sigma_x;
    const float sigma_y = sqrt(fma(lean, lean, minor * minor));
    const float error = 1e-6f * s->r2 * (fabs(lean) + sigma_y) * sqrt(limit + 1e-4f);
    const float reach = sqrt(fma(limit, 1.00001f, 1e-5f)) + error;
    r.squared = reach * reach;
    r.half_x = fma(reach, sigma_x, 1e-3f);
    r.half_y = fma(reach, sigma_y, 1e-3f);
    return r;
}

/* How wide the touched ellipse is in a row of pixels dy below the centre: it
 * lies around slope dy, half as wide as sqrt(squared - shrink dy^2). */
typedef struct {
    float slope, squared, shrink;
} Span;

inline Span span_of(const Splat *s, const Reach *r)
{
    const float lr2 = s->l * s->r2;
    const float inverse = 1.0f / fma(s->r1, s->r1, lr2 * lr2);
    Span span;
    span.slope = lr2 * s->r2 * inverse;
    span.squared = r->squared * 1.00001f * inverse;
    span.shrink = (s->r1 * s->r2 * inverse) * (s->r1 * s->r2 * inverse);
    return span;
}

/* First (.xy) and last (.zw) column and row of the pixels whose centres lie in
 * centre +- half, within an image of the given size; none where first > last,
 * all where half is not finite. All four at once and without branches, which
 * would be hard to predict. */
inline int4 pixel_box(float2 centre, float2 half_size, float2 size)
{
    const float4 low = (float4)(0.0f, 0.0f, 1.0f - size.x, 1.0f - size.y);
    const float4 high = (float4)(size.x, size.y, 1.0f, 1.0f);
    float4 edge = ceil((float4)(centre - half_size - 0.5f, 0.5f - centre - half_size));
    edge = edge > low ? edge : low;
    edge = edge < high ? edge : high;
    return convert_int4(edge) * (int4)(1, 1, -1, -1);
}

inline float squared_whitened(const Splat *s, float dx, float dy)
{
    const float y1 = dx * s->r1;
    const float y2 = fma(-s->l, dx, dy) * s->r2;
    return fma(y1, y1, y2 * y2);
}

inline float clamp_between(float x, float low, float high)
{
    return x < low ? low : (x > high ? high : x);
}

/* Whether the splat may touch a pixel from first to last (column, row): the
 * smallest y1^2 + y2^2 over the rectangle of pixel centres lies at its centre
 * or on an edge facing it. */
inline bool reaches_pixels(const Splat *s, float squared, int2 first, int2 last)
{
    const float left = (float)first.x + 0.5f - s->x, right = (float)last.x + 0.5f - s->x;
    const float top = (float)first.y + 0.5f - s->y, bottom = (float)last.y + 0.5f - s->y;
    const float near_x = clamp_between(0.0f, left, right);
    const float near_y = clamp_between(0.0f, top, bottom);
    const float on_column = squared_whitened(s, near_x, clamp_between(s->l * near_x, top, bottom));
    const float slope = s->l * s->r2 * s->r2 / fma(s->r1, s->r1, s->l * s->r2 * s->l * s->r2);
    const float on_row = squared_whitened(s, clamp_between(slope * near_y, left, right), near_y);
    return (on_column <= squared) | (on_row <= squared);
}

#endif
