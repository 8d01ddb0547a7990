#include "attributes/literals.h"

#include "attributes/predict.h"
#include "common/bytes.h"

static void put_bits(clgs_literals *b, uint32_t value, uint32_t count)
{
    b->held |= (uint64_t)(value & ((uint32_t)(((uint64_t)1 << count) - 1))) << b->count;
    for (b->count += count; b->count >= 8; b->count -= 8) {
        *b->out++ = (uint8_t)b->held;
        b->held >>= 8;
    }
}

/* The next bits, or zeros if there are too few. */
static uint32_t get_bits(clgs_literals *b, uint32_t count)
{
    while (b->count < count) {
        if (b->end - b->at < 1) {
            b->failed = 1;
            return 0;
        }
        b->held |= (uint64_t)*b->at++ << b->count;
        b->count += 8;
    }
    uint32_t value = (uint32_t)(b->held & (((uint64_t)1 << count) - 1));
    b->held >>= count;
    b->count -= count;
    return value;
}

void clgs_literals_end(clgs_literals *literals)
{
    put_bits(literals, 0, (8 - literals->count) % 8);
}

int clgs_has_literals(const clgs_channel *channel)
{
    uint32_t sum = 0;
    for (int32_t k = 0; k < channel->classes; k++)
        for (uint32_t s = CLGS_DIRECT; s < CLGS_ALPHABET; s++)
            sum += channel->frequency[k][s];
    return clgs_has_tables(channel) && sum > 0;
}

static uint32_t large_zigzag(uint32_t symbol, uint32_t literal)
{
    return (4 + (symbol - CLGS_DIRECT) % 4) << clgs_literal_bits(symbol) | literal;
}

void clgs_literals_split(clgs_columns *columns, size_t j, clgs_literals *literals)
{
    uint8_t *symbol = clgs_symbols(columns, j);
    const int32_t *residual = columns->residual;
    if (!columns->apart[j])
        return;
    clgs_columns_serve(columns, j);
    clgs_columns_predict(columns, j);
    for (size_t i = 0; i < columns->rows; i++) {
        uint32_t zigzag = clgs_zigzag(residual[i]);
        symbol[i] = clgs_symbol_of(zigzag);
        if (literals && zigzag >= CLGS_DIRECT)
            put_bits(literals, zigzag, clgs_literal_bits(symbol[i]));
    }
}

void clgs_literals_join(clgs_columns *columns, size_t j, clgs_literals *literals)
{
    const uint8_t *symbol = clgs_symbols(columns, j);
    int32_t *value = clgs_values(columns, j);
    columns->apart[j] |= (uint8_t)clgs_has_literals(columns->channel + j);
    if (!columns->apart[j])
        return;
    for (size_t i = 0; i < columns->rows; i++) {
        uint32_t zigzag = symbol[i];
        if (zigzag >= CLGS_DIRECT)
            zigzag = large_zigzag(zigzag, get_bits(literals, clgs_literal_bits(zigzag)));
        value[i] = clgs_signed(zigzag & 1 ? ~(zigzag >> 1) : zigzag >> 1);
    }
}
