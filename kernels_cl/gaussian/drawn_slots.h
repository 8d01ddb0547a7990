/* The slots of VEC visible anchors that are drawn, in the order of their Gaussians. */
#ifndef CLGS_DRAWN_SLOTS_H
#define CLGS_DRAWN_SLOTS_H

#include "common/method.h"
#include "common/real.h"

/* Slots of VEC anchors. */
#define SLOTS (VEC * K_OFFSETS)

/* Slot offset[m] of the anchor in lane[m] is Gaussian number first + m, for m < count. */
typedef struct {
    size_t first;
    size_t count;
    int slots; /* that some anchor draws, one per bit, those left out included */
    uchar lane[SLOTS];
    uchar offset[SLOTS];
} DrawnSlots;

/* Of the anchors from v on. Bit j of bits[v] says whether slot j of the v-th visible anchor is
 * drawn, and first[v] is the number of its first Gaussian; Gaussians from number `capacity` on are
 * left out. */
static inline DrawnSlots list_drawn_slots(__global const int *bits, __global const int *first,
                                          const size_t v, const size_t count, const size_t capacity)
{
    DrawnSlots d;
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
