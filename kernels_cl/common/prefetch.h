/* Bring the cache line at an address nearer before it is read or written: for scattered addresses,
 * and for more rows side by side than a CPU's own prefetchers follow. GPUs hide these waits by
 * running other work-items. The address may be any, even past the end of an array. OpenCL's own
 * prefetch() does nothing in PoCL. The compiler's builtin ends the process in Mesa's drivers and in
 * Oclgrind: USE_PREFETCH is 1 only on drivers that are known to compile it. */
#ifndef CLGS_PREFETCH_H
#define CLGS_PREFETCH_H

#include "common/real.h"

#ifndef USE_PREFETCH
#define USE_PREFETCH 0
#endif

#if USE_PREFETCH && VEC > 1 && defined(__has_builtin)
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
