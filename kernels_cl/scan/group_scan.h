/* Exclusive prefix sum over the work-items of one work-group (GPU form only). */
#ifndef CLGS_GROUP_SCAN_H
#define CLGS_GROUP_SCAN_H

#include "common/form.h"

#ifndef SCAN_GROUP_SIZE
#define SCAN_GROUP_SIZE 256 /* work-items of a work-group */
#endif
#define SCAN_GROUP GROUP_OF(SCAN_GROUP_SIZE)

#define SCAN_SCRATCH                                                                               \
    (2 * SCAN_GROUP_SIZE) /* numbers of local memory; halves are read and written in turn */

/* Sum of the values of the work-items before this one; *total is the sum of all. Every work-item of
 * the group must call it; scratch holds SCAN_SCRATCH numbers and is free again on return. */
static inline long group_exclusive_scan(long value, __local long *scratch, long *total)
{
    const int item = (int)get_local_id(0);
    __local long *read = scratch, *write = scratch + SCAN_GROUP_SIZE;
    long inclusive = value;
    read[item] = value;
    barrier(CLK_LOCAL_MEM_FENCE);
    for (int step = 1; step < SCAN_GROUP_SIZE; step *= 2) {
        inclusive += item >= step ? read[item - step] : 0L;
        write[item] = inclusive;
        barrier(CLK_LOCAL_MEM_FENCE);
        __local long *written = write;
        write = read;
        read = written;
    }
    *total = read[SCAN_GROUP_SIZE - 1];
    barrier(CLK_LOCAL_MEM_FENCE);
    return inclusive - value;
}

#endif
