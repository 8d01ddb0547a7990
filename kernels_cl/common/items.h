/* Numbers of work-items. */
#ifndef CLGS_ITEMS_H
#define CLGS_ITEMS_H

#ifndef USE_LOCAL
#define USE_LOCAL 0
#endif

/* The number of this work-item, work-groups counted from the middle one on, and from the first one
 * on after the last. A CPU's driver deals out large pieces first and small ones last, to even its
 * threads out; arrays end in padding, which costs nothing: the last pieces must not be those. */
inline size_t item_from_middle(void)
{
#if USE_LOCAL
    return get_global_id(0);
#else
    const size_t groups = get_num_groups(0), group = get_group_id(0) + groups / 2;
    return (group < groups ? group : group - groups) * get_local_size(0) + get_local_id(0);
#endif
}

#endif
