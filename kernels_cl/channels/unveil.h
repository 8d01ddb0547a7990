/* Blending by channels taken apart again, back to front: one record over VEC pixels. */
#ifndef CLGS_UNVEIL_H
#define CLGS_UNVEIL_H

#include "blend/record.h"
#include "blend/touch.h"
#include "channels/layout.h"
#include "common/ellipses.h"
#include "common/real.h"

/* VEC pixels on the way back to front. */
typedef struct {
    fv transmittance; /* after the records that are still to come */
    fv behind;        /* channels after them per transmittance, dotted with d_image */
    iv last;          /* entries of the list that these pixels saw in the forward pass */
    fv d[ALL_CHANNELS];
} ChannelRays;

/* Takes a record with the channels `value` off pixels and adds its first moments to `m`; returns
 * its weights, which times `d` are the moments of the channels. `number` counts list entries from
 * 1. */
static inline fv unveil(ChannelRays *p, const Record *record, const float value[ALL_CHANNELS],
                        const Touch *t, const int number, fv m[MOMENT_CHANNEL])
{
    const iv blends = t->touched & ((iv)(number) <= p->last);
    const fv alpha = blends ? t->alpha : (fv)(0.0f);
    p->transmittance = p->transmittance / (1.0f - alpha);
    const fv weight = alpha * p->transmittance;
    fv shade = (fv)(0.0f);
#pragma unroll
    for (int c = 0; c < ALL_CHANNELS; ++c)
        shade = fma(p->d[c], (fv)(value[c]), shade);
    const fv change = shade - p->behind;
    p->behind = fma(alpha, change, p->behind);
    const fv v = t->saturated ? (fv)(0.0f) : weight * change;
    /* an untouched pixel may hold anything, even infinity */
    const fv y1 = blends ? t->y1 : (fv)(0.0f), y2 = blends ? t->y2 : (fv)(0.0f);
    const fv v1 = v * y1, v2 = v * y2;
    m[0] += v1;
    m[1] += v2;
    /* no fma: the GPU form adds up what each pixel gives, and must get the same bits */
    m[2] += v1 * y1;
    m[3] += v1 * y2;
    m[4] += v2 * y2;
    m[MOMENT_ALPHA] += v;
#if WITH_ABSOLUTE
    const float unit = 1.0f / (WHITENING_UNIT * WHITENING_UNIT), back = record->l * record->r2;
    m[MOMENT_ABSOLUTE] += fabs(record->r1 * v1 - back * v2) * unit;
    m[MOMENT_ABSOLUTE + 1] += fabs(record->r2 * v2) * unit;
#else
    (void)record;
#endif
    return weight;
}

#endif
