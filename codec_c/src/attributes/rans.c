#include "attributes/rans.h"

#include <string.h>

#include "common/bytes.h"

/* A quotient's reciprocal is rounded up. States below 2^20 frequency (so below 2^32) times the
 * error (below frequency <= 2^12) stay below 2^44, so quotients are exact; products fit 64 bits. */
#define SHIFT 44

static uint32_t first_state(size_t lanes)
{
    return lanes == 1 ? 1 : CLGS_RANS_LOW;
}

/* Bytes of a state on its own: none of the upper ones is 0, but there is one at least. */
static size_t state_size(uint32_t state)
{
    size_t size = 1;
    while (size < 4 && state >> 8 * size)
        size++;
    return size;
}

void clgs_rans_begin_encode(clgs_rans_encoder *coder, size_t lanes, clgs_rans_symbol *table,
                            uint16_t *end)
{
    *coder = (clgs_rans_encoder){.lanes = lanes, .word = end, .end = end, .table = table};
    for (size_t lane = 0; lane < lanes; lane++)
        coder->state[lane] = first_state(lanes);
}

size_t clgs_rans_size(const clgs_rans_encoder *coder)
{
    size_t states = coder->lanes == 1 ? state_size(coder->state[0]) : 4 * coder->lanes;
    return states + 2 * (size_t)(coder->end - coder->word);
}

uint8_t *clgs_rans_end_encode(const clgs_rans_encoder *coder, uint8_t *out)
{
    for (size_t lane = 0; lane < coder->lanes; lane++) {
        size_t size = coder->lanes == 1 ? state_size(coder->state[0]) : 4;
        for (size_t i = 0; i < size; i++)
            *out++ = (uint8_t)(coder->state[lane] >> 8 * i);
    }
    for (const uint16_t *word = coder->word; word < coder->end; word++) {
        *out++ = (uint8_t)*word;
        *out++ = (uint8_t)(*word >> 8);
    }
    return out;
}

/* A single state before words is CLGS_RANS_LOW at least, so it has three or four bytes. */
static clgs_error load_single(clgs_rans_decoder *coder, const uint8_t *at, const uint8_t *end)
{
    size_t size = (size_t)(end - at);
    if (size > 4)
        size = 4 - size % 2;
    for (size_t i = 0; i < size; i++)
        coder->state[0] |= (uint32_t)at[i] << 8 * i;
    coder->word = at + size;
    return size > 0 && state_size(coder->state[0]) == size ? CLGS_OK : CLGS_ERROR_CORRUPT;
}

clgs_error clgs_rans_begin_decode(clgs_rans_decoder *coder, size_t lanes, const uint8_t *at,
                                  const uint8_t *end)
{
    *coder = (clgs_rans_decoder){.lanes = lanes, .end = end, .table = coder->table};
    if (lanes == 1)
        return load_single(coder, at, end);
    if ((size_t)(end - at) < 4 * lanes)
        return CLGS_ERROR_TRUNCATED;
    for (size_t lane = 0; lane < lanes; lane++, at += 4) {
        coder->state[lane] = clgs_load32(at);
        if (coder->state[lane] < CLGS_RANS_LOW)
            return CLGS_ERROR_CORRUPT;
    }
    coder->word = at;
    return CLGS_OK;
}

int clgs_rans_finished(const clgs_rans_decoder *coder)
{
    uint32_t wrong = 0;
    for (size_t lane = 0; lane < coder->lanes; lane++)
        wrong |= coder->state[lane] ^ first_state(coder->lanes);
    return wrong == 0;
}

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

/* Code one symbol; a larger state first gives up its low word. 0 if there is no such symbol. */
static int put(clgs_rans_encoder *coder, size_t lane, const clgs_rans_symbol *symbol)
{
    uint32_t x = coder->state[lane];
    if (x > symbol->most) {
        *--coder->word = (uint16_t)x;
        x >>= 16;
    }
    uint32_t quotient = (uint32_t)(x * symbol->reciprocal >> SHIFT);
    coder->state[lane] = x + symbol->start + quotient * symbol->complement;
    return symbol->reciprocal != 0;
}

/* The same without branches, on local variables. */
#define ENCODE_LANE(LANE)                                                                          \
    do {                                                                                           \
        size_t i = start##LANE + step;                                                             \
        const clgs_rans_symbol *s = table + symbol[i];                                             \
        if (cell)                                                                                  \
            s += CLGS_TABLE * (size_t)class_of[cell[i]];                                           \
        uint32_t full = x##LANE > s->most;                                                         \
        word[-1] = (uint16_t)x##LANE;                                                              \
        word -= full;                                                                              \
        x##LANE >>= 16 * full;                                                                     \
        uint64_t reciprocal = s->reciprocal;                                                       \
        missing |= reciprocal == 0;                                                                \
        x##LANE += s->start + (uint32_t)(x##LANE * reciprocal >> SHIFT) * s->complement;           \
    } while (0)

