/* Four numbers of each of VEC rows, one row per lane, written together: a CPU sorts them in
 * registers and moves 16 bytes at once. */
#ifndef CLGS_TRANSPOSE_H
#define CLGS_TRANSPOSE_H

#include "common/real.h"

/* Lanes in groups of four: from each group of a and b the first two lanes in turn, the last two in
 * turn, the first pair of each, the last pair of each. */
#if VEC == 16
#define FIRST_IN_TURN(a, b)                                                                        \
    (fv)((a).s0, (b).s0, (a).s1, (b).s1, (a).s4, (b).s4, (a).s5, (b).s5, (a).s8, (b).s8, (a).s9,   \
         (b).s9, (a).sc, (b).sc, (a).sd, (b).sd)
#define LAST_IN_TURN(a, b)                                                                         \
    (fv)((a).s2, (b).s2, (a).s3, (b).s3, (a).s6, (b).s6, (a).s7, (b).s7, (a).sa, (b).sa, (a).sb,   \
         (b).sb, (a).se, (b).se, (a).sf, (b).sf)
#define FIRST_PAIRS(a, b)                                                                          \
    (fv)((a).s01, (b).s01, (a).s45, (b).s45, (a).s89, (b).s89, (a).scd, (b).scd)
#define LAST_PAIRS(a, b)                                                                           \
    (fv)((a).s23, (b).s23, (a).s67, (b).s67, (a).sab, (b).sab, (a).sef, (b).sef)
#elif VEC == 8
#define FIRST_IN_TURN(a, b) (fv)((a).s0, (b).s0, (a).s1, (b).s1, (a).s4, (b).s4, (a).s5, (b).s5)
#define LAST_IN_TURN(a, b) (fv)((a).s2, (b).s2, (a).s3, (b).s3, (a).s6, (b).s6, (a).s7, (b).s7)
#define FIRST_PAIRS(a, b) (fv)((a).s01, (b).s01, (a).s45, (b).s45)
#define LAST_PAIRS(a, b) (fv)((a).s23, (b).s23, (a).s67, (b).s67)
#elif VEC == 4
#define FIRST_IN_TURN(a, b) (fv)((a).s0, (b).s0, (a).s1, (b).s1)
#define LAST_IN_TURN(a, b) (fv)((a).s2, (b).s2, (a).s3, (b).s3)
#define FIRST_PAIRS(a, b) (fv)((a).s01, (b).s01)
#define LAST_PAIRS(a, b) (fv)((a).s23, (b).s23)
#endif

#if VEC == 1
static inline void scatter_4(const fv numbers[4], __global float *const *rows, const size_t k)
{
    for (size_t i = 0; i < 4 && rows[0]; ++i)
        rows[0][k + i] = numbers[i];
}
#else
/* Number i of row 4 g + j, which is lane 4 g + i of v[j], becomes lane 4 g + j of v[i]. */
static inline void transpose_groups(fv v[4])
{
    const fv a = FIRST_IN_TURN(v[0], v[1]), b = FIRST_IN_TURN(v[2], v[3]);
    const fv c = LAST_IN_TURN(v[0], v[1]), d = LAST_IN_TURN(v[2], v[3]);
    v[0] = FIRST_PAIRS(a, b);
    v[1] = LAST_PAIRS(a, b);
    v[2] = FIRST_PAIRS(c, d);
    v[3] = LAST_PAIRS(c, d);
}

/* Number k + i of each row becomes numbers[i]; a row that is 0 is left out. */
static inline void scatter_4(const fv numbers[4], __global float *const *rows, const size_t k)
{
    fv groups[4] = {numbers[0], numbers[1], numbers[2], numbers[3]};
    transpose_groups(groups);
#pragma unroll
    for (size_t j = 0; j < 4; ++j) {
        const float4 *each = (const float4 *)&groups[j];
#pragma unroll
        for (size_t group = 0; group < VEC / 4; ++group)
            if (rows[4 * group + j])
                vstore4(each[group], 0, rows[4 * group + j] + k);
    }
}
#endif

#endif
