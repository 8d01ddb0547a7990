/* The last step of the backward pass of the MLPs, after backward_cpu.cl or backward_gpu.cl: the sum
 * of the weight gradient over its parts, in their order, to the packed weights.
 *
 * Work-item: EACH neighbouring sums of a part: on a CPU those of COLUMNS columns of a tile.
 * Work-group: any; no local memory.
 * Launch: part_size() / EACH work-items or more.
 */
#include "common/form.h"
#include "mlp/layout.h"
#include "mlp/weight_tile.h"

#if USE_LOCAL
#define EACH 1
#else
#define EACH SUMS
#endif

/* Writes sum number i of a step of COLUMNS columns, if no other tile does. */
static inline void write_weight(const WeightTile *tile, const int step, const int i,
                                const float sum, __global float *d_weights)
{
    const int column = step * COLUMNS + i / WEIGHT_ROWS, o = i % WEIGHT_ROWS;
    if (o < tile->repeated)
        return;
    if (column < tile->inputs)
        d_weights[tile->weight + o * tile->inputs + column] = sum;
    else if (column == tile->inputs)
        d_weights[tile->bias + o] = sum;
}

/* partial: (parts, part_size()). */
__kernel void mlp_backward_sum(__global const float *partial, const int parts,
                               __global float *d_weights)
{
    const int first = EACH * (int)get_global_id(0);
    if (first >= (int)part_size())
        return;
    int number = first / TILE_SUMS, head = 0;
    for (; head < HEADS - 1 && number >= head_tiles(head); ++head)
        number -= head_tiles(head);
    const WeightTile tile = weight_tile(head, number);
    const int step = first % TILE_SUMS / SUMS;
    if (step >= column_tiles(&tile))
        return;
    float sums[EACH] = {0.0f};
    for (int part = 0; part < parts; ++part)
#pragma unroll
        for (int i = 0; i < EACH; ++i)
            sums[i] += partial[(size_t)part * part_size() + (size_t)(first + i)];
#pragma unroll
    for (int i = 0; i < EACH; ++i)
        write_weight(&tile, step, first % SUMS + i, sums[i], d_weights);
}
