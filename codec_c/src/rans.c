#include "rans.h"

#include <string.h>

#include "bytes.h"

/* A quotient's reciprocal is rounded up. States below 2^20 frequency (so below 2^32) times the
 * error (below frequency <= 2^12) stay below 2^44, so quotients are exact; products fit 64 bits. */
#define SHIFT 44

/* A channel's tables for the encoder, one a class. */
static void fill_encoder(clgs_rans_symbol *table, const clgs_channel *channel)
{
    for (int32_t k = 0; k < channel->classes; k++, table += CLGS_TABLE) {
        uint32_t start = 0;
        for (uint32_t s = 0; s < CLGS_ALPHABET; s++) {
            uint32_t frequency = channel->frequency[k][s];
            table[s] = (clgs_rans_symbol){.start = (uint16_t)start};
            if (frequency == 0)
                continue;
            table[s].reciprocal = (((uint64_t)1 << SHIFT) + frequency - 1) / frequency;
            table[s].most = (frequency << (32 - CLGS_SCALE_BITS)) - 1;
            table[s].complement = (uint16_t)(CLGS_SCALE - frequency);
            start += frequency;
        }
    }
}

/* Code one symbol; a larger state first gives up its low word. 0 where there is no such symbol. */
static inline int put(clgs_rans_encoder *coder, size_t lane, const clgs_rans_symbol *symbol)
{
    uint32_t x = coder->state[lane], full = x > symbol->most;
    coder->word[-1] = (uint16_t)x;
    coder->word -= full;
    x >>= 16 * full;
    uint32_t quotient = (uint32_t)(x * symbol->reciprocal >> SHIFT);
    coder->state[lane] = x + symbol->start + quotient * symbol->complement;
    return symbol->reciprocal != 0;
}

int clgs_rans_encode(clgs_rans_encoder *coder, const clgs_columns *columns, size_t j,
                     const uint8_t *cell)
{
    const clgs_channel *channel = columns->channel + j;
    const uint8_t *symbol = columns->symbol + j * columns->rows;
    clgs_rans_encoder local = *coder;
    const clgs_rans_symbol *table = coder->table;
    size_t steps = columns->rows / CLGS_LANES, start[CLGS_LANES + 1];
    int known = 1;
    fill_encoder(coder->table, channel);
    for (size_t lane = 0; lane <= CLGS_LANES; lane++)
        start[lane] = clgs_lane_start(columns->rows, lane);
    for (size_t lane = CLGS_LANES; lane-- > 0;) {
        size_t i = start[lane] + steps;
        if (i < start[lane + 1]) {
            size_t k = cell ? channel->class_of[cell[i]] : 0;
            known &= put(&local, lane, table + CLGS_TABLE * k + symbol[i]);
        }
    }
    if (cell) {
        for (size_t step = steps; step-- > 0;)
            for (size_t lane = CLGS_LANES; lane-- > 0;) {
                size_t i = start[lane] + step, k = channel->class_of[cell[i]];
                known &= put(&local, lane, table + CLGS_TABLE * k + symbol[i]);
            }
    } else {
        for (size_t step = steps; step-- > 0;)
            for (size_t lane = CLGS_LANES; lane-- > 0;)
                known &= put(&local, lane, table + symbol[start[lane] + step]);
    }
    *coder = local;
    return known;
}

/* Entries of the decoder: symbol, frequency - 1 above bit 8, place in its range above bit 20. */
static void fill_decoder(uint32_t *table, const clgs_channel *channel)
{
    for (int32_t k = 0; k < channel->classes; k++)
        for (uint32_t s = 0; s < CLGS_ALPHABET; s++) {
            uint32_t frequency = channel->frequency[k][s];
            uint32_t entry = s | (frequency - 1) << 8;
            for (uint32_t place = 0; place < frequency; place++)
                *table++ = entry + (place << 20);
        }
}

/* Decode one symbol of a lane; a small state takes the next word. Reads words without a check
 * where `sure`, otherwise counts a missing one as a failure. */
