/* A patch or block shared by a work-group: 256 work-items with local memory and barriers
 * (USE_LOCAL 1), or one work-item with private memory and no barriers (USE_LOCAL 0). Loops over
 * shared work are written
 *     for (int unit = ITEM; unit < count; unit += ITEMS)
 * and reductions have a fixed order, so that a device always gives the same bits. */
#ifndef CLGS_GROUP_H
#define CLGS_GROUP_H

#include "common/form.h"

/* Work-items of a group. */
#ifndef ITEMS
#define ITEMS (USE_LOCAL ? 256 : 1)
#endif

#if USE_LOCAL
#define SPACE __local
#define ITEM ((int)get_local_id(0))
#define SYNC() barrier(CLK_LOCAL_MEM_FENCE)
#define GROUP_SIZED GROUP_OF(ITEMS)
#else
#define SPACE __private
#define ITEM 0
#define SYNC()
#define GROUP_SIZED
#endif

/* Reduction of one float4 per work-item over the group; every work-item gets the result. scratch
 * holds ITEMS values and may be used again after the call. */
#if USE_LOCAL
#define DEFINE_GROUP_REDUCTION(name, COMBINE)                                                      \
    static inline float4 name(float4 value, __local float4 *scratch)                               \
    {                                                                                              \
        scratch[ITEM] = value;                                                                     \
        SYNC();                                                                                    \
        for (int reach = ITEMS / 2; reach > 0; reach /= 2) {                                       \
            if (ITEM < reach)                                                                      \
                scratch[ITEM] = COMBINE(scratch[ITEM], scratch[ITEM + reach]);                     \
            SYNC();                                                                                \
        }                                                                                          \
        const float4 result = scratch[0];                                                          \
        SYNC();                                                                                    \
        return result;                                                                             \
    }
#else
#define DEFINE_GROUP_REDUCTION(name, COMBINE)                                                      \
    static inline float4 name(float4 value, __private float4 *scratch)                             \
    {                                                                                              \
        (void)scratch;                                                                             \
        return value;                                                                              \
    }
#endif

#define ADD(a, b) ((a) + (b))
#define SMALLER(a, b) ((b) < (a) ? (b) : (a))
DEFINE_GROUP_REDUCTION(group_sum, ADD)
DEFINE_GROUP_REDUCTION(group_min, SMALLER)

#endif
