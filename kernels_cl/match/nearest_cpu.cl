/* Descriptors of a photo, and for each the nearest one of another photo: CPU form.
 *
 * Work-item: a job, ROWS descriptors at a time; lanes are the descriptors that they are compared
 *     with, TILES_AT_ONCE tiles of them at once.
 * Work-group: any; no local memory.
 * Launch: a work-item per job.
 */
#include "common/real.h"
#include "match/layout.h"

#ifndef ROWS
#define ROWS 8
#endif
#ifndef TILES_AT_ONCE
#define TILES_AT_ONCE 2
#endif

/* AVX2 has an instruction that adds the products of two pairs of shorts, at twice the rate of
 * floats. Registers of AVX-512 hold as many floats. */
#if defined(__AVX2__) && !defined(__AVX512F__) && TILES_AT_ONCE == 1 && defined(__has_builtin)
#if __has_builtin(__builtin_ia32_pmaddwd256)
#define PAIRS (LENGTH / 2)
#endif
#endif

#ifdef PAIRS
typedef int row_numbers[PAIRS][ROWS];
typedef short shorts __attribute__((__vector_size__(32)));

static inline int8 pair_products(const short16 a, const short16 b)
{
    return __builtin_astype(
        __builtin_ia32_pmaddwd256(__builtin_astype(a, shorts), __builtin_astype(b, shorts)), int8);
}

static inline void load_rows(__global const uchar *own, const int tile, const int lane,
                             row_numbers rows)
{
    for (int k = 0; k < PAIRS; ++k)
        for (int r = 0; r < ROWS; ++r)
            rows[k][r] = own[place_of(tile, 2 * k, lane + r)] |
                         own[place_of(tile, 2 * k + 1, lane + r)] << 16;
}

static inline void multiply(row_numbers rows, __global const uchar *others, const int tile,
                            iv products[ROWS][TILES_AT_ONCE])
{
    int8 sum[ROWS][2];
#pragma unroll
    for (int r = 0; r < ROWS; ++r)
        sum[r][0] = sum[r][1] = (int8)(0);
    for (int k = 0; k < PAIRS; ++k) {
        const size_t place = ((size_t)tile * PAIRS + k) * 2;
        const short16 first = convert_short16(vload16(place, others));
        const short16 second = convert_short16(vload16(place + 1, others));
#pragma unroll
        for (int r = 0; r < ROWS; ++r) {
            const short16 row = as_short16((int8)(rows[k][r]));
            sum[r][0] += pair_products(first, row);
            sum[r][1] += pair_products(second, row);
        }
    }
#pragma unroll
    for (int r = 0; r < ROWS; ++r)
        products[r][0] = (int16)(sum[r][0], sum[r][1]);
}
#else
typedef float row_numbers[LENGTH][ROWS];

static inline void load_rows(__global const uchar *own, const int tile, const int lane,
                             row_numbers rows)
{
    for (int k = 0; k < LENGTH; ++k)
        for (int r = 0; r < ROWS; ++r)
            rows[k][r] = (float)own[place_of(tile, k, lane + r)];
}

static inline void multiply(row_numbers rows, __global const uchar *others, const int tile,
                            iv products[ROWS][TILES_AT_ONCE])
{
    __global const ushort *numbers = (__global const ushort *)others;
    fv sum[ROWS][TILES_AT_ONCE];
#pragma unroll
    for (int r = 0; r < ROWS; ++r)
#pragma unroll
        for (int c = 0; c < TILES_AT_ONCE; ++c)
            sum[r][c] = (fv)(0.0f);
    for (int k = 0; k < LENGTH; k += 2) {
        iv pair[TILES_AT_ONCE];
#pragma unroll
        for (int c = 0; c < TILES_AT_ONCE; ++c)
            pair[c] = TO_IV(CLGS_CAT(vload, VEC)(((size_t)(tile + c) * LENGTH + k) / 2, numbers));
#pragma unroll
        for (int r = 0; r < ROWS; ++r)
#pragma unroll
            for (int c = 0; c < TILES_AT_ONCE; ++c) {
                sum[r][c] = fma(TO_FV(pair[c] & 255), (fv)(rows[k][r]), sum[r][c]);
                sum[r][c] = fma(TO_FV(pair[c] >> 8), (fv)(rows[k + 1][r]), sum[r][c]);
            }
    }
#pragma unroll
    for (int r = 0; r < ROWS; ++r)
#pragma unroll
        for (int c = 0; c < TILES_AT_ONCE; ++c)
            products[r][c] = TO_IV(sum[r][c]);
}
#endif

/* nearest, product, second: (BLOCK_ROWS * jobs,). The number of the descriptor with the largest
 * dot product, within those that are compared; that product; the second largest product. */
__kernel void match_nearest(__global const uchar *own, __global const uchar *others,
                            __global const int *jobs, const int count, __global int *nearest,
                            __global int *product, __global int *second)
{
    const int number = (int)get_global_id(0);
    if (number >= count)
        return;
    const int3 job = vload3(number, jobs);
    for (int first = 0; first < BLOCK_ROWS; first += ROWS) {
        row_numbers rows;
        load_rows(own, job.x + first / LANES, first % LANES, rows);
        iv best[ROWS], next[ROWS];
        for (int r = 0; r < ROWS; ++r)
            best[r] = next[r] = (iv)(LAST_TILE);
        for (int tile = 0; tile < job.z; tile += TILES_AT_ONCE) {
            iv products[ROWS][TILES_AT_ONCE];
            multiply(rows, others, job.y + tile, products);
#pragma unroll
            for (int c = 0; c < TILES_AT_ONCE; ++c) {
#pragma unroll
                for (int r = 0; r < ROWS; ++r) {
                    const iv key = (products[r][c] << TILE_BITS) | (iv)(LAST_TILE - tile - c);
                    next[r] = max(next[r], min(best[r], key));
                    best[r] = max(best[r], key);
                }
            }
        }
        for (int r = 0; r < ROWS; ++r) {
            int keys[VEC], nexts[VEC];
            STORE_V(best[r], 0, keys);
            STORE_V(next[r], 0, nexts);
            int lane = 0;
            for (int i = 1; i < VEC; ++i)
                lane = keys[i] > keys[lane] ? i : lane;
            int rest = nexts[lane];
            for (int i = 0; i < VEC; ++i)
                rest = i == lane ? rest : max(rest, keys[i]);
            store_nearest(keys[lane], lane, rest >> TILE_BITS,
                          (size_t)number * BLOCK_ROWS + first + r, nearest, product, second);
        }
    }
}