static inline uint8_t get(clgs_rans_decoder *coder, size_t lane, const uint32_t *table, int sure)
{
    uint32_t x = coder->state[lane], entry = table[x % CLGS_SCALE];
    x = ((entry >> 8 & (CLGS_SCALE - 1)) + 1) * (x >> CLGS_SCALE_BITS) + (entry >> 20);
    if (sure) {
        uint32_t word = (uint32_t)coder->word[0] | (uint32_t)coder->word[1] << 8;
        uint32_t small = x < CLGS_RANS_LOW;
        x = small ? x << 16 | word : x;
        coder->word += 2 * small;
    } else if (x < CLGS_RANS_LOW) {
        uint32_t word = 0;
        if (coder->end - coder->word >= 2) {
            word = (uint32_t)coder->word[0] | (uint32_t)coder->word[1] << 8;
            coder->word += 2;
        } else {
            coder->failed = 1;
        }
        x = x << 16 | word;
    }
    coder->state[lane] = x;
    return (uint8_t)entry;
}

/* The rows of a column, lane by lane, and what the cells of a row depend on. */
typedef struct column {
    uint8_t *symbol;
    const uint8_t *cell;
    const uint32_t *partial;
    const uint8_t *class_of, *level;
    uint32_t weight;
    uint8_t magnitude[CLGS_TABLE];
    uint32_t one[CLGS_LANES], two[CLGS_LANES]; /* magnitudes of the two rows before */
} column;

static inline void get_plain(clgs_rans_decoder *coder, const column *c, size_t i, size_t lane,
                             int sure)
{
    c->symbol[i] = get(coder, lane, coder->table, sure);
}

static inline void get_classed(clgs_rans_decoder *coder, const column *c, size_t i, size_t lane,
                               int sure)
{
    const uint32_t *table = coder->table + CLGS_SCALE * (size_t)c->class_of[c->cell[i]];
    c->symbol[i] = get(coder, lane, table, sure);
}

static inline void get_own(clgs_rans_decoder *coder, column *c, size_t i, size_t lane, int sure)
{
    uint32_t weighted = c->partial[i] + c->weight * (2 * c->one[lane] + c->two[lane]);
    uint32_t activity = weighted >> CLGS_WEIGHT_BITS;
    activity = activity < CLGS_MAX_ACTIVITY ? activity : CLGS_MAX_ACTIVITY;
    uint32_t cell = c->cell[i] | c->level[activity];
    const uint32_t *table = coder->table + CLGS_SCALE * (size_t)c->class_of[cell];
    c->symbol[i] = get(coder, lane, table, sure);
    c->two[lane] = c->one[lane];
    c->one[lane] = c->magnitude[c->symbol[i]];
}

/* Run GET over all rows: eight lanes a step, without checks while words for a step remain. */
#define DECODE_COLUMN(GET)                                                                         \
    do {                                                                                           \
        size_t step = 0;                                                                           \
        for (; step < steps && local.end - local.word >= 2 * CLGS_LANES; step++)                   \
            for (size_t lane = 0; lane < CLGS_LANES; lane++)                                       \
                GET(&local, &c, start[lane] + step, lane, 1);                                      \
        for (; step < steps; step++)                                                               \
            for (size_t lane = 0; lane < CLGS_LANES; lane++)                                       \
                GET(&local, &c, start[lane] + step, lane, 0);                                      \
        for (size_t lane = 0; lane < CLGS_LANES; lane++)                                           \
            if (start[lane] + steps < start[lane + 1])                                             \
                GET(&local, &c, start[lane] + steps, lane, 0);                                     \
    } while (0)

void clgs_rans_decode(clgs_rans_decoder *coder, clgs_columns *columns, size_t j)
{
    const clgs_channel *channel = columns->channel + j;
    clgs_rans_decoder local = *coder;
    size_t steps = columns->rows / CLGS_LANES, start[CLGS_LANES + 1];
    column c = {.symbol = columns->symbol + j * columns->rows,
                .cell = columns->cell,
                .partial = columns->partial,
                .class_of = channel->class_of,
                .level = columns->level,
                .weight = (uint32_t)channel->weight[0]};
    fill_decoder(coder->table, channel);
    for (size_t lane = 0; lane <= CLGS_LANES; lane++)
        start[lane] = clgs_lane_start(columns->rows, lane);
    for (uint32_t s = 0; s < CLGS_TABLE; s++)
        c.magnitude[s] = (uint8_t)clgs_magnitude(s, (uint32_t)channel->gain);
    if (channel->classes == 1)
        DECODE_COLUMN(get_plain);
    else if (channel->weight[0] == 0)
        DECODE_COLUMN(get_classed);
    else
        DECODE_COLUMN(get_own);
    *coder = local;
}
