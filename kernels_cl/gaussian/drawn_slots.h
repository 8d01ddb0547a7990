/* The slots of VEC visible anchors that are drawn, in the order of their Gaussians. In the GPU form
 * those of an anchor come one at a time, so that nothing of them needs memory. */
#ifndef CLGS_DRAWN_SLOTS_H
#define CLGS_DRAWN_SLOTS_H

#include "common/method.h"
#include "common/real.h"

/* Slots that come at a time, and how many of them are drawn, if any is. */
#if VEC == 1
#define SLOTS 1
#define DRAWN(slots) ((size_t)1)
#else
#define SLOTS (VEC * K_OFFSETS)
#define DRAWN(slots) ((slots)->count)
#endif

/* Slot offset[m] of the anchor in lane[m] is Gaussian number first + m, for m < count. */
typedef struct {
    size_t first;
    size_t count;
    int slots; /* that some anchor draws, one per bit, those left out included */
    uchar lane[SLOTS];
    uchar offset[SLOTS];
} DrawnSlots;

/* Which slots of the anchors from v on come next: bit j of bits[v] says whether slot j of the v-th
 * visible anchor is drawn, and first[v] is the number of its first Gaussian; Gaussians from number
 * `capacity` on are left out. */
typedef struct {
    __global const int *bits;
    __global const int *first;
    size_t v;
    size_t count;
    size_t capacity;
    int left; /* bits of slots that have not come yet: in the GPU form of the anchor, else of all */
    size_t number;
} ComingSlots;

static inline ComingSlots coming_slots(__global const int *bits, __global const int *first,
                                       const size_t v, const size_t count, const size_t capacity)
{
    ComingSlots coming = {bits, first, v, count, capacity, 0, 0};
    coming.number = v < count ? (size_t)first[v] : 0;
    for (size_t lane = 0; lane < VEC && v + lane < count; ++lane)
        coming.left |= bits[v + lane];
    return coming;
}

/* The lowest of some bits. */
static inline uchar lowest_bit(const int bits)
{
    return (uchar)(31 - (int)clz(bits & -bits));
}

/* Takes the next slots into `d`; false if none are left. */
static inline bool next_slots(ComingSlots *coming, DrawnSlots *d)
{
    if (coming->left == 0)
        return false;
    d->first = coming->number;
    d->count = 0;
#if VEC == 1
    d->lane[0] = 0;
    d->offset[0] = lowest_bit(coming->left);
    d->count = 1;
    d->slots = 1 << d->offset[0];
    coming->left &= coming->left - 1;
#else
    d->slots = coming->left;
    for (size_t lane = 0; lane < VEC && coming->v + lane < coming->count; ++lane)
        for (int left = coming->bits[coming->v + lane]; left != 0; left &= left - 1) {
            d->lane[d->count] = (uchar)lane;
            d->offset[d->count] = lowest_bit(left);
            ++d->count;
        }
    coming->left = 0;
#endif
    coming->number += d->count;
    d->count = d->first < coming->capacity ? min(d->count, coming->capacity - d->first) : 0;
    return true;
}

#endif
