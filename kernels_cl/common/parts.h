/* Launches over several arrays: the work-items of each begin with a work-group. A work-item finds
 * its array by the number of its group, which all of its group share. */
#ifndef CLGS_PARTS_H
#define CLGS_PARTS_H

/* Work-groups that have so many work-items. */
static inline size_t groups_of(const size_t items)
{
    return (items + get_local_size(0) - 1) / get_local_size(0);
}

/* This work-item's number among those of its array, whose first work-group has number `begin`. */
static inline size_t item_of_part(const size_t begin)
{
    return (get_group_id(0) - begin) * get_local_size(0) + get_local_id(0);
}

#endif
