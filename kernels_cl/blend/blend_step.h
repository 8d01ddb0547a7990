/* One splat over VEC pixels, front to back and back to front; and the records
 * it is read from. */
#ifndef CLGS_BLEND_STEP_H
#define CLGS_BLEND_STEP_H

#include "blend/splat.h"

#ifndef TRANSMITTANCE_STOP
#define TRANSMITTANCE_STOP 1e-4f
#endif
#ifndef STOP_INCLUSIVE
#define STOP_INCLUSIVE 0 /* whether the splat that crosses TRANSMITTANCE_STOP is blended */
#endif
/* Which work is left out that changes nothing; see Skips in clgs/options.py. */
#ifndef SKIP_UNITS
#define SKIP_UNITS 1
#endif
#ifndef SKIP_FINISHED
#define SKIP_FINISHED 1
#endif
#ifndef SKIP_CONTRIBUTORS
#define SKIP_CONTRIBUTORS 1
#endif
#ifndef SKIP_EMPTY_TILES
#define SKIP_EMPTY_TILES 1
#endif
#ifndef COLOR_LIMIT
#define COLOR_LIMIT 1e3f
#endif

/* A record holds a splat ready to blend, 16 floats: one for each Gaussian
 * first, then one for each entry in list order, so that the blend reads them as
 * a stream. */
#define RECORD_SIZE 16
#define RECORD_SPLAT 0 /* x, y, r1, l, r2, bias */
#define RECORD_COLOR 6 /* red, green, blue */
#define RECORD_SPAN 9  /* of a Gaussian: how wide it is in a row of pixels, see splat.h */
#define RECORD_UNITS 9 /* of an entry, uint: units of the tile that it may touch (CPU form) */
#define RECORD_ROW 11  /* of an entry, int: where its gradients go */
#define RECORD_USED 12

/* Gradient rows: the sums over the pixels of a tile of
 * v y1, v y2, v y1^2, v y1 y2, v y2^2, w red, w green, w blue, v
 * with v = alpha dL/d(alpha) and w red = weight dL/d(red of the image). */
#define ROW_SIZE 16
#define ROW_USED 9

/* Whether a mask has a lane; compilers make one test of it, unlike of any(). */
inline bool any_lane(iv mask)
{
#if VEC == 1
    return mask != 0;
#else
#if VEC == 16
    const int8 eight = mask.lo | mask.hi;
#else
    const int8 eight = mask;
#endif
    const long2 words = as_long2(eight.lo | eight.hi);
    return (words.x | words.y) != 0;
#endif
}

typedef struct {
    Splat splat;
    float red, green, blue;
} Paint;

/* VEC pixels on the way front to back: what every splat changes. A finished
 * pixel has a transmittance of zero, so that nothing changes it any more. */
typedef struct {
    fv transmittance, red, green, blue;
    fv stop; /* finished below this transmittance; 0 where finished already */
} Pixels;

/* What is kept of pixels that are finished. */
typedef struct {
    fv transmittance; /* negative where not finished */
    iv last;          /* entries up to the end of the pixel */
} Ends;

/* VEC pixels on the way back to front. */
typedef struct {
    fv transmittance; /* behind the splats that are still to come */
    fv behind;        /* colour behind them per transmittance, dotted with d_image */
    fv d_red, d_green, d_blue;
    iv last;
} Rays;

typedef struct {
    fv y1, y2, y11, y12, y22, red, green, blue, alpha;
} Moments;

#define READ_PAINT(paint, record)                                                                  \
    do {                                                                                           \
        (paint).splat.x = (record)[0];                                                             \
        (paint).splat.y = (record)[1];                                                             \
        (paint).splat.r1 = (record)[2];                                                            \
        (paint).splat.l = (record)[3];                                                             \
        (paint).splat.r2 = (record)[4];                                                            \
        (paint).splat.bias = (record)[5];                                                          \
        (paint).red = (record)[RECORD_COLOR];                                                      \
        (paint).green = (record)[RECORD_COLOR + 1];                                                \
        (paint).blue = (record)[RECORD_COLOR + 2];                                                 \
    } while (0)

/* Pixels of the image start with nothing in front of them; those outside of it
 * are finished. */
inline void start_pixels(Pixels *p, Ends *e, iv inside)
{
    p->transmittance = inside ? (fv)(1.0f) : (fv)(0.0f);
    p->red = p->green = p->blue = (fv)(0.0f);
    p->stop = inside ? (fv)(TRANSMITTANCE_STOP) : (fv)(0.0f);
    e->transmittance = inside ? (fv)(-1.0f) : (fv)(0.0f);
    e->last = (iv)(0);
}

/* Blends a splat into pixels; number counts list entries from 1. Returns which
 * pixels stop here. */
inline iv blend_over(Pixels *p, Ends *e, const Paint *paint, const Touch *t, int number)
{
    const fv alpha = t->touched ? t->alpha : (fv)(0.0f);
    fv weight = alpha * p->transmittance;
    fv after = fma(-alpha, p->transmittance, p->transmittance);
    const iv stops = after < p->stop;
    if (any_lane(stops)) { /* seldom: once a pixel at most */
#if STOP_INCLUSIVE
        e->transmittance = stops ? after : e->transmittance;
        e->last = stops ? (iv)(number) : e->last;
#else
        e->transmittance = stops ? p->transmittance : e->transmittance;
        e->last = stops ? (iv)(number - 1) : e->last;
        weight = stops ? (fv)(0.0f) : weight;
#endif
        after = stops ? (fv)(0.0f) : after;
        p->stop = stops ? (fv)(0.0f) : p->stop;
    }
    p->red = fma(weight, (fv)(paint->red), p->red);
    p->green = fma(weight, (fv)(paint->green), p->green);
    p->blue = fma(weight, (fv)(paint->blue), p->blue);
    p->transmittance = after;
    return stops;
}

/* Which pixels a splat that stops some is blended into; p as before. */
inline iv blended_over(const Pixels *p, const Touch *t)
{
    const fv after = fma(-t->alpha, p->transmittance, p->transmittance);
    const iv live = t->touched & (p->transmittance > (fv)(0.0f));
    return STOP_INCLUSIVE ? live : live & (after >= p->stop);
}

/* Takes a splat off pixels again and adds its gradients. Returns which pixels
 * had it. */
inline iv blend_back(Rays *p, const Paint *paint, const Touch *t, int number, Moments *m)
{
    const iv blends = t->touched & ((iv)(number) <= p->last);
    const fv alpha = blends ? t->alpha : (fv)(0.0f);
    p->transmittance = p->transmittance / (1.0f - alpha);
    const fv weight = alpha * p->transmittance;
    const fv color = fma(p->d_red, (fv)(paint->red),
                         fma(p->d_green, (fv)(paint->green), p->d_blue * paint->blue));
    const fv change = color - p->behind;
    p->behind = fma(alpha, change, p->behind);
    const fv v = t->saturated ? (fv)(0.0f) : weight * change;
    /* an untouched pixel may hold anything, even infinity */
    const fv y1 = blends ? t->y1 : (fv)(0.0f), y2 = blends ? t->y2 : (fv)(0.0f);
    const fv v1 = v * y1, v2 = v * y2;
    m->y1 += v1;
    m->y2 += v2;
    m->y11 = fma(v1, y1, m->y11);
    m->y12 = fma(v1, y2, m->y12);
    m->y22 = fma(v2, y2, m->y22);
    m->red = fma(weight, p->d_red, m->red);
    m->green = fma(weight, p->d_green, m->green);
    m->blue = fma(weight, p->d_blue, m->blue);
    m->alpha += v;
    return blends;
}

#endif
