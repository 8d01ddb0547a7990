/* Bring the cache line at an address nearer before it is read or written: for scattered addresses,
 * and for more rows side by side than a CPU's own prefetchers follow. GPUs hide these waits by
 * running other work-items. The address may be any, even past the end of an array. OpenCL's own
 * prefetch() does nothing in PoCL, and the simulator Oclgrind, which compiles to SPIR, does not
 * know what the compiler's builtin turns into. */
#ifndef CLGS_PREFETCH_H
#define CLGS_PREFETCH_H

#include "common/real.h"

#if VEC > 1 && defined(__has_builtin) && !defined(__SPIR__)
#if __has_builtin(__builtin_prefetch)
#define PREFETCH(pointer) __builtin_prefetch(pointer)
#define PREFETCH_WRITE(pointer) __builtin_prefetch(pointer, 1)
#endif
#endif
#ifndef PREFETCH
#define PREFETCH(pointer) ((void)(pointer))
#define PREFETCH_WRITE(pointer) ((void)(pointer))
#endif

#define LINE 16 /* floats of a cache line */

#endif
