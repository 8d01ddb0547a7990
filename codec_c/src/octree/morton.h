/* Morton codes: the bits of x, y and z interleaved, x highest. */
#ifndef CLGS_OCTREE_MORTON_H
#define CLGS_OCTREE_MORTON_H

#include <stdint.h>

/* Bit b of `value` (21 bits) to bit 3b. */
static inline uint64_t clgs_spread(uint64_t value)
{
    value &= 0x1FFFFF;
    value = (value | value << 32) & 0x001F00000000FFFF;
    value = (value | value << 16) & 0x001F0000FF0000FF;
    value = (value | value << 8) & 0x100F00F00F00F00F;
    value = (value | value << 4) & 0x10C30C30C30C30C3;
    return (value | value << 2) & 0x1249249249249249;
}

/* The inverse of clgs_spread; other bits are ignored. */
static inline uint32_t clgs_gather(uint64_t value)
{
    value &= 0x1249249249249249;
    value = (value | value >> 2) & 0x10C30C30C30C30C3;
    value = (value | value >> 4) & 0x100F00F00F00F00F;
    value = (value | value >> 8) & 0x001F0000FF0000FF;
    value = (value | value >> 16) & 0x001F00000000FFFF;
    return (uint32_t)((value | value >> 32) & 0x1FFFFF);
}

#endif
