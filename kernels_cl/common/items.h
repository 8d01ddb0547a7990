/* Which work-item does which work. */
#ifndef CLGS_ITEMS_H
#define CLGS_ITEMS_H

#include "common/form.h"

/* The number of this work-item, with work-groups counted from the middle one on, and from the first
 * one on after the last. A CPU's driver hands out large pieces first and small ones last, to
 * balance its threads; arrays end in padding, which costs nothing, so padding must not be the last
 * piece. */
static inline size_t item_from_middle(void)
{
#if USE_LOCAL
    return get_global_id(0);
#else
    const size_t groups = get_num_groups(0), group = get_group_id(0) + groups / 2;
    return (group < groups ? group : group - groups) * get_local_size(0) + get_local_id(0);
#endif
}

#endif
