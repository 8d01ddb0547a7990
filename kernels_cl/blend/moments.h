/* What the backward pass keeps of an entry of a tile list: nine sums over the pixels of the tile,
 * with v = alpha dL/d(alpha) and w = alpha T. An entry has one row of them. */
#ifndef CLGS_MOMENTS_H
#define CLGS_MOMENTS_H

#include "common/real.h"

#ifndef ROW_SIZE
#define ROW_SIZE 16 /* floats of a row */
#endif
#ifndef SUM_SIZE
#define SUM_SIZE 9 /* in the order of Moments */
#endif

typedef struct {
    fv y1, y2;           /* v y1, v y2 */
    fv y11, y12, y22;    /* v y1^2, v y1 y2, v y2^2 */
    fv red, green, blue; /* w dL/d(red of the image), ... */
    fv alpha;            /* v */
} Moments;

#endif
