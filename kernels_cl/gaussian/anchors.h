/* VEC visible anchors, one a lane, and the MLPs' outputs for them. */
#ifndef CLGS_ANCHORS_H
#define CLGS_ANCHORS_H

#include "common/prefetch.h"
#include "common/real.h"

#ifndef K_OFFSETS
#define K_OFFSETS 10
#endif

/* Rows of the output: K opacities, 3 K colors, 7 K covariance numbers. */
#define COLOR_ROW K_OFFSETS
#define COVARIANCE_ROW (4 * K_OFFSETS)
#define OUTPUT_ROWS (11 * K_OFFSETS)

/* Row number i of a slot: opacity, color, covariance. */
#define SLOT_ROWS 11
static inline size_t slot_row(const size_t j, const size_t i)
{
    return i == 0 ? j : i < 4 ? COLOR_ROW + 3 * j + i - 1 : COVARIANCE_ROW + 7 * j + i - 4;
}

/* Slots of VEC anchors. */
#define SLOTS (VEC * K_OFFSETS)

/* Rows of the output from `first_row` on, where a head starts, VEC columns from v on, as a pointer
 * and a stride. On a CPU the rows of the given slots are copied, all at once: so many are more than
 * its prefetchers follow, and the misses overlap. */
#if VEC == 1
#define ROWS __global const float
#define STAGE(name, output, stride, v, slots, first_row)                                           \
    ROWS *name = (output) + (first_row) * (stride) + (v);                                          \
    const size_t name##_stride = stride
#else
#define ROWS __private const float
#define STAGE(name, output, stride, v, slots, first_row)                                           \
    float name##_copy[OUTPUT_ROWS * VEC];                                                          \
    copy_slots((output) + (v), stride, slots, first_row, name##_copy);                             \
    ROWS *name = name##_copy + (first_row) * VEC;                                                  \
    const size_t name##_stride = VEC
#endif

static inline void copy_slots(__global const float *output, const size_t stride, const int slots,
                              const size_t first_row, float *copy)
{
    for (size_t j = 0; j < K_OFFSETS; ++j) {
        for (size_t i = 0; (slots >> j & 1) && i < SLOT_ROWS; ++i) {
            const size_t row = slot_row(j, i);
            if (row < first_row)
                continue;
            PREFETCH(output + row * stride + LINE);
            STORE_V(LOAD_V(0, output + row * stride), row, copy);
        }
    }
}

/* Lanes without an anchor draw nothing. */
typedef struct {
    int anchor[VEC]; /* its index, -1: none */
    float log_scale[6][VEC];
} Anchors;

static inline Anchors load_anchors(__global const int *visible, __global const float *scaling,
                                   const size_t v, const size_t count)
{
    Anchors a;
    for (size_t lane = 0; lane < VEC; ++lane) {
        a.anchor[lane] = v + lane < count ? visible[v + lane] : -1;
        const bool exists = a.anchor[lane] >= 0;
        for (size_t i = 0; i < 6; ++i)
            a.log_scale[i][lane] = exists ? scaling[6 * (size_t)a.anchor[lane] + i] : 0.0f;
    }
    return a;
}

/* The slots of VEC anchors that are drawn, in the order of their Gaussians, which follow each other
 * from number `first` on. */
typedef struct {
    size_t first;
    size_t count;
    int slots; /* that some anchor draws, also beyond the capacity */
    uchar lane[SLOTS];
    uchar offset[SLOTS];
} Drawn;

/* `bits`: bit j of bits[v] says whether slot j of the v-th visible anchor is drawn; Gaussians from
 * number `capacity` on are left out. */
static inline Drawn list_drawn(__global const int *bits, __global const int *first, const size_t v,
                               const size_t count, const size_t capacity)
{
    Drawn d;
    d.first = v < count ? (size_t)first[v] : 0;
    d.count = 0;
    d.slots = 0;
    for (size_t lane = 0; lane < VEC && v + lane < count; ++lane) {
        d.slots |= bits[v + lane];
        for (int left = bits[v + lane]; left != 0; left &= left - 1) {
            d.lane[d.count] = (uchar)lane;
            d.offset[d.count] = (uchar)(31 - (int)clz(left & -left)); /* the lowest bit set */
            ++d.count;
        }
    }
    d.count = d.first < capacity ? min(d.count, capacity - d.first) : 0;
    return d;
}

#endif