/* All steps of all lanes, last one first. 0 if a symbol has no frequency. */
static inline int encode_steps(clgs_rans_encoder *coder, const uint8_t *symbol, const uint8_t *cell,
                               const uint8_t *class_of, const size_t *start)
{
    uint32_t *x = coder->state, x0 = x[0], x1 = x[1], x2 = x[2], x3 = x[3], x4 = x[4], x5 = x[5],
             x6 = x[6], x7 = x[7], missing = 0;
    const size_t start0 = start[0], start1 = start[1], start2 = start[2], start3 = start[3],
                 start4 = start[4], start5 = start[5], start6 = start[6], start7 = start[7];
    const clgs_rans_symbol *table = coder->table;
    uint16_t *word = coder->word;
    for (size_t step = start[CLGS_LANES] / CLGS_LANES; step-- > 0;) {
        ENCODE_LANE(7);
        ENCODE_LANE(6);
        ENCODE_LANE(5);
        ENCODE_LANE(4);
        ENCODE_LANE(3);
        ENCODE_LANE(2);
        ENCODE_LANE(1);
        ENCODE_LANE(0);
    }
    x[0] = x0, x[1] = x1, x[2] = x2, x[3] = x3, x[4] = x4, x[5] = x5, x[6] = x6, x[7] = x7;
    coder->word = word;
    return !missing;
}

