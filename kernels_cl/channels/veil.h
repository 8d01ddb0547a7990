/* One record over VEC pixels, front to back, without its channels. */
#ifndef CLGS_VEIL_H
#define CLGS_VEIL_H

#include "blend/pixels.h"
#include "blend/touch.h"
#include "common/real.h"

/* What lies in front of VEC pixels. A finished one has a transmittance of zero, so that nothing
 * changes it any more. */
typedef struct {
    fv transmittance;
    fv stop; /* finished below this transmittance; 0 once finished */
    fv left; /* transmittance of finished pixels; negative before */
    iv last; /* entries up to the end of the pixel */
} Veil;

/* Pixels outside of the image are finished. */
static inline void start_veil(Veil *v, const iv inside)
{
    v->transmittance = inside ? (fv)(1.0f) : (fv)(0.0f);
    v->stop = inside ? (fv)(TRANSMITTANCE_STOP) : (fv)(0.0f);
    v->left = inside ? (fv)(-1.0f) : (fv)(0.0f);
    v->last = (iv)(0);
}

/* Puts a record in front of pixels; returns its weights. `number` counts list entries from 1;
 * `stops` becomes the pixels that are finished before it. */
static inline fv veil_over(Veil *v, const Touch *t, const int number, iv *stops)
{
    const fv alpha = t->touched ? t->alpha : (fv)(0.0f);
    fv weight = alpha * v->transmittance;
    fv after = fma(-alpha, v->transmittance, v->transmittance);
    *stops = after < v->stop;
    if (any_lane(*stops)) { /* rare: at most once per pixel */
        v->left = *stops ? v->transmittance : v->left;
        v->last = *stops ? (iv)(number - 1) : v->last;
        weight = *stops ? (fv)(0.0f) : weight;
        after = *stops ? (fv)(0.0f) : after;
        v->stop = *stops ? (fv)(0.0f) : v->stop;
    }
    v->transmittance = after;
    return weight;
}

/* Transmittance, and entries up to the end, of pixels that have seen all `entries` of a list. */
static inline fv veil_rest(const Veil *v, const int entries, iv *last)
{
    const iv open = v->left < (fv)(0.0f);
    *last = open ? (iv)(entries) : v->last;
    return open ? v->transmittance : v->left;
}

#endif
