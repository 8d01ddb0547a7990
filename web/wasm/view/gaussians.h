/* Gaussians as the page draws them, and their order from far to near. */
#ifndef CLGS_WEB_GAUSSIANS_H
#define CLGS_WEB_GAUSSIANS_H

#include "container.h"

#define LOG_SCALE_LIMIT 20.0f /* log scales are clamped to +- this */

enum {
    RECORD = 12, /* words: mean x y z, opacity; covariance xx xy xz yy yz zz; red and green as two
                    half floats; blue */
};

typedef struct gaussian {
    float mean[3], opacity, scale[3], rotation[4], color[3];
} gaussian;

typedef struct gaussians {
    size_t capacity, count;
    uint32_t *record; /* (capacity, RECORD) */
    size_t sorted;    /* how many means there are to sort: those of the last complete set */
    float *mean;      /* (capacity, 3) */
    uint32_t *order, *spare, *key, *spare_key;
} gaussians;

/* Room for `capacity` Gaussians. */
problem gaussians_open(size_t capacity, gaussians *result);

/* Add one; `rotation` need not be a unit quaternion. One without a direction is left out. */
void gaussians_add(gaussians *all, const gaussian *one);

/* The set is complete: keep its means, to sort them while the next one is made. */
void gaussians_finish(gaussians *all);

/* Sort by depth, farthest first, into `order`; depth = row . (x, y, z, 1), `near` the least.
 *
 * Returns the number of those that are deep enough. */
size_t gaussians_sort(gaussians *all, const float row[4], float near);

/* Unit vector from `from` to `to`, zero if they are the same. */
void direction_to(const float from[3], const float to[3], float direction[3]);

#endif
