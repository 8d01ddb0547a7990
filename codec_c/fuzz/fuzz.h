/* What the fuzz targets share: numbers from the front of the input, and blocks of exact size. */
#ifndef CLGS_FUZZ_H
#define CLGS_FUZZ_H

#include <stdlib.h>
#include <string.h>

#include "clgs_codec.h"

#if defined(__has_feature)
#if __has_feature(address_sanitizer)
#include <sanitizer/asan_interface.h>
#define FUZZ_CLOSE(at, size) ASAN_POISON_MEMORY_REGION(at, size)
#define FUZZ_OPEN(at, size) ASAN_UNPOISON_MEMORY_REGION(at, size)
#elif __has_feature(memory_sanitizer)
#include <sanitizer/msan_interface.h>
#define FUZZ_CLOSE(at, size) ((void)0)
#define FUZZ_OPEN(at, size) __msan_poison(at, size)
#endif
#endif
#if !defined(FUZZ_OPEN)
#define FUZZ_CLOSE(at, size) ((void)0)
#define FUZZ_OPEN(at, size) ((void)0)
#endif

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size);

typedef struct fuzz_input {
    const uint8_t *at;
    size_t size;
} fuzz_input;

/* The next `bytes` as a little-endian number; bytes past the end count as 0. */
static inline uint32_t fuzz_take(fuzz_input *input, size_t bytes)
{
    uint32_t value = 0;
    for (size_t i = 0; i < bytes && input->size > 0; i++, input->size--)
        value |= (uint32_t)*input->at++ << 8 * i;
    return value;
}

/* A count of two bytes: below `usual`, in one of 16 cases up to `most` <= 4096. Large ones take
 * longer and seldom show more. */
static inline size_t fuzz_take_count(fuzz_input *input, uint32_t usual, uint32_t most)
{
    uint32_t number = fuzz_take(input, 2);
    return number < 0xF000 ? number % usual : (number - 0xF000) % most;
}

/* Channels of a matrix: 1 to 3, or 9, of which blocks of 8 are transposed at once. */
static inline size_t fuzz_channels(uint32_t bits)
{
    return bits % 4 < 3 ? bits % 4 + 1 : 9;
}

typedef enum fuzz_slot {
    FUZZ_WORKSPACE,
    FUZZ_MODEL,
    FUZZ_VALUE,
    FUZZ_DECODED,
    FUZZ_OUTPUT,
    FUZZ_NEAR,
    FUZZ_SLOTS
} fuzz_slot;

/* A block that seems to be of its exact size and new: the sanitizers see the first byte after it,
 * and what is read before it is written. It is kept for the next input, as new pages would take
 * most of the time. It is not freed; a slot has one. */
static inline void *fuzz_block(fuzz_slot slot, size_t size)
{
    static uint8_t *block[FUZZ_SLOTS];
    static size_t capacity[FUZZ_SLOTS];
    if (size > capacity[slot] || !block[slot]) {
        free(block[slot]);
        block[slot] = malloc(size + 1);
        capacity[slot] = size + 1;
        if (!block[slot])
            abort();
    }
    FUZZ_OPEN(block[slot], capacity[slot]);
    FUZZ_CLOSE(block[slot] + size, capacity[slot] - size);
    return block[slot];
}

/* Near rows of rows without positions: any earlier ones, the same for every input. */
static inline const int32_t *fuzz_near(size_t rows)
{
    int32_t *near = (int32_t *)fuzz_block(FUZZ_NEAR, 4 * CLGS_NEAR * rows);
    for (size_t i = 0; i < rows; i++)
        for (size_t k = 0; k < CLGS_NEAR; k++)
            near[CLGS_NEAR * i + k] = i > k ? (int32_t)((i * 7919 + k * 31) % i) : -1;
    return near;
}

static inline void fuzz_check(int holds)
{
    if (!holds)
        abort();
}

#endif
