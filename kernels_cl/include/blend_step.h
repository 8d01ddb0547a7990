/* One splat over VEC pixels, front to back and back to front; and the records it is read from. */
#ifndef CLGS_BLEND_STEP_H
#define CLGS_BLEND_STEP_H

#include "include/splat.h"

#ifndef TRANSMITTANCE_STOP
#define TRANSMITTANCE_STOP 1e-4f
#endif
#ifndef COLOR_LIMIT
#define COLOR_LIMIT 1e3f
#endif

/* A record holds a splat ready to blend, 16 floats: one for each Gaussian first, then one for each
 * entry in list order, so that the blend reads them as a stream. */
#define RECORD_SIZE 16
#define RECORD_SPLAT 0 /* x, y, r1, l, r2, bias */
#define RECORD_COLOR 6 /* red, green, blue */
#define RECORD_HALF 9  /* of a Gaussian: half-widths of its box */
#define RECORD_UNITS 9 /* of an entry, uint: units of the tile that it may touch (CPU form) */
#define RECORD_ROW 11  /* of an entry, int: where its gradients go */
#define RECORD_USED 12

/* Gradient rows: the sums over the pixels of a tile of
 * v y1, v y2, v y1^2, v y1 y2, v y2^2, w red, w green, w blue, v
 * with v = alpha dL/d(alpha) and w red = weight dL/d(red of the image). */
#define ROW_SIZE 16
#define ROW_USED 9

typedef struct {
    Splat splat;
    float red, green, blue;
} Paint;

/* VEC pixels on the way front to back. A finished pixel has its transmittance negated. */
typedef struct {
    fv transmittance, red, green, blue;
    iv last; /* entries up to and including the last one blended */
} Pixels;

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

/* Blends a splat into pixels; number counts list entries from 1. Returns which pixels took it. */
inline iv blend_over(Pixels *p, const Paint *paint, const Touch *t, int number)
{
    const iv candidate = t->touched & (p->transmittance > (fv)(0.0f));
    const fv after = fma(-t->alpha, p->transmittance, p->transmittance);
    const iv stops = candidate & (after < (fv)(TRANSMITTANCE_STOP));
    const iv blends = candidate & ~stops;
    const fv weight = blends ? t->alpha * p->transmittance : (fv)(0.0f);
    p->red = fma(weight, (fv)(paint->red), p->red);
    p->green = fma(weight, (fv)(paint->green), p->green);
    p->blue = fma(weight, (fv)(paint->blue), p->blue);
    p->transmittance = stops ? -p->transmittance : (blends ? after : p->transmittance);
    p->last = blends ? (iv)(number) : p->last;
    return blends;
}

/* Takes a splat off pixels again and adds its gradients. Returns which pixels had it. */
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
