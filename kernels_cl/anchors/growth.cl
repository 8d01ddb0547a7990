/* Anchors come and go without any row of theirs being moved. An anchor that goes is hidden: its
 * position becomes NaN, which no view sees, and its slots ask for nothing any more.
 *
 * growth_hide_undrawn: a work-item per visible anchor. growth_hide: per anchor that goes.
 * growth_places: a work-item per slot that asks for an anchor.
 * growth_restart: per slot. growth_cap: per anchor.
 * growth_append: per number of a feature of each new anchor.
 * growth_take: per number of each row that is kept.
 * Work-group: any; no local memory.
 */
#include "common/method.h"

/* Numbers of a row of scaling. */
#define SCALING_DIM 6
#define OFFSET_DIM (3 * K_OFFSETS)

/* Numbers of a place: a slot's offset, and the log scale of its anchor's offsets. */
#define PLACE_DIM 6

static inline void hide(const size_t anchor, __global float *position, __global int *visits,
                        __global int *gradient_count)
{
    for (size_t i = 0; i < 3; ++i)
        position[3 * anchor + i] = NAN;
    for (size_t j = 0; j < K_OFFSETS; ++j)
        gradient_count[K_OFFSETS * anchor + j] = 0;
    visits[anchor] = 0;
}

/* Zeroes the offsets of slots that are not drawn, and hides anchors of which none is. An entry -1
 * of visible is no anchor. */
__kernel void growth_hide_undrawn(__global const float *opacity, __global const int *visible,
                                  const int count, const int padded, __global float *position,
                                  __global float *offset, __global int *visits,
                                  __global int *gradient_count)
{
    const size_t v = get_global_id(0);
    if (v >= (size_t)count || visible[v] < 0)
        return;
    const size_t anchor = (size_t)visible[v];
    bool any = false;
    for (size_t j = 0; j < K_OFFSETS; ++j) {
        const bool drawn = opacity[j * (size_t)padded + v] > 0.0f;
        any |= drawn;
        for (size_t i = 0; i < 3 && !drawn; ++i)
            offset[OFFSET_DIM * anchor + 3 * j + i] = 0.0f;
    }
    if (!any)
        hide(anchor, position, visits, gradient_count);
}

/* Hides the anchors in `rows`. */
__kernel void growth_hide(__global const int *rows, const int count, __global float *position,
                          __global int *visits, __global int *gradient_count)
{
    const size_t i = get_global_id(0);
    if (i < (size_t)count)
        hide((size_t)rows[i], position, visits, gradient_count);
}

/* place[i] = the offset of slot number slots[i], and the log scale that it is multiplied by. */
__kernel void growth_places(__global const int *slots, const int count,
                            __global const float *offset, __global const float *scaling,
                            __global float *place)
{
    const size_t i = get_global_id(0);
    if (i >= (size_t)count)
        return;
    const size_t slot = (size_t)slots[i], anchor = slot / K_OFFSETS;
    for (size_t axis = 0; axis < 3; ++axis) {
        place[PLACE_DIM * i + axis] = offset[3 * slot + axis];
        place[PLACE_DIM * i + 3 + axis] = scaling[SCALING_DIM * anchor + axis];
    }
}

/* Zeroes the sums of slots that were seen more often than `seen` times. */
__kernel void growth_restart(const int count, const int seen, __global float *gradient_sum,
                             __global int *gradient_count)
{
    const size_t slot = get_global_id(0);
    if (slot >= (size_t)count || gradient_count[slot] <= seen)
        return;
    gradient_sum[slot] = 0.0f;
    gradient_count[slot] = 0;
}

/* No log scale of a shape is above `most`. */
__kernel void growth_cap(const int count, const float most, __global float *scaling)
{
    const size_t anchor = get_global_id(0);
    if (anchor >= (size_t)count)
        return;
    for (size_t i = 3; i < SCALING_DIM; ++i) {
        const float value = scaling[SCALING_DIM * anchor + i];
        scaling[SCALING_DIM * anchor + i] = value > most ? most : value;
    }
}

/* Rows `before` and on of the anchors: new anchor i lies at place[3 i], with log scales of edge[i],
 * and has the channel-wise maximum of the features of parents[first[i]] to parents[first[i + 1]-1].
 */
__kernel void growth_append(__global const float *place, __global const float *edge,
                            __global const int *first, __global const int *parents, const int count,
                            const int before, __global float *position, __global float *feature,
                            __global float *scaling)
{
    const size_t channel = get_global_id(0) % FEATURE_DIM, i = get_global_id(0) / FEATURE_DIM;
    if (i >= (size_t)count)
        return;
    const size_t row = (size_t)before + i;
    float most = feature[FEATURE_DIM * (size_t)parents[first[i]] + channel];
    for (int k = first[i] + 1; k < first[i + 1]; ++k) {
        const float value = feature[FEATURE_DIM * (size_t)parents[k] + channel];
        most = value > most ? value : most;
    }
    feature[FEATURE_DIM * row + channel] = most;
    if (channel < 3)
        position[3 * row + channel] = place[3 * i + channel];
    if (channel < SCALING_DIM)
        scaling[SCALING_DIM * row + channel] = edge[i];
}

/* Row i of `taken` is row rows[i] of `source`; a row has `width` numbers of 32 bits. */
__kernel void growth_take(__global const int *rows, __global const int *source, const uint total,
                          const uint width, __global int *taken)
{
    const size_t i = get_global_id(0);
    if (i >= (size_t)total)
        return;
    taken[i] = source[(size_t)rows[i / width] * width + i % width];
}
