/* What the samples of a work-group read: GPU form. */
#ifndef CLGS_MLP_GROUP_INPUTS_H
#define CLGS_MLP_GROUP_INPUTS_H

#include "common/method.h"
#include "common/real.h"
#include "mlp/group/layer.h"
#include "mlp/inputs.h"
#include "mlp/layout.h"
#include "mlp/slots.h"

/* The direction to one sample's anchor to its column of x, and whether it counts to row INPUT_DIM:
 * 1, or 0 without anchor, or NaN if an input is not finite. The column of a sample that does not
 * count is zero. */
static inline void finish_column(const Inputs *inputs, const int anchor, __local float *column)
{
    fv view[3] = {0.0f, 0.0f, 0.0f};
    if (anchor >= 0) {
        __global const float *position[1] = {inputs->position + 3 * (size_t)anchor};
        view_directions(inputs, position, view);
    }
    for (int i = 0; i < 3; ++i)
        column[(FEATURE_DIM + i) * ROW_PITCH] = view[i];
    int finite = 1; /* by `&`: compilers make a branch of every `&&` */
    for (int k = 0; k < INPUT_DIM; ++k)
        finite &= fabs(column[k * ROW_PITCH]) <= INPUT_LIMIT;
    for (int k = 0; k < INPUT_DIM && !finite; ++k)
        column[k * ROW_PITCH] = 0.0f;
    column[INPUT_DIM * ROW_PITCH] = anchor < 0 ? 0.0f : finite ? 1.0f : NAN;
}

/* Rows x, INPUT_DIM + 1, of the samples from `first` on. Ends with a barrier. */
static inline void gather_rows(const Inputs *inputs, const size_t first, __local float *x)
{
    const int item = (int)get_local_id(0);
    for (int i = item; i < SAMPLES * FEATURE_DIM; i += LAYER_ITEMS) {
        const int sample = i / FEATURE_DIM, k = i % FEATURE_DIM;
        const int anchor = anchor_of(inputs, first + (size_t)sample);
        x[k * ROW_PITCH + sample] =
            anchor < 0 ? 0.0f : inputs->feature[(size_t)anchor * FEATURE_DIM + (size_t)k];
    }
    barrier(CLK_LOCAL_MEM_FENCE);
    if (item < SAMPLES)
        finish_column(inputs, anchor_of(inputs, first + (size_t)item), x + item);
    barrier(CLK_LOCAL_MEM_FENCE);
}

/* The bits that any work-item has. */
static inline int group_or(const int own, __local int *shared)
{
    if (get_local_id(0) == 0)
        *shared = 0;
    barrier(CLK_LOCAL_MEM_FENCE);
    if (own != 0)
        atomic_or(shared, own);
    barrier(CLK_LOCAL_MEM_FENCE);
    return *shared;
}

/* The slots, one per bit, that are computed for the samples [first, end) of the group. */
static inline int group_slots(__global const float *output, const size_t first, const size_t end,
                              const size_t stride, __local int *shared)
{
    const size_t sample = first + get_local_id(0);
    const bool own = get_local_id(0) < SAMPLES && sample < end;
    return group_or(own ? computed_slots(output + sample, stride) : 0, shared);
}

/* Rows of one head that belong to the given slots, ascending, to `rows`; returns how many. Begins
 * and ends with a barrier. */
static inline int list_rows(const int slots, const int head, __local int *rows)
{
    const int each = slot_rows(head), own = (int)get_local_id(0);
    int count = 0, row = -1;
    for (int j = 0; j < K_OFFSETS; ++j)
        if (slots >> j & 1) {
            row = own >= count && own < count + each ? j * each + own - count : row;
            count += each;
        }
    barrier(CLK_LOCAL_MEM_FENCE);
    if (own < count)
        rows[own] = row;
    barrier(CLK_LOCAL_MEM_FENCE);
    return count;
}

#endif
