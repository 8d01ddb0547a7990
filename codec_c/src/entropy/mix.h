/* Adaptive probabilities, mixed in the logistic domain; integers only.
 *
 * A state is a 22-bit probability of a 1 above a 10-bit count of the bits seen; it moves by
 * 1 / (count + 1.6). A mixer weighs the log odds of several states, and learns the weights. A
 * refinement maps the mixed probability through a learned curve that a small context selects.
 */
#ifndef CLGS_ENTROPY_MIX_H
#define CLGS_ENTROPY_MIX_H

#include "entropy/range.h"

_Static_assert((-1 >> 1) == -1, "right shift of negative numbers must be arithmetic");

#define CLGS_ODDS_LIMIT 1536 /* log odds in 1/128 nat, [-1536, 1535]: p from 6e-6 */
#define CLGS_STATE_NEW ((uint32_t)1 << 31)
#define CLGS_WEIGHT_ONE 65536
#define CLGS_WEIGHT_LIMIT (16 * CLGS_WEIGHT_ONE)
#define CLGS_MAX_INPUTS 9
#define CLGS_MIN_PROBABILITY 16
#define CLGS_CURVE_STEP 64 /* log odds between the knots of a curve: half a nat */
#define CLGS_CURVE_KNOTS (2 * CLGS_ODDS_LIMIT / CLGS_CURVE_STEP + 1)

typedef struct clgs_tables {
    int16_t stretch[4096];                /* log odds of (i + 0.5) / 4096 */
    uint16_t squash[2 * CLGS_ODDS_LIMIT]; /* 65536 / (1 + exp(-odds)) */
    uint16_t rate[1024];                  /* 65536 / (count + 1.6) */
} clgs_tables;

typedef struct clgs_mix {
    clgs_range *coder;
    const clgs_tables *tables;
    uint32_t inputs;
    uint32_t limit[CLGS_MAX_INPUTS];
    uint32_t *state[CLGS_MAX_INPUTS];
    int32_t *weight; /* `inputs` of them */
    uint16_t *curve; /* CLGS_CURVE_KNOTS of them, or NULL for none */
    uint32_t shift;  /* the mixer learns with rate 2^-shift */
} clgs_mix;

void clgs_tables_init(clgs_tables *tables);
void clgs_states_init(uint32_t *state, size_t count);
void clgs_weights_init(int32_t *weight, size_t count, uint32_t inputs);
void clgs_curves_init(uint16_t *curve, size_t count, const clgs_tables *tables);

static inline void clgs_state_update(uint32_t *state, uint32_t bit, uint32_t limit,
                                     const uint16_t *rate)
{
    uint32_t count = *state & 1023, p = *state >> 10;
    uint64_t distance = bit ? (1u << 22) - 1 - p : p;
    uint32_t move = (uint32_t)(distance * rate[count] >> 16);
    p = bit ? p + move : p - move;
    *state = p << 10 | (count < limit ? count + 1 : count);
}

static inline int32_t clgs_clamp(int32_t value, int32_t low, int32_t high)
{
    return value < low ? low : value > high ? high : value;
}

/* Code one bit with the states and weights that `mix` points to, and learn from it. */
static inline uint32_t clgs_mix_code(const clgs_mix *mix, uint32_t bit)
{
    const clgs_tables *tables = mix->tables;
    int32_t odds[CLGS_MAX_INPUTS];
    int64_t dot = 0;
    for (uint32_t i = 0; i < mix->inputs; i++) {
        odds[i] = tables->stretch[*mix->state[i] >> 20];
        dot += (int64_t)mix->weight[i] * odds[i];
    }
    int64_t scaled = dot >> 16;
    int32_t sum = scaled < -CLGS_ODDS_LIMIT      ? -CLGS_ODDS_LIMIT
                  : scaled > CLGS_ODDS_LIMIT - 1 ? CLGS_ODDS_LIMIT - 1
                                                 : (int32_t)scaled;
    int32_t mixed = tables->squash[sum + CLGS_ODDS_LIMIT], p = mixed;
    uint16_t *knot = NULL;
    if (mix->curve) {
        uint32_t place = (uint32_t)(sum + CLGS_ODDS_LIMIT), part = place % CLGS_CURVE_STEP;
        knot = mix->curve + place / CLGS_CURVE_STEP;
        p = (p + 3 * (int32_t)((knot[0] * (CLGS_CURVE_STEP - part) + knot[1] * part) /
                               CLGS_CURVE_STEP)) >>
            2;
        knot += part >= CLGS_CURVE_STEP / 2;
    }
    p = clgs_clamp(p, CLGS_MIN_PROBABILITY, 65536 - CLGS_MIN_PROBABILITY);
    bit = clgs_range_code(mix->coder, bit, (uint32_t)p);
    int32_t error = (int32_t)(bit << 16) - mixed;
    for (uint32_t i = 0; i < mix->inputs; i++) {
        int32_t weight = mix->weight[i] + ((odds[i] * error) >> mix->shift);
        mix->weight[i] = clgs_clamp(weight, -CLGS_WEIGHT_LIMIT, CLGS_WEIGHT_LIMIT);
        clgs_state_update(mix->state[i], bit, mix->limit[i], tables->rate);
    }
    if (knot)
        *knot = (uint16_t)(bit ? *knot + ((65535 - *knot) >> 6) : *knot - (*knot >> 6));
    return bit;
}

#endif
