/* Sums of parts of the counts, which a kernel that counts leaves for scan/offsets: on CPUs a part
 * is what a work-item counts, VEC numbers; on GPUs what a work-group of SCAN_GROUP_SIZE work-items
 * does.
 */
#ifndef CLGS_PART_SUMS_H
#define CLGS_PART_SUMS_H

#include "common/form.h"
#include "common/real.h"

#if USE_LOCAL
#include "scan/group_scan.h"

#define PART_GROUP GROUP_OF(SCAN_GROUP_SIZE)
#define DECLARE_PART_SCRATCH(name) __local int name[2]

/* Writes the sum over the work-group, of which every work-item must call it. The halves of the
 * counts are added apart, so that no sum overflows. */
static inline void write_part_sum(__local int *scratch, const size_t first, const int count,
                                  const int sum, __global long *sums)
{
    const int item = (int)get_local_id(0);
    if (item < 2)
        scratch[item] = 0;
    barrier(CLK_LOCAL_MEM_FENCE);
    if (first < (size_t)count) {
        atomic_add(&scratch[0], sum & 0xffff);
        atomic_add(&scratch[1], sum >> 16);
    }
    barrier(CLK_LOCAL_MEM_FENCE);
    if (item == 0)
        sums[get_group_id(0)] = (long)scratch[0] + ((long)scratch[1] << 16);
}
#else
#define PART_GROUP
#define DECLARE_PART_SCRATCH(name) __local int *name = 0

/* Writes the sum of the VEC counts from `first` on, if there are any. */
static inline void write_part_sum(__local int *scratch, const size_t first, const int count,
                                  const int sum, __global long *sums)
{
    (void)scratch;
    if (first < (size_t)count)
        sums[first / VEC] = (long)sum;
}
#endif

#endif
