/* The last step of the backward pass of the MLPs, after backward_cpu.cl or backward_gpu.cl: the sum
 * of the weight gradient over its parts, in their order, to the packed weights.
 *
 * Work-item: a tile of rows (dimension 0: of all heads, one after the other) by COLUMNS columns
 *     (dimension 1).
 * Work-group: any; no local memory.
 * Launch: (tiles_before(HEADS), COLUMN_TILES).
 */
#include "mlp/layout.h"
#include "mlp/weight_tile.h"

/* partial: (parts, part_size()). */
__kernel void mlp_backward_sum(__global const float *partial, const int parts,
                               __global float *d_weights)
{
    int number = (int)get_global_id(0), head = 0;
    for (; head < HEADS - 1 && number >= head_tiles(head); ++head)
        number -= head_tiles(head);
    const WeightTile tile = weight_tile(head, number);
    const int step = (int)get_global_id(1);
    if (step >= column_tiles(&tile))
        return;
    float sums[SUMS] = {0.0f};
    for (int part = 0; part < parts; ++part)
#pragma unroll
        for (int i = 0; i < SUMS; ++i)
            sums[i] += partial[(size_t)part * part_size() + tile.sums + step * SUMS + i];
#pragma unroll
    for (int c = 0; c < COLUMNS; ++c)
#pragma unroll
        for (int o = 0; o < WEIGHT_ROWS; ++o) {
            const int column = step * COLUMNS + c;
            if (o < tile.repeated)
                continue;
            if (column < tile.inputs)
                d_weights[tile.weight + o * tile.inputs + column] = sums[c * WEIGHT_ROWS + o];
            else if (column == tile.inputs)
                d_weights[tile.bias + o] = sums[c * WEIGHT_ROWS + o];
        }
}
