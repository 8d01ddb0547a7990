/* Anchors come and go without any row of theirs being moved. An anchor that goes is hidden: its
 * position becomes NaN, which no view sees, and its slots ask for nothing any more.
 *
 * growth_hide_undrawn: a work-item per visible anchor. growth_prune: per anchor.
 * growth_ask, growth_restart: per slot. growth_places: per slot that asks for an anchor.
 * growth_append: per number of a feature of each new anchor.
 * growth_take: per number of each row that is kept.
 * Work-group: any; no local memory.
 */
#include "common/method.h"

/* Numbers of a row of scaling. */
#define SCALING_DIM 6
#define OFFSET_DIM (3 * K_OFFSETS)

/* Numbers of a place: a slot's offset, and the log scale of its anchor's offsets. */
#ifndef PLACE_DIM
#define PLACE_DIM 6
#endif

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
        if (!drawn)
            vstore3((float3)(0.0f), K_OFFSETS * anchor + j, offset);
    }
    if (!any)
        hide(anchor, position, visits, gradient_count);
}

/* Of anchors visited more often than `often`, hides those with a summed opacity below `least` per
 * visit, gone[i] = 1, and zeroes the sums of the others. No log scale of a shape stays above
 * `most`.
 */
__kernel void growth_prune(const int count, const int often, const float least, const float most,
                           __global float *position, __global float *scaling,
                           __global float *opacity_sum, __global int *visits,
                           __global int *gradient_count, __global int *gone)
{
    const size_t anchor = get_global_id(0);
    if (anchor >= (size_t)count)
        return;
    const bool visited = visits[anchor] > often;
    gone[anchor] = visited && !(opacity_sum[anchor] >= least * (float)visits[anchor]) ? 1 : 0;
    if (visited) {
        opacity_sum[anchor] = 0.0f;
        visits[anchor] = 0;
    }
    if (gone[anchor])
        hide(anchor, position, visits, gradient_count);
    for (size_t i = 3; i < SCALING_DIM; ++i) {
        const float value = scaling[SCALING_DIM * anchor + i];
        scaling[SCALING_DIM * anchor + i] = value > most ? most : value;
    }
}

/* asks[slot] = 1 if the slot was seen more often than `seen` times, with a sum of at least `least`
 * per time. */
__kernel void growth_ask(const int count, const int seen, const float least,
                         __global const float *gradient_sum, __global const int *gradient_count,
                         __global uchar *asks)
{
    const size_t slot = get_global_id(0);
    if (slot >= (size_t)count)
        return;
    const int times = gradient_count[slot];
    asks[slot] = times > seen && gradient_sum[slot] >= least * (float)times ? 1 : 0;
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
