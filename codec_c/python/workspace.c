#define _DEFAULT_SOURCE /* madvise */
#include "bindings.h"

#include <stdlib.h>
#ifdef __linux__
#include <sys/mman.h>
#endif

#define HUGE_PAGE ((size_t)1 << 21)
#define LARGE (2 * HUGE_PAGE)

void *workspace_new(size_t size)
{
#ifdef __linux__
    if (size >= LARGE) {
        void *memory = aligned_alloc(HUGE_PAGE, (size + HUGE_PAGE - 1) / HUGE_PAGE * HUGE_PAGE);
        if (memory)
            (void)madvise(memory, size, MADV_HUGEPAGE); /* a wish: without it pages are small */
        return memory;
    }
#endif
    return malloc(size > 0 ? size : 1);
}

void workspace_free(void *memory)
{
    free(memory);
}
