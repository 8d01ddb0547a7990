/* Blending taken apart again, back to front: one record over VEC pixels. */
#ifndef CLGS_RAYS_H
#define CLGS_RAYS_H

#include "blend/moments.h"
#include "blend/record.h"
#include "blend/touch.h"
#include "common/real.h"

#ifndef SKIP_CONTRIBUTORS
#define SKIP_CONTRIBUTORS 1 /* see Skips in clgs/options.py */
#endif

/* VEC pixels on the way back to front. */
typedef struct {
    fv transmittance; /* behind the records that are not taken off yet */
    fv behind;        /* color behind these records per transmittance, times d_image */
    fv d_red, d_green, d_blue;
    iv last; /* entries of the list that these pixels saw in the forward pass */
} Rays;

/* Adds a pixel's share to a moment. In the GPU form a Moments has one pixel and one record, so that
 * it is set. It may then be -0 instead of 0, which changes no sum that it is added to later. */
#if VEC == 1
#define GIVE(moment, value) (moment) = (value)
#else
#define GIVE(moment, value) (moment) += (value)
#endif

/* Takes a record off pixels and gives its gradients to m; `number` counts list entries from 1.
 * Returns which pixels had it. */
static inline iv blend_back(Rays *p, const Record *record, const Touch *t, int number, Moments *m)
{
    const iv blends = t->touched & ((iv)(number) <= p->last);
    const fv alpha = blends ? t->alpha : (fv)(0.0f);
    p->transmittance = p->transmittance / (1.0f - alpha);
    const fv weight = alpha * p->transmittance;
    const fv color = fma(p->d_red, (fv)(record->red),
                         fma(p->d_green, (fv)(record->green), p->d_blue * record->blue));
    const fv change = color - p->behind;
    p->behind = fma(alpha, change, p->behind);
    const fv v = t->saturated ? (fv)(0.0f) : weight * change;
    /* an untouched pixel may hold anything, even infinity */
    const fv y1 = blends ? t->y1 : (fv)(0.0f), y2 = blends ? t->y2 : (fv)(0.0f);
    const fv v1 = v * y1, v2 = v * y2;
    GIVE(m->y1, v1);
    GIVE(m->y2, v2);
    /* no fma: the GPU form adds up what each pixel gives, and must get the same bits */
    GIVE(m->y11, v1 * y1);
    GIVE(m->y12, v1 * y2);
    GIVE(m->y22, v2 * y2);
    GIVE(m->red, weight * p->d_red);
    GIVE(m->green, weight * p->d_green);
    GIVE(m->blue, weight * p->d_blue);
    GIVE(m->alpha, v);
    return blends;
}

#endif
