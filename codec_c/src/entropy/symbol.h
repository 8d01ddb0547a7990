/* Binary decisions that spell one integer: zero, sign, length in bits, the bits below the top. */
#ifndef CLGS_ENTROPY_SYMBOL_H
#define CLGS_ENTROPY_SYMBOL_H

#include "entropy/mix.h"

#define CLGS_NODES 128 /* decisions with states of their own; 110 are used */
#define CLGS_NODE_ZERO 0
#define CLGS_NODE_SIGN 1
#define CLGS_NODE_LENGTH 1 /* + length, from 1 to 14: is the number longer? */
#define CLGS_LAST_LENGTH 14
#define CLGS_MAX_LENGTH 32

/* The states and weights of one symbol: `base[i] + node`, `weight + inputs * node`. */
typedef struct clgs_symbol {
    clgs_mix mix;
    uint32_t *base[CLGS_MAX_INPUTS];
    int32_t *weight;
    uint16_t *curve; /* of node 0, or NULL for none */
} clgs_symbol;

static inline uint32_t clgs_symbol_bit(clgs_symbol *symbol, uint32_t node, uint32_t bit)
{
    for (uint32_t i = 0; i < symbol->mix.inputs; i++)
        symbol->mix.state[i] = symbol->base[i] + node;
    symbol->mix.weight = symbol->weight + symbol->mix.inputs * node;
    symbol->mix.curve = symbol->curve ? symbol->curve + CLGS_CURVE_KNOTS * node : NULL;
    return clgs_mix_code(&symbol->mix, bit);
}

/* Signed class of a neighbour: 0, 1, 2, 3-4, 5-8, 9-16, 17-32, more; 8 and up if negative. */
static inline uint32_t clgs_signed_level(int32_t value)
{
    static const uint8_t LEVEL[33] = {0, 1, 2, 3, 3, 4, 4, 4, 4, 5, 5, 5, 5, 5, 5, 5, 5,
                                      6, 6, 6, 6, 6, 6, 6, 6, 6, 6, 6, 6, 6, 6, 6, 6};
    uint32_t size = (uint32_t)(value < 0 ? -value : value);
    uint32_t step = size <= 32 ? LEVEL[size] : 7;
    return value < 0 ? 8 + step : step;
}

/* Class of a neighbour by its size alone: 0, 1-2, 3-8, more. */
static inline uint32_t clgs_small_level(int32_t value)
{
    uint32_t size = (uint32_t)(value < 0 ? -value : value);
    return size == 0 ? 0 : size <= 2 ? 1 : size <= 8 ? 2 : 3;
}

/* Code `size` >= 1, below 2^32: its length in bits, then the bits below the top one. */
uint32_t clgs_symbol_size(clgs_symbol *symbol, uint32_t size);

/* Code a difference in (-2^32, 2^32). */
int64_t clgs_symbol_value(clgs_symbol *symbol, int64_t value);

#endif