int clgs_rans_encode(clgs_rans_encoder *coder, const clgs_columns *columns, size_t j,
                     const uint8_t *cell)
{
    const uint8_t *class_of = columns->channel[j].class_of;
    const uint8_t *symbol = clgs_symbols(columns, j);
    size_t lanes = coder->lanes, start[CLGS_LANES + 1];
    size_t first = lanes == 1 ? 0 : columns->rows / lanes;
    int known = 1;
    fill_encoder(coder->table, columns->channel + j);
    for (size_t lane = 0; lane <= lanes; lane++)
        start[lane] = clgs_lane_start(columns, lane);
    for (size_t lane = lanes; lane-- > 0;)
        for (size_t i = start[lane + 1]; i-- > start[lane] + first;) {
            size_t k = cell ? class_of[cell[i]] : 0;
            known &= put(coder, lane, coder->table + CLGS_TABLE * k + symbol[i]);
        }
    if (lanes == 1)
        return known;
    if (cell)
        return known & encode_steps(coder, symbol, cell, class_of, start);
    return known & encode_steps(coder, symbol, NULL, class_of, start);
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

/* The rows of a column, and what the classes of its rows depend on. */
typedef struct column {
    uint8_t *symbol;
    const uint8_t *cell;
    const uint32_t *partial;
    const uint8_t *class_of, *level;
    uint32_t weight;
    size_t start[CLGS_LANES + 1];
    uint8_t magnitude[CLGS_TABLE];
    uint32_t recent[CLGS_LANES]; /* magnitudes of the two rows before, the later one counts twice */
} column;

/* What a lane's next symbol is decoded with, by the kind of the channel. */
typedef enum class_kind { PLAIN, CLASSED, OWN } class_kind;

static inline const uint32_t *table_of(const clgs_rans_decoder *coder, const column *c, size_t i,
                                       size_t lane, class_kind kind)
{
    uint32_t cell = c->cell[i];
    if (kind == OWN) {
        uint32_t recent = (c->recent[lane] & 0xFFFF) + (c->recent[lane] >> 16);
        uint32_t activity = (c->partial[i] + c->weight * recent) >> CLGS_WEIGHT_BITS;
        cell |= c->level[activity < CLGS_MAX_ACTIVITY ? activity : CLGS_MAX_ACTIVITY];
    }
    return coder->table + CLGS_SCALE * (size_t)c->class_of[cell];
}

/* Decode step `step` of one lane with words that are there: at least one. */
#define DECODE_LANE(LANE)                                                                          \
    do {                                                                                           \
        size_t i = start##LANE + step;                                                             \
        const uint32_t *table = kind == PLAIN ? plain : table_of(coder, c, i, LANE, kind);         \
        uint32_t entry = table[x##LANE % CLGS_SCALE], next = 0;                                    \
        x##LANE =                                                                                  \
            ((entry >> 8 & (CLGS_SCALE - 1)) + 1) * (x##LANE >> CLGS_SCALE_BITS) + (entry >> 20);  \
        next = x##LANE << 16 | (uint32_t)word[0] | (uint32_t)word[1] << 8;                         \
        word += x##LANE < CLGS_RANS_LOW ? 2 : 0;                                                   \
        x##LANE = x##LANE < CLGS_RANS_LOW ? next : x##LANE;                                        \
        symbol[i] = (uint8_t)entry;                                                                \
        if (kind == OWN)                                                                           \
            c->recent[LANE] = (c->recent[LANE] >> 17) | (uint32_t)c->magnitude[entry & 255] << 17; \
    } while (0)

/* Decode steps of all lanes while words for a whole one are sure to remain; the next step. */
static inline size_t decode_steps(clgs_rans_decoder *coder, column *c, size_t steps,
                                  class_kind kind)
{
    uint32_t *x = coder->state, x0 = x[0], x1 = x[1], x2 = x[2], x3 = x[3], x4 = x[4], x5 = x[5],
             x6 = x[6], x7 = x[7];
    const size_t *start = c->start, start0 = start[0], start1 = start[1], start2 = start[2],
                 start3 = start[3], start4 = start[4], start5 = start[5], start6 = start[6],
                 start7 = start[7];
    const uint32_t *plain = coder->table;
    const uint8_t *word = coder->word, *end = coder->end;
    uint8_t *symbol = c->symbol;
    size_t step = 0;
    for (; step < steps && end - word >= 2 * CLGS_LANES; step++) {
        DECODE_LANE(0);
        DECODE_LANE(1);
        DECODE_LANE(2);
        DECODE_LANE(3);
        DECODE_LANE(4);
        DECODE_LANE(5);
        DECODE_LANE(6);
        DECODE_LANE(7);
    }
    x[0] = x0, x[1] = x1, x[2] = x2, x[3] = x3, x[4] = x4, x[5] = x5, x[6] = x6, x[7] = x7;
    coder->word = word;
    return step;
}

/* Decode one symbol of a lane when no word may be left: a single lane needs no more of them. */
static void decode_last(clgs_rans_decoder *coder, column *c, size_t i, size_t lane, class_kind kind)
{
    const uint32_t *table = kind == PLAIN ? coder->table : table_of(coder, c, i, lane, kind);
    uint32_t x = coder->state[lane], entry = table[x % CLGS_SCALE];
    x = ((entry >> 8 & (CLGS_SCALE - 1)) + 1) * (x >> CLGS_SCALE_BITS) + (entry >> 20);
    if (x < CLGS_RANS_LOW && coder->end - coder->word >= 2) {
        x = x << 16 | (uint32_t)coder->word[0] | (uint32_t)coder->word[1] << 8;
        coder->word += 2;
    } else if (x < CLGS_RANS_LOW && coder->lanes > 1) {
        coder->failed = 1;
        x = CLGS_RANS_LOW;
    }
    coder->state[lane] = x;
    c->symbol[i] = (uint8_t)entry;
    c->recent[lane] = c->recent[lane] >> 17 | (uint32_t)c->magnitude[entry & 255] << 17;
}

/* Decode the steps from `step` on, of which lanes may lack the last one. */
static inline void decode_rest(clgs_rans_decoder *coder, column *c, size_t step, size_t steps,
                               class_kind kind)
{
    for (; step <= steps; step++)
        for (size_t lane = 0; lane < coder->lanes; lane++)
            if (c->start[lane] + step < c->start[lane + 1])
                decode_last(coder, c, c->start[lane] + step, lane, kind);
}

static void decode_column(clgs_rans_decoder *coder, column *c, size_t rows, class_kind kind)
{
    size_t steps = rows / coder->lanes, most = coder->lanes == 1 ? 0 : steps;
    if (kind == PLAIN)
        decode_rest(coder, c, decode_steps(coder, c, most, PLAIN), steps, PLAIN);
    else if (kind == CLASSED)
        decode_rest(coder, c, decode_steps(coder, c, most, CLASSED), steps, CLASSED);
    else
        decode_rest(coder, c, decode_steps(coder, c, most, OWN), steps, OWN);
}

void clgs_rans_decode(clgs_rans_decoder *coder, clgs_columns *columns, size_t j)
{
    const clgs_channel *channel = columns->channel + j;
    column c = {.symbol = clgs_symbols(columns, j),
                .cell = columns->cell,
                .partial = columns->partial,
                .class_of = channel->class_of,
                .level = columns->level,
                .weight = (uint32_t)channel->weight[0]};
    fill_decoder(coder->table, channel);
    for (size_t lane = 0; lane <= coder->lanes; lane++)
        c.start[lane] = clgs_lane_start(columns, lane);
    for (uint32_t s = 0; s < CLGS_TABLE; s++)
        c.magnitude[s] = (uint8_t)clgs_magnitude(s, (uint32_t)channel->gain);
    class_kind kind = channel->classes == 1 ? PLAIN : channel->weight[0] == 0 ? CLASSED : OWN;
    decode_column(coder, &c, columns->rows, kind);
}
