#define _DEFAULT_SOURCE /* madvise */
#include "bindings.h"

#ifdef __linux__
#include <sys/mman.h>
#endif

#define HUGE_PAGE ((uintptr_t)1 << 21)

void *workspace_new(size_t size)
{
    void *memory = PyMem_Malloc(size);
#ifdef __linux__
    uintptr_t begin = ((uintptr_t)memory + HUGE_PAGE - 1) / HUGE_PAGE * HUGE_PAGE;
    uintptr_t end = ((uintptr_t)memory + size) / HUGE_PAGE * HUGE_PAGE;
    if (memory && begin < end) /* a wish: the pages are small if there are no others */
        (void)madvise((void *)begin, end - begin, MADV_HUGEPAGE);
#endif
    return memory;
}
