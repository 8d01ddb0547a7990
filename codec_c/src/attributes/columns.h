/* Columns of a chunk: values, symbols, activity, and the cells that choose tables. */
#ifndef CLGS_ATTRIBUTES_COLUMNS_H
#define CLGS_ATTRIBUTES_COLUMNS_H

#include "attributes/model.h"
#include "common/bytes.h"

#define CLGS_LANES 8        /* runs of rows of a long column, coded in turn */
#define CLGS_LONG_ROWS 2048 /* shorter columns are one run: every lane costs bytes */

enum { CLGS_SERVES = 1, CLGS_SERVES_NEAR = 3 }; /* terms look at a column; at its near rows, too */

/* One chunk in the caller's workspace. Columns follow each other, `pitch` entries apart. */
typedef struct clgs_columns {
    const clgs_channel *channel;
    size_t rows, channels, lanes;
    size_t pitch; /* entries from column to column; an odd number of 64, so that caches serve all */
    const int32_t *source; /* encoder: (rows, channels), as the caller has them */
    const int32_t *near;   /* (rows, CLGS_NEAR): earlier rows, the first ones have fewer */
    int32_t *value;        /* (channels, rows), minus centre, modulo 2^32; only if `apart` */
    int16_t *clamped;      /* (channels, rows): values as terms use them; only if `served` */
    int32_t *around;       /* (channels, rows): their sums over near rows; only if `served` so */
    int32_t *rows_before;  /* (rows, CLGS_NEAR): near rows of an array without positions */
    uint8_t *symbol;       /* (channels, rows) */
    uint8_t *cell;         /* (rows): cells of the present column */
    int32_t *residual;     /* (rows): of the present column; sums of its prediction before */
    uint16_t *activity; /* (rows + 2): magnitudes of the earlier channels, summed; zero borders */
    uint32_t *partial;  /* (rows): weighted activity without the own column's part */
    uint8_t *level;     /* of each activity, CLGS_MAX_ACTIVITY + 1 of them */
    uint8_t *tile;      /* some rows of symbols on their way from rows to columns or back */
    uint8_t apart[CLGS_MAX_CHANNELS];   /* the column's values differ from its symbols' */
    uint8_t served[CLGS_MAX_CHANNELS];  /* terms look at the column */
    uint32_t zigzag[CLGS_MAX_CHANNELS]; /* encoder: all bits that occur, unless `apart` */
} clgs_columns;

static inline uint8_t *clgs_symbols(const clgs_columns *columns, size_t j)
{
    return columns->symbol + j * columns->pitch;
}

static inline int32_t *clgs_values(const clgs_columns *columns, size_t j)
{
    return columns->value + j * columns->pitch;
}

/* Entries from column to column. */
size_t clgs_pitch(size_t rows);

/* Bytes that `clgs_columns_place` hands out. */
size_t clgs_columns_size(size_t rows, size_t channels);

/* Lay the arrays out in `memory`, aligned as malloc does; activity becomes zero. `near` may be
 * NULL. The end, or NULL if a near row is not an earlier one. */
uint8_t *clgs_columns_place(clgs_columns *columns, void *memory);

/* Row-major values to columns: to values if `apart`, otherwise straight to symbols. */
void clgs_columns_load(clgs_columns *columns, const int32_t *value);

/* Columns to row-major values: from values if `apart`, otherwise from symbols. */
void clgs_columns_store(const clgs_columns *columns, int32_t *value);

/* Cells of column j but for the own column's part in its activity, which goes to `partial`. */
void clgs_columns_partial(clgs_columns *columns, size_t j);

/* Cells of column j, whose symbols must be known if its own weight is not 0. */
void clgs_columns_cells(clgs_columns *columns, size_t j);

/* Add the magnitudes of column j to the activity; call when its symbols are known. */
void clgs_columns_activate(clgs_columns *columns, size_t j);

/* First row of a lane; the lane after the last one starts after the last row. */
static inline size_t clgs_lane_start(const clgs_columns *columns, size_t lane)
{
    size_t more = columns->rows % columns->lanes;
    return columns->rows / columns->lanes * lane + (lane < more ? lane : more);
}

/* Level of a weighted activity. */
static inline uint8_t clgs_level_of(const clgs_columns *columns, uint32_t weighted)
{
    uint32_t activity = weighted >> CLGS_WEIGHT_BITS;
    return columns->level[activity < CLGS_MAX_ACTIVITY ? activity : CLGS_MAX_ACTIVITY];
}

/* Magnitude of a symbol under a gain, at most CLGS_MAX_MAGNITUDE. */
static inline uint32_t clgs_magnitude(uint32_t symbol, uint32_t gain)
{
    uint32_t magnitude = ((symbol + 1) >> 1) * gain >> CLGS_GAIN_BITS;
    return magnitude < CLGS_MAX_MAGNITUDE ? magnitude : CLGS_MAX_MAGNITUDE;
}

/* Zigzag of a residual: 0, -1, 1, -2 ... to 0, 1, 2, 3 ... */
static inline uint32_t clgs_zigzag(int32_t residual)
{
    return (uint32_t)residual << 1 ^ (residual < 0 ? 0xFFFFFFFFu : 0);
}

/* Symbol of a zigzag number; large ones share four symbols an octave. */
static inline uint8_t clgs_symbol_of(uint32_t zigzag)
{
    uint32_t top = 31;
    if (zigzag < CLGS_DIRECT)
        return (uint8_t)zigzag;
    while (!(zigzag >> top))
        top--;
    return (uint8_t)(CLGS_DIRECT + (top - 7) * 4 + (zigzag >> (top - 2) & 3));
}

#endif
