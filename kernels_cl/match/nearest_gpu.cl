/* Descriptors of a photo, and for each the nearest one of another photo: GPU form.
 *
 * Work-item: EACH descriptors of the job, compared with EACH others at a time.
 * Work-group: a job, SIDE * SIDE work-items; the numbers that all of them need next lie in local
 *     memory, DEPTH of each descriptor.
 * Launch: a work-group per job.
 */
#include "common/form.h"
#include "match/layout.h"

#define SIDE 16
#define EACH (BLOCK_ROWS / SIDE)
#define DEPTH 32
#define TILES (BLOCK_ROWS / LANES)

/* Numbers `k` to k + DEPTH - 1 of the descriptors of TILES tiles from `tile` on. Tiles at or past
 * `end` are zero. */
static inline void load_slice(__global const uchar *bytes, const int tile, const int end,
                              const int k, __local float *slice)
{
    for (int i = (int)get_local_id(0); i < DEPTH * BLOCK_ROWS; i += SIDE * SIDE) {
        const int column = i % BLOCK_ROWS, own = tile + column / LANES;
        slice[i] =
            own < end ? (float)bytes[place_of(own, k + i / BLOCK_ROWS, column % LANES)] : 0.0f;
    }
}

/* nearest, product, second: (BLOCK_ROWS * jobs,). The number of the descriptor with the largest
 * dot product, within those that are compared; that product; the second largest product. */
GROUP_OF(SIDE *SIDE)
__kernel void match_nearest(__global const uchar *own, __global const uchar *others,
                            __global const int *jobs, const int count, __global int *nearest,
                            __global int *product, __global int *second)
{
    __local float rows[DEPTH * BLOCK_ROWS], columns[DEPTH * BLOCK_ROWS];
    __local int keys[BLOCK_ROWS][SIDE], nexts[BLOCK_ROWS][SIDE];
    const int number = (int)get_group_id(0);
    const int3 job = vload3(min(number, count - 1), jobs);
    const int x = (int)get_local_id(0) % SIDE, y = (int)get_local_id(0) / SIDE;
    int best[EACH], next[EACH];
#pragma unroll
    for (int r = 0; r < EACH; ++r)
        best[r] = next[r] = LAST_TILE;
    for (int tile = 0; tile < job.z; tile += TILES) {
        float sum[EACH][EACH];
#pragma unroll
        for (int r = 0; r < EACH; ++r)
#pragma unroll
            for (int c = 0; c < EACH; ++c)
                sum[r][c] = 0.0f;
        for (int k = 0; k < LENGTH; k += DEPTH) {
            load_slice(own, job.x, job.x + TILES, k, rows);
            load_slice(others, job.y + tile, job.y + job.z, k, columns);
            barrier(CLK_LOCAL_MEM_FENCE);
            for (int i = 0; i < DEPTH; ++i) {
#pragma unroll
                for (int r = 0; r < EACH; ++r)
#pragma unroll
                    for (int c = 0; c < EACH; ++c)
                        sum[r][c] = fma(rows[i * BLOCK_ROWS + SIDE * r + y],
                                        columns[i * BLOCK_ROWS + SIDE * c + x], sum[r][c]);
            }
            barrier(CLK_LOCAL_MEM_FENCE);
        }
        /* Column SIDE * c + x is lane x of tile c, since SIDE is LANES. */
#pragma unroll
        for (int c = 0; c < EACH; ++c) {
#pragma unroll
            for (int r = 0; r < EACH; ++r) {
                const int key = ((int)sum[r][c] << TILE_BITS) | (LAST_TILE - tile - c);
                next[r] = max(next[r], min(best[r], key));
                best[r] = max(best[r], key);
            }
        }
    }
#pragma unroll
    for (int r = 0; r < EACH; ++r) {
        keys[SIDE * r + y][x] = best[r];
        nexts[SIDE * r + y][x] = next[r];
    }
    barrier(CLK_LOCAL_MEM_FENCE);
    const int row = (int)get_local_id(0);
    if (row >= BLOCK_ROWS || number >= count)
        return;
    int winner = 0;
    for (int i = 1; i < SIDE; ++i)
        winner = keys[row][i] > keys[row][winner] ? i : winner;
    int rest = nexts[row][winner];
    for (int i = 0; i < SIDE; ++i)
        rest = i == winner ? rest : max(rest, keys[row][i]);
    store_nearest(keys[row][winner], winner, rest >> TILE_BITS, (size_t)number * BLOCK_ROWS + row,
                  nearest, product, second);
}
