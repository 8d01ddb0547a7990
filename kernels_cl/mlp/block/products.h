/* The sums of a tile of the weight gradient over the vectors of a batch: CPU form. Vectors go round
 * the parts of the tree in which lanes are summed, see common/lanes.h. */
#ifndef CLGS_MLP_BLOCK_PRODUCTS_H
#define CLGS_MLP_BLOCK_PRODUCTS_H

#include "common/lanes.h"
#include "common/own_function.h"
#include "common/real.h"
#include "mlp/batch.h"
#include "mlp/block/runs.h"
#include "mlp/weight_tile.h"

/* sum[o][c] += row o times column c, over every SUM_PARTS-th vector of [begin, end). A function
 * of its own, and sums of its own, because only then a CPU's compiler keeps all of them in
 * registers. */
static inline OWN_FUNCTION void add_products(__global const float *rows,
                                             __global const float *columns[COLUMNS],
                                             const size_t begin, const size_t end,
                                             fv sum[WEIGHT_ROWS][COLUMNS])
{
    fv own[WEIGHT_ROWS][COLUMNS];
#pragma unroll
    for (int o = 0; o < WEIGHT_ROWS; ++o)
#pragma unroll
        for (int c = 0; c < COLUMNS; ++c)
            own[o][c] = sum[o][c];
    for (size_t v = begin; v < end; v += SUM_PARTS) {
        fv lanes[COLUMNS];
#pragma unroll
        for (int c = 0; c < COLUMNS; ++c)
            lanes[c] = LOAD_ALIGNED(v, columns[c]);
#pragma unroll
        for (int o = 0; o < WEIGHT_ROWS; ++o) {
            const fv row = LOAD_ALIGNED(v, rows + o * BATCH_STRIDE);
#pragma unroll
            for (int c = 0; c < COLUMNS; ++c)
                own[o][c] = fma(row, lanes[c], own[o][c]);
        }
    }
#pragma unroll
    for (int o = 0; o < WEIGHT_ROWS; ++o)
#pragma unroll
        for (int c = 0; c < COLUMNS; ++c)
            sum[o][c] = own[o][c];
}

/* sums[c * WEIGHT_ROWS + o] = row o times column c, over every SUM_PARTS-th vector of the runs.
 */
static inline void dot_products(__global const float *rows, __global const float *columns[COLUMNS],
                                const Runs *runs, float sums[SUMS])
{
    fv part[SUM_PARTS][WEIGHT_ROWS][COLUMNS] = {{{(fv)(0.0f)}}};
    for (int i = 0; i < SUM_PARTS; ++i)
        for (int run = 0; run < runs->count; ++run) {
            const int first = runs->begin[run] + ((i - runs->begin[run]) & (SUM_PARTS - 1));
            add_products(rows, columns, (size_t)first, (size_t)runs->end[run], part[i]);
        }
    for (int reach = SUM_PARTS / 2; reach > 0; reach /= 2)
        for (int i = 0; i < reach; ++i)
            for (int o = 0; o < WEIGHT_ROWS; ++o)
                for (int c = 0; c < COLUMNS; ++c)
                    part[i][o][c] += part[i + reach][o][c];
    fv(*sum)[COLUMNS] = part[0];
    for (int c = 0; c < COLUMNS; ++c) {
        float *column = sums + c * WEIGHT_ROWS;
        int o = 0;
        for (; o + 4 <= WEIGHT_ROWS; o += 4)
            vstore4(lane_sums(sum[o][c], sum[o + 1][c], sum[o + 2][c], sum[o + 3][c]), 0,
                    column + o);
        for (; o < WEIGHT_ROWS; ++o)
            column[o] = lane_sum(sum[o][c]);
    }
}

#endif
