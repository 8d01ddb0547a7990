/* Which slots of the visible anchors have a positive opacity: the Gaussians that neural.cl makes. A
 * program of its own, since Intel's compiler for Ponte Vecchio crashes on one with both.
 *
 * Work-item: VEC visible anchors, counted from the middle of the view on.
 * Work-group: see scan/part_sums.h.
 * Launch: a work-item per VEC visible anchors.
 */
#include "common/items.h"
#include "common/method.h"
#include "common/real.h"
#include "scan/part_sums.h"

/* Which opacities of each visible anchor are positive, one per bit, and how many. NaN is not
 * positive. */
PART_GROUP __kernel void neural_count(__global const float *output, __global const int *visible,
                                      const int count, const int padded, __global int *drawn,
                                      __global int *counts, __global long *sums)
{
    DECLARE_PART_SCRATCH(scratch);
    const size_t v = item_from_middle() * VEC;
    iv bits = (iv)(0);
    for (int j = 0; v < (size_t)count && j < K_OFFSETS; ++j) {
        const fv opacity = LOAD_V(0, output + (size_t)j * (size_t)padded + v);
        bits |= opacity > (fv)(0.0f) ? (iv)(1 << j) : (iv)(0);
    }
    int lanes[VEC], sum = 0;
    STORE_V(bits, 0, lanes);
    for (size_t lane = 0; lane < VEC && v + lane < (size_t)count; ++lane) {
        const int positive = visible[v + lane] >= 0 ? lanes[lane] : 0;
        drawn[v + lane] = positive;
        counts[v + lane] = popcount(positive);
        sum += popcount(positive);
    }
    write_part_sum(scratch, v, count, sum, sums);
}
