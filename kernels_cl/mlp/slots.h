/* Slots of a block of samples: which are drawn, which are computed, and which rows of the outputs
 * (mlp/layout.h) they have. */
#ifndef CLGS_MLP_SLOTS_H
#define CLGS_MLP_SLOTS_H

#include "common/lanes.h"
#include "common/method.h"
#include "common/real.h"
#include "mlp/layout.h"

/* What options.py calls the skips: nothing for samples that draw nothing, and no slot that no
 * sample of the block draws. */
#ifndef SKIP_OPACITY_FIRST
#define SKIP_OPACITY_FIRST 1
#endif
#ifndef SKIP_SLOTS
#define SKIP_SLOTS 1
#endif

/* Whether a lane is positive; NaN is not. */
static inline bool any_positive(const fv x)
{
#if VEC == 1
    return x > 0.0f;
#else
    return any(x > (fv)(0.0f));
#endif
}

/* The slots, one per bit, that some sample of the block draws: those with a positive opacity. */
static inline int drawn_slots(__global const float *opacity, const size_t stride)
{
    int slots = 0;
    for (int j = 0; j < K_OFFSETS; ++j)
        for (int s = 0; s < VECTORS; ++s)
            slots |= any_positive(LOAD_ALIGNED(s, opacity + j * stride)) ? 1 << j : 0;
    return slots;
}

/* The slots, one per bit, that are computed for the block. */
static inline int computed_slots(__global const float *opacity, const size_t stride)
{
    const int drawn = drawn_slots(opacity, stride), all = (1 << K_OFFSETS) - 1;
    if (SKIP_SLOTS)
        return drawn;
    return SKIP_OPACITY_FIRST && drawn == 0 ? 0 : all;
}

/* Rows of one head that belong to the given slots, ascending; returns how many. */
static inline size_t rows_of(const int slots, const int head, size_t rows[OUTPUT_ROWS])
{
    const size_t each = (size_t)slot_rows(head);
    size_t count = 0;
    for (size_t j = 0; j < K_OFFSETS; ++j)
        for (size_t i = 0; (slots >> j & 1) && i < each; ++i)
            rows[count++] = j * each + i;
    return count;
}

#endif
