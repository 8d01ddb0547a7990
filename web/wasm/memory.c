#include "memory.h"

#include <stdint.h>
#include <string.h>

#define ALIGNMENT 64

static size_t used;

#ifdef __wasm__

#define PAGE 65536

extern uint8_t __heap_base;

static uint8_t *first_byte(void)
{
    return (uint8_t *)(((uintptr_t)&__heap_base + ALIGNMENT - 1) / ALIGNMENT * ALIGNMENT);
}

/* Whether there are `size` bytes from the first one on; the memory grows to have them. */
static int reach(size_t size)
{
    size_t end = (size_t)(uintptr_t)first_byte() + size;
    size_t there = __builtin_wasm_memory_size(0);
    size_t pages = end / PAGE + 1;
    if (end < size)
        return 0;
    return pages <= there || __builtin_wasm_memory_grow(0, pages - there) != SIZE_MAX;
}

void *memcpy(void *to, const void *from, size_t size)
{
    return __builtin_memcpy(to, from, size); /* one instruction: -mbulk-memory */
}

void *memmove(void *to, const void *from, size_t size)
{
    return __builtin_memmove(to, from, size);
}

void *memset(void *to, int value, size_t size)
{
    return __builtin_memset(to, value, size);
}

#else /* in tests, where the system gives pages only as they are touched */

#include <stdlib.h>

#define LIMIT ((size_t)1 << 32)

static uint8_t *first_byte(void)
{
    static uint8_t *block;
    if (!block)
        block = aligned_alloc(ALIGNMENT, LIMIT);
    return block;
}

static int reach(size_t size)
{
    return first_byte() && size <= LIMIT;
}

#endif

void *memory_take(size_t size)
{
    size_t begin = used;
    if (size > SIZE_MAX / 2 || !reach(begin + size + ALIGNMENT))
        return NULL;
    used = begin + (size + ALIGNMENT - 1) / ALIGNMENT * ALIGNMENT;
    return first_byte() + begin;
}

size_t memory_mark(void)
{
    return used;
}

void memory_release(size_t mark)
{
    used = mark;
}
