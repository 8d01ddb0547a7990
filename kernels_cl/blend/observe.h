/* What tests and counters learn from the blending: builds of the very same source in which
 * OBSERVE_PARAMETERS adds arguments to the kernels and OBSERVE looks at one record over VEC pixels.
 *
 * EXPORT_DECISIONS: 256 bits per entry, bit x + 16 y of the tile: took part; was clamped to
 * ALPHA_MAX. COUNT_PAIRS: visited and blended pairs of a pixel and a record, two totals per
 * work-item. */
#ifndef CLGS_OBSERVE_H
#define CLGS_OBSERVE_H

#include "common/real.h"
#include "common/tile_size.h"

#ifdef EXPORT_DECISIONS
#define OBSERVE_PARAMETERS , __global uint *blended, __global uint *clamped
#define OBSERVE_ARGUMENTS , blended, clamped
#define OBSERVE(entry, x, y, taken, saturated)                                                     \
    export_decisions(blended, clamped, entry, x, y, taken, saturated)

static inline void export_bit(__global uint *words, int entry, int pixel)
{
    atomic_or(&words[TILE_PIXELS / 32 * (size_t)entry + (size_t)(pixel / 32)], 1u << (pixel % 32));
}

static inline void export_decisions(__global uint *blended, __global uint *clamped, int entry,
                                    int x, int y, iv taken, iv saturated)
{
    int is_taken[VEC], is_saturated[VEC];
    STORE_V(taken, 0, is_taken);
    STORE_V(saturated, 0, is_saturated);
    for (int i = 0; i < VEC; ++i) {
        const int pixel = x + i % 4 + TILE_SIZE * (y + i / 4);
        if (is_taken[i])
            export_bit(blended, entry, pixel);
        if (is_taken[i] && is_saturated[i])
            export_bit(clamped, entry, pixel);
    }
}
#elif defined(COUNT_PAIRS)
#define OBSERVE_PARAMETERS , __global ulong *pairs
#define OBSERVE_ARGUMENTS , pairs
#define OBSERVE(entry, x, y, taken, saturated) (void)(entry), count_pairs(pairs, taken)

static inline void count_pairs(__global ulong *pairs, iv taken)
{
    int is_taken[VEC];
    STORE_V(taken, 0, is_taken);
    const size_t own = 2 * get_global_id(0);
    pairs[own] += VEC;
    for (int i = 0; i < VEC; ++i)
        pairs[own + 1] += is_taken[i] ? 1 : 0;
}
#else
#define OBSERVE_PARAMETERS
#define OBSERVE_ARGUMENTS
#define OBSERVE(entry, x, y, taken, saturated) (void)(entry), (void)(taken)
#endif

#endif
