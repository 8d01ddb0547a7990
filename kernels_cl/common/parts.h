/* Launches over several arrays: the work-items of each begin with a work-group. A work-item finds
 * its array by the number of its group, which all of its group share. */
#ifndef CLGS_PARTS_H
#define CLGS_PARTS_H

#include "common/form.h"

/* Work-items of a group: a number that compilers know, as each
 * work-item divides by it once per array. */
#ifndef PARTS_GROUP_SIZE
#define PARTS_GROUP_SIZE 64
#endif
#define PARTS_GROUP GROUP_OF(PARTS_GROUP_SIZE)

/* How many work-groups `items` work-items fill. */
static inline uint groups_of(const size_t items)
{
    return (uint)((items + PARTS_GROUP_SIZE - 1) / PARTS_GROUP_SIZE);
}

/* This work-item's number among those of its array, whose first work-group has number `begin`. */
static inline size_t item_of_part(const uint begin)
{
    return (get_group_id(0) - begin) * PARTS_GROUP_SIZE + get_local_id(0);
}

#endif
