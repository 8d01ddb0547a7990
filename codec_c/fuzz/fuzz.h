/* What the fuzz targets share: numbers from the front of the input, and blocks of exact size. */
#ifndef CLGS_FUZZ_H
#define CLGS_FUZZ_H

#include <sanitizer/asan_interface.h>
#include <stdlib.h>
#include <string.h>

#include "clgs_codec.h"

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

/* A block of its exact size, so that the sanitizers see the first byte outside of it. */
static inline void *fuzz_allocate(size_t size)
{
    void *block = malloc(size);
    if (!block && size > 0)
        abort();
    return block;
}

/* A workspace of its exact size in one block that is kept: new pages for every input would take
 * most of the time. It is not freed; a target has one. */
static inline void *fuzz_workspace(size_t size)
{
    static uint8_t *block;
    static size_t capacity;
    if (size > capacity) {
        free(block);
        block = fuzz_allocate(size);
        capacity = size;
    }
    ASAN_UNPOISON_MEMORY_REGION(block, capacity);
    ASAN_POISON_MEMORY_REGION(block + size, capacity - size);
    return block;
}

static inline void fuzz_check(int holds)
{
    if (!holds)
        abort();
}

#endif
