/* Packed arrays (N, width) by lanes: VEC rows at once, column k of them in lane vector k. */
#ifndef CLGS_ROWS_H
#define CLGS_ROWS_H

#include "common/own_function.h"
#include "common/real.h"

/* Compilers make shuffles of private arrays with constant indices, as these functions have them.
 * The first reads rows `first` to `first + used - 1` of `values`, used > 0; the other lanes are
 * zero. */
#define DEFINE_LOAD_ROWS(name, WIDTH)                                                              \
    static inline OWN_FUNCTION void name(__global const float *values, const size_t first,         \
                                         const size_t used, fv columns[WIDTH])                     \
    {                                                                                              \
        float rows[WIDTH * VEC];                                                                   \
        values += WIDTH * first;                                                                   \
        if (used < VEC) {                                                                          \
            float part[WIDTH * VEC];                                                               \
            for (size_t i = 0; i < WIDTH * VEC; ++i)                                               \
                part[i] = i < WIDTH * used ? values[i] : 0.0f;                                     \
            _Pragma("unroll") for (size_t k = 0; k < WIDTH; ++k)                                   \
                STORE_V(LOAD_V(k, part), k, rows);                                                 \
        } else {                                                                                   \
            _Pragma("unroll") for (size_t k = 0; k < WIDTH; ++k)                                   \
                STORE_V(LOAD_V(k, values), k, rows);                                               \
        }                                                                                          \
        _Pragma("unroll") for (size_t k = 0; k < WIDTH; ++k)                                       \
        {                                                                                          \
            float lanes[VEC];                                                                      \
            _Pragma("unroll") for (size_t lane = 0; lane < VEC; ++lane) lanes[lane] =              \
                rows[WIDTH * lane + k];                                                            \
            columns[k] = LOAD_V(0, lanes);                                                         \
        }                                                                                          \
    }

/* The mirror of DEFINE_LOAD_ROWS. */
#define DEFINE_STORE_ROWS(name, WIDTH)                                                             \
    static inline OWN_FUNCTION void name(const fv columns[WIDTH], __global float *values,          \
                                         const size_t first, const size_t used)                    \
    {                                                                                              \
        float rows[WIDTH * VEC];                                                                   \
        values += WIDTH * first;                                                                   \
        _Pragma("unroll") for (size_t k = 0; k < WIDTH; ++k)                                       \
        {                                                                                          \
            float lanes[VEC];                                                                      \
            STORE_V(columns[k], 0, lanes);                                                         \
            _Pragma("unroll") for (size_t lane = 0; lane < VEC; ++lane) rows[WIDTH * lane + k] =   \
                lanes[lane];                                                                       \
        }                                                                                          \
        if (used < VEC) {                                                                          \
            float part[WIDTH * VEC];                                                               \
            _Pragma("unroll") for (size_t k = 0; k < WIDTH; ++k)                                   \
                STORE_V(LOAD_V(k, rows), k, part);                                                 \
            for (size_t i = 0; i < WIDTH * used; ++i)                                              \
                values[i] = part[i];                                                               \
        } else {                                                                                   \
            _Pragma("unroll") for (size_t k = 0; k < WIDTH; ++k)                                   \
                STORE_V(LOAD_V(k, rows), k, values);                                               \
        }                                                                                          \
    }

DEFINE_LOAD_ROWS(load_rows1, 1)
DEFINE_LOAD_ROWS(load_rows2, 2)
DEFINE_LOAD_ROWS(load_rows3, 3)
DEFINE_LOAD_ROWS(load_rows4, 4)
DEFINE_STORE_ROWS(store_rows1, 1)
DEFINE_STORE_ROWS(store_rows2, 2)
DEFINE_STORE_ROWS(store_rows3, 3)
DEFINE_STORE_ROWS(store_rows4, 4)

#endif
