/* What the encoder measures before it chooses a model: symbols by cell, bytes of mixed channels. */
#include "attributes/literals.h"
#include "attributes/mixed.h"

/* Count symbols alone; four tables in turn, because a counter cannot grow every cycle. */
static void count_symbols(const uint8_t *symbol, size_t rows, uint32_t *count)
{
    uint32_t part[4][CLGS_TABLE] = {{0}};
    for (size_t i = 0; i < rows; i++)
        part[i & 3][symbol[i]]++;
    for (size_t s = 0; s < CLGS_TABLE; s++)
        count[s] += part[0][s] + part[1][s] + part[2][s] + part[3][s];
}

clgs_error clgs_attributes_count(const void *model, const int32_t *value, const int32_t *near,
                                 size_t rows, size_t channels, uint32_t *count, void *workspace)
{
    clgs_columns columns = {.channel = model, .rows = rows, .channels = channels, .near = near};
    if (clgs_attributes_workspace(rows, channels) == 0 || !clgs_model_valid(model, channels))
        return CLGS_ERROR_ARGUMENT;
    if (!clgs_columns_place(&columns, workspace))
        return CLGS_ERROR_ARGUMENT;
    clgs_columns_load(&columns, value);
    for (size_t j = 0; j < channels; j++) {
        const clgs_channel *channel = columns.channel + j;
        const uint8_t *symbol = clgs_symbols(&columns, j);
        uint32_t *own = count + j * CLGS_CELLS * CLGS_TABLE;
        clgs_literals_split(&columns, j, NULL);
        if (!clgs_has_cells(channel)) {
            count_symbols(symbol, rows, own);
        } else {
            clgs_columns_cells(&columns, j);
            for (size_t i = 0; i < rows; i++)
                own[columns.cell[i] * CLGS_TABLE + symbol[i]]++;
        }
        clgs_columns_activate(&columns, j);
    }
    return CLGS_OK;
}

size_t clgs_attributes_measure_bound(size_t rows)
{
    return CLGS_MIXED_MOST * rows + 8;
}

clgs_error clgs_attributes_measure(const void *model, const int32_t *value, const int32_t *near,
                                   size_t rows, size_t channels, uint64_t *bytes, uint8_t *out,
                                   void *workspace)
{
    clgs_columns columns = {.channel = model, .rows = rows, .channels = channels, .near = near};
    if (clgs_attributes_workspace(rows, channels) == 0 || !clgs_model_valid(model, channels))
        return CLGS_ERROR_ARGUMENT;
    clgs_mixed *mixed = (clgs_mixed *)clgs_columns_place(&columns, workspace);
    if (!mixed)
        return CLGS_ERROR_ARGUMENT;
    clgs_columns_load(&columns, value);
    clgs_mixed_init(mixed);
    for (size_t j = 0; j < channels; j++) {
        clgs_literals_split(&columns, j, NULL);
        if (columns.channel[j].coder == CLGS_MIXED) {
            clgs_range coder;
            clgs_range_begin_encode(&coder, out, clgs_attributes_measure_bound(rows));
            clgs_mixed_code(mixed, &coder, &columns, j);
            clgs_range_end_encode(&coder);
            bytes[j] += (uint64_t)(coder.out - out);
        }
        clgs_columns_activate(&columns, j);
    }
    return CLGS_OK;
}
