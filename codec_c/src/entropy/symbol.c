#include "entropy/symbol.h"

/* For each length: the first node of its tree of leading bits, and how many bits the tree has. */
static const struct {
    uint8_t node, bits;
} TREE[10] = {{0, 0},  {0, 0},  {16, 1}, {17, 2}, {20, 3},
              {27, 4}, {42, 5}, {73, 4}, {88, 4}, {103, 3}};

static uint32_t code_length(clgs_symbol *symbol, uint32_t length)
{
    uint32_t at = 1;
    for (; at < CLGS_MAX_LENGTH; at++) {
        uint32_t node = CLGS_NODE_LENGTH + (at < CLGS_LAST_LENGTH ? at : CLGS_LAST_LENGTH);
        if (!clgs_symbol_bit(symbol, node, length > at))
            break;
    }
    return at;
}

uint32_t clgs_symbol_size(clgs_symbol *symbol, uint32_t size)
{
    uint32_t length = 0;
    while (length < CLGS_MAX_LENGTH && size >> length)
        length++;
    length = code_length(symbol, length);
    uint32_t kind = length < 9 ? length : 9, left = length - 1, prefix = 1, coded = 1;
    for (uint32_t i = 0; i < TREE[kind].bits; i++) {
        left--;
        uint32_t node = TREE[kind].node + prefix - 1;
        uint32_t bit = clgs_symbol_bit(symbol, node, size >> left & 1);
        prefix = prefix << 1 | bit;
        coded = coded << 1 | bit;
    }
    while (left > 0) {
        left--;
        coded = coded << 1 | clgs_range_code(symbol->mix.coder, size >> left & 1, 32768);
    }
    return coded;
}

int64_t clgs_symbol_value(clgs_symbol *symbol, int64_t value)
{
    if (!clgs_symbol_bit(symbol, CLGS_NODE_ZERO, value != 0))
        return 0;
    uint32_t negative = clgs_symbol_bit(symbol, CLGS_NODE_SIGN, value < 0);
    int64_t size = clgs_symbol_size(symbol, (uint32_t)(value < 0 ? -value : value));
    return negative ? -size : size;
}
