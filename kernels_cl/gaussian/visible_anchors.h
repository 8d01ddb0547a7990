/* The visible anchors of a view, VEC of them at a time. */
#ifndef CLGS_VISIBLE_ANCHORS_H
#define CLGS_VISIBLE_ANCHORS_H

#include "common/method.h"
#include "common/own_function.h"
#include "common/prefetch.h"
#include "common/real.h"
#include "gaussian/drawn_slots.h"
#include "gaussian/log_scale.h"

/* visible: the anchor of each of `count` samples, -1 for none. The others belong to all anchors:
 * position (A, 3), offset (A, K, 3) and scaling (A, 6), the log scales of offsets and shapes. */
typedef struct {
    __global const int *visible;
    size_t count;
    __global const float *position;
    __global const float *offset;
    __global const float *scaling;
} VisibleAnchors;

/* Prefetches what is read of `lanes` visible anchors from v on. */
static inline void prefetch_anchors(const VisibleAnchors *anchors, const size_t v,
                                    const size_t lanes)
{
    for (size_t lane = 0; lane < lanes && v + lane < anchors->count; ++lane) {
        const size_t anchor = (size_t)max(anchors->visible[v + lane], 0);
        PREFETCH(anchors->scaling + 6 * anchor);
        for (size_t i = 0; i < 3 * K_OFFSETS; i += LINE)
            PREFETCH(anchors->offset + 3 * K_OFFSETS * anchor + i);
        PREFETCH(anchors->offset + 3 * K_OFFSETS * (anchor + 1) - 1);
    }
}

/* VEC visible anchors, one per lane; a lane without anchor draws nothing. */
typedef struct {
    int anchor[VEC]; /* its index, -1: none */
    float log_scale[6][VEC];
} AnchorLanes;

/* The visible anchors from v on. */
static inline AnchorLanes load_anchors(__global const int *visible, __global const float *scaling,
                                       const size_t v, const size_t count)
{
    AnchorLanes a;
    for (size_t lane = 0; lane < VEC; ++lane) {
        a.anchor[lane] = v + lane < count ? visible[v + lane] : -1;
        const bool exists = a.anchor[lane] >= 0;
        for (size_t i = 0; i < 6; ++i)
            a.log_scale[i][lane] = exists ? scaling[6 * (size_t)a.anchor[lane] + i] : 0.0f;
    }
    return a;
}

#if VEC > 1
/* Copies the offsets of VEC anchors. */
static inline void copy_offsets(const AnchorLanes *a, __global const float *offset, float *copy)
{
    for (size_t lane = 0; lane < VEC; ++lane) {
        __global const float *own = offset + 3 * K_OFFSETS * (size_t)max(a->anchor[lane], 0);
        for (size_t i = 0; i < 3 * K_OFFSETS; ++i)
            copy[3 * K_OFFSETS * lane + i] = own[i];
    }
}
#endif

/* Means of the Gaussians of the drawn slots: an offset away from their anchors. */
static inline OWN_FUNCTION void gather_means(const VisibleAnchors *anchors, const AnchorLanes *a,
                                             const DrawnSlots *drawn, float mean[3][SLOTS])
{
    float reach[3][VEC], centre[3][VEC];
#if VEC == 1
    __global const float *offsets = anchors->offset + 3 * K_OFFSETS * (size_t)max(a->anchor[0], 0);
#else
    float offsets[3 * SLOTS]; /* copied at once, so that a CPU's cache misses overlap */
    copy_offsets(a, anchors->offset, offsets);
#endif
    for (int i = 0; i < 3; ++i) {
        STORE_V(exp_log_scale(LOAD_V(0, a->log_scale[i])), 0, reach[i]);
        for (size_t lane = 0; lane < VEC; ++lane)
            centre[i][lane] = anchors->position[3 * (size_t)max(a->anchor[lane], 0) + i];
    }
    for (size_t m = 0; m < DRAWN(drawn); ++m) {
        const size_t lane = drawn->lane[m], start = 3 * (lane * K_OFFSETS + drawn->offset[m]);
#pragma unroll
        for (int i = 0; i < 3; ++i)
            mean[i][m] = fma(offsets[start + i], reach[i][lane], centre[i][lane]);
    }
}

#endif
