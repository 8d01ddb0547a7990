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

/* The tile numbers of `tile` as floats. */
static inline fv tile_numbers(__global const uchar *bytes, const size_t tile, const size_t k)
{
    return TO_FV(TO_IV(CLGS_CAT(vload, VEC)(tile * LENGTH + k, bytes)));
}

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
        float rows[LENGTH][ROWS];
        for (int k = 0; k < LENGTH; ++k)
            for (int r = 0; r < ROWS; ++r)
                rows[k][r] = (float)
                    own[((size_t)(job.x + first / LANES) * LENGTH + k) * LANES + first % LANES + r];
        iv best[ROWS], next[ROWS];
        for (int r = 0; r < ROWS; ++r)
            best[r] = next[r] = (iv)(LAST_TILE);
        for (int tile = 0; tile < job.z; tile += TILES_AT_ONCE) {
            fv sum[ROWS][TILES_AT_ONCE];
#pragma unroll
            for (int r = 0; r < ROWS; ++r)
#pragma unroll
                for (int c = 0; c < TILES_AT_ONCE; ++c)
                    sum[r][c] = (fv)(0.0f);
            for (int k = 0; k < LENGTH; ++k) {
                fv other[TILES_AT_ONCE];
#pragma unroll
                for (int c = 0; c < TILES_AT_ONCE; ++c)
                    other[c] = tile_numbers(others, (size_t)(job.y + tile + c), (size_t)k);
#pragma unroll
                for (int r = 0; r < ROWS; ++r)
#pragma unroll
                    for (int c = 0; c < TILES_AT_ONCE; ++c)
                        sum[r][c] = fma(other[c], (fv)(rows[k][r]), sum[r][c]);
            }
#pragma unroll
            for (int c = 0; c < TILES_AT_ONCE; ++c) {
#pragma unroll
                for (int r = 0; r < ROWS; ++r) {
                    const iv key = (TO_IV(sum[r][c]) << TILE_BITS) | (iv)(LAST_TILE - tile - c);
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
