/* Blending front to back: one record over VEC pixels. */
#ifndef CLGS_PIXELS_H
#define CLGS_PIXELS_H

#include "blend/record.h"
#include "blend/touch.h"
#include "common/real.h"

#ifndef TRANSMITTANCE_STOP
#define TRANSMITTANCE_STOP 1e-4f
#endif
#ifndef STOP_INCLUSIVE
#define STOP_INCLUSIVE 0 /* whether the record that crosses TRANSMITTANCE_STOP is blended */
#endif
#ifndef SKIP_FINISHED
#define SKIP_FINISHED 1 /* see Skips in clgs/options.py */
#endif

/* Whether a mask has a lane; compilers make one test of this, unlike of any(). */
static inline bool any_lane(iv mask)
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

/* VEC pixels: what every record changes. A finished pixel has a transmittance of zero, so that
 * nothing changes it any more. */
typedef struct {
    fv transmittance, red, green, blue;
    fv stop; /* finished below this transmittance; 0 once finished */
} Pixels;

/* What is kept of pixels when they are finished. */
typedef struct {
    fv transmittance; /* negative if not finished */
    iv last;          /* entries that the pixel saw before it was finished */
} Ends;

/* Pixels of the image start with nothing in front of them; those outside of it are finished. */
static inline void start_pixels(Pixels *p, Ends *e, iv inside)
{
    p->transmittance = inside ? (fv)(1.0f) : (fv)(0.0f);
    p->red = p->green = p->blue = (fv)(0.0f);
    p->stop = inside ? (fv)(TRANSMITTANCE_STOP) : (fv)(0.0f);
    e->transmittance = inside ? (fv)(-1.0f) : (fv)(0.0f);
    e->last = (iv)(0);
}

/* Blends a record into pixels; `number` counts list entries from 1. Returns which pixels stop
 * here. */
static inline iv blend_over(Pixels *p, Ends *e, const Record *record, const Touch *t, int number)
{
    const fv alpha = t->touched ? t->alpha : (fv)(0.0f);
    fv weight = alpha * p->transmittance;
    fv after = fma(-alpha, p->transmittance, p->transmittance);
    const iv stops = after < p->stop;
    if (any_lane(stops)) { /* rare: at most once per pixel */
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
    p->red = fma(weight, (fv)(record->red), p->red);
    p->green = fma(weight, (fv)(record->green), p->green);
    p->blue = fma(weight, (fv)(record->blue), p->blue);
    p->transmittance = after;
    return stops;
}

/* Which pixels blend_over blends a record into; p as before that call. */
static inline iv blended_over(const Pixels *p, const Touch *t)
{
    const fv after = fma(-t->alpha, p->transmittance, p->transmittance);
    const iv live = t->touched & (p->transmittance > (fv)(0.0f));
    return STOP_INCLUSIVE ? live : live & (after >= p->stop);
}

#endif
