/* A register tile of the weight gradient: WEIGHT_ROWS neighbouring rows of a layer, COLUMNS of its
 * inputs at a time.
 *
 * The gradient is summed in parts. A part holds the sums in the order in which they are made: tile
 * by tile of each head's layers, COLUMNS by COLUMNS of the inputs and the bias, WEIGHT_ROWS sums
 * per column. The last tile of a layer may repeat rows of the tile before it.
 */
#ifndef CLGS_MLP_WEIGHT_TILE_H
#define CLGS_MLP_WEIGHT_TILE_H

#include "common/form.h"
#include "common/method.h"
#include "mlp/batch.h"
#include "mlp/layout.h"

/* As many sums as leave a CPU's registers room for a row of operands. A layer has no fewer rows. */
#ifndef WEIGHT_ROWS
#define WEIGHT_ROWS (USE_LOCAL ? 10 : 4)
#endif
#ifndef COLUMNS
#define COLUMNS (USE_LOCAL ? 7 : 3)
#endif

#define TILES_OF(rows) (((rows) + WEIGHT_ROWS - 1) / WEIGHT_ROWS)
#define MOST_INPUTS (INPUT_DIM > HIDDEN_DIM ? INPUT_DIM : HIDDEN_DIM) /* of a layer */
#define COLUMN_TILES ((MOST_INPUTS + COLUMNS) / COLUMNS)
#define SUMS (WEIGHT_ROWS * COLUMNS)
#define TILE_SUMS (COLUMN_TILES * SUMS)

/* Tiles of both layers of a head. */
static inline int head_tiles(const int head)
{
    return TILES_OF(HIDDEN_DIM) + TILES_OF(K_OFFSETS * slot_rows(head));
}

/* Tiles of all heads before `head`; HEADS gives those of all. */
static inline int tiles_before(const int head)
{
    int tiles = 0;
    for (int before = 0; before < head; ++before)
        tiles += head_tiles(before);
    return tiles;
}

/* Floats of a part. */
static inline size_t part_size(void)
{
    return (size_t)tiles_before(HEADS) * TILE_SUMS;
}

/* Which rows of a batch a tile of the gradient is made of, and its places in a part and in the
 * packed weights. */
typedef struct {
    int d_row;     /* first of its rows of gradients by the layer's sums */
    int input_row; /* first row of the layer's inputs */
    int inputs;    /* of the layer */
    int slots;     /* to which its rows belong, one per bit; all for a hidden layer */
    int repeated;  /* how many of its rows the tile before has as well */
    int sums;      /* place in a part */
    int weight;    /* places in the packed weights */
    int bias;
} WeightTile;

/* Tile number `number` of a head: those of the hidden layer, then those of the output layer. */
static inline WeightTile weight_tile(const int head, const int number)
{
    const bool inner = number < TILES_OF(HIDDEN_DIM);
    const int rows = inner ? HIDDEN_DIM : K_OFFSETS * slot_rows(head);
    const int next = (inner ? number : number - TILES_OF(HIDDEN_DIM)) * WEIGHT_ROWS;
    const int first = min(next, rows - WEIGHT_ROWS);
    const int start = head_start(head) + (inner ? 0 : HIDDEN_SIZE);
    WeightTile tile;
    tile.d_row = (inner ? D_HIDDEN_ROW(head) : D_OUTPUT_ROW(head)) + first;
    tile.input_row = inner ? 0 : HIDDEN_ROW(head);
    tile.inputs = inner ? INPUT_DIM : HIDDEN_DIM;
    tile.slots = inner ? (1 << K_OFFSETS) - 1 : 0;
    for (int o = 0; o < WEIGHT_ROWS && !inner; ++o)
        tile.slots |= 1 << (first + o) / slot_rows(head);
    tile.repeated = next - first;
    tile.sums = (tiles_before(head) + number) * TILE_SUMS;
    tile.weight = start + first * tile.inputs;
    tile.bias = start + rows * tile.inputs + first;
    return tile;
}

/* How many steps of COLUMNS cover the inputs of the layer and its bias. */
static inline int column_tiles(const WeightTile *tile)
{
    return (tile->inputs + COLUMNS) / COLUMNS;
}

/* The rows of a batch that COLUMNS columns of the tile multiply, from number `column` on: inputs of
 * the layer, and for the bias the row of ones. */
static inline void multiplied_rows(const WeightTile *tile, const int column,
                                   __global const float *batch,
                                   __global const float *columns[COLUMNS])
{
    for (int c = 0; c < COLUMNS; ++c)
        columns[c] = batch + (column + c < tile->inputs ? tile->input_row + column + c : ONES_ROW) *
                                 BATCH_STRIDE;
}

#endif
