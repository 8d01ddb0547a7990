/* Large helper functions: static inline OWN_FUNCTION void name(...).
 *
 * PoCL compiles a program first, and then each of its kernels, with all that it calls inlined. If
 * large functions are inlined in the first step already, each caller has its copy unrolled and
 * optimised twice: builds take 1.4 times as long, and the kernels are no faster. */
#ifndef CLGS_OWN_FUNCTION_H
#define CLGS_OWN_FUNCTION_H

#include "common/form.h"

#if USE_LOCAL
#define OWN_FUNCTION
#else
#define OWN_FUNCTION __attribute__((noinline))
#endif

#endif
