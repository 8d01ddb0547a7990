/* Packed arrays (N, width) by lanes: VEC rows at once, column k of them in lane vector k. */
#ifndef CLGS_ROWS_H
#define CLGS_ROWS_H

#include "common/real.h"

/* load_rowsW: rows `first` and on of `values`; only `used` of them are read, at least one, and the
 * other lanes are zero. store_rowsW is its mirror. Private arrays with constant indices: compilers
 * make shuffles of them. */
#define DEFINE_ROWS(WIDTH)                                                                         \
    inline void CLGS_CAT(load_rows, WIDTH)(__global const float *values, const size_t first,       \
                                           const size_t used, fv columns[WIDTH])                   \
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
    }                                                                                              \
    inline void CLGS_CAT(store_rows, WIDTH)(const fv columns[WIDTH], __global float *values,       \
                                            const size_t first, const size_t used)                 \
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

DEFINE_ROWS(1)
DEFINE_ROWS(2)
DEFINE_ROWS(3)
DEFINE_ROWS(4)
DEFINE_ROWS(16)

#endif
