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

/* AVX-512 (with BW) and AVX2 have an instruction that adds the products of two pairs of shorts. */
#ifdef __has_builtin
#if TILES_AT_ONCE == 2 && defined(__AVX512BW__) && __has_builtin(__builtin_ia32_pmaddwd512)
#define REGISTERS 1
#define TILE_OF(sums) (sums)[0]
#define PAIR_PRODUCTS __builtin_ia32_pmaddwd512
#elif TILES_AT_ONCE == 1 && defined(__AVX2__) && __has_builtin(__builtin_ia32_pmaddwd256)
#define REGISTERS 2
#define TILE_OF(sums) (iv)((sums)[0], (sums)[1])
#define PAIR_PRODUCTS __builtin_ia32_pmaddwd256
#endif
#endif

#ifdef PAIR_PRODUCTS
/* Pairs of numbers of a descriptor, and shorts of each of the REGISTERS that hold one pair of all
 * descriptors of a tile. */
#define PAIRS (LENGTH / 2)
#define SHORTS (2 * LANES / REGISTERS)
typedef int row_numbers[PAIRS][ROWS];
typedef short shorts __attribute__((__vector_size__(2 * SHORTS)));
typedef int ints __attribute__((__ext_vector_type__(SHORTS / 2)));
typedef uchar bytes __attribute__((__vector_size__(SHORTS), __aligned__(1)));

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
    ints sum[ROWS][TILES_AT_ONCE][REGISTERS];
#pragma unroll
    for (int r = 0; r < ROWS; ++r)
#pragma unroll
        for (int c = 0; c < TILES_AT_ONCE; ++c)
#pragma unroll
            for (int part = 0; part < REGISTERS; ++part)
                sum[r][c][part] = (ints)(0);
    for (int k = 0; k < PAIRS; ++k)
#pragma unroll
        for (int c = 0; c < TILES_AT_ONCE; ++c)
#pragma unroll
            for (int part = 0; part < REGISTERS; ++part) {
                const size_t place = ((size_t)(tile + c) * PAIRS + k) * REGISTERS + part;
                const shorts numbers = __builtin_convertvector(
                    *(__global const bytes *)(others + place * SHORTS), shorts);
#pragma unroll
                for (int r = 0; r < ROWS; ++r)
                    sum[r][c][part] += __builtin_astype(
                        PAIR_PRODUCTS(numbers, __builtin_astype((ints)(rows[k][r]), shorts)), ints);
            }
#pragma unroll
    for (int r = 0; r < ROWS; ++r)
#pragma unroll
        for (int c = 0; c < TILES_AT_ONCE; ++c)
            products[r][c] = TILE_OF(sum[r][c]);
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
