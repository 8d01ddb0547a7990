/* The tables of the logistic domain, and the states, mixers and refinements of mix.h. */
#include "entropy/mix.h"

#define KNOT_STEP 32 /* log odds between knots: a quarter of a nat */

/* 65536 / (1 + exp(-i / 4)) for i in [-48, 48], within [1, 65535]. */
static const uint16_t SQUASH[2 * CLGS_ODDS_LIMIT / KNOT_STEP + 1] = {
    1,     1,     1,     1,     1,     1,     2,     2,     3,     4,     5,     6,     8,
    10,    13,    17,    22,    28,    36,    47,    60,    77,    98,    126,   162,   208,
    267,   342,   439,   562,   720,   922,   1179,  1506,  1921,  2446,  3108,  3938,  4971,
    6249,  7812,  9702,  11955, 14595, 17625, 21025, 24743, 28693, 32768, 36843, 40793, 44511,
    47911, 50941, 53581, 55834, 57724, 59287, 60565, 61598, 62428, 63090, 63615, 64030, 64357,
    64614, 64816, 64974, 65097, 65194, 65269, 65328, 65374, 65410, 65438, 65459, 65476, 65489,
    65500, 65508, 65514, 65519, 65523, 65526, 65528, 65530, 65531, 65532, 65533, 65534, 65534,
    65535, 65535, 65535, 65535, 65535, 65535,
};

static uint32_t squash(uint32_t place)
{
    uint32_t knot = place / KNOT_STEP, part = place % KNOT_STEP;
    return (SQUASH[knot] * (KNOT_STEP - part) + SQUASH[knot + 1] * part) / KNOT_STEP;
}

void clgs_tables_init(clgs_tables *tables)
{
    uint32_t cell = 0;
    for (uint32_t place = 0; place < 2 * CLGS_ODDS_LIMIT; place++) {
        uint32_t p = squash(place);
        tables->squash[place] = (uint16_t)p;
        for (; cell < 4096 && 16 * cell + 8 <= p; cell++)
            tables->stretch[cell] = (int16_t)((int32_t)place - CLGS_ODDS_LIMIT);
    }
    for (uint32_t count = 0; count < 1024; count++)
        tables->rate[count] = (uint16_t)(655360 / (10 * count + 16));
}

void clgs_states_init(uint32_t *state, size_t count)
{
    for (size_t i = 0; i < count; i++)
        state[i] = CLGS_STATE_NEW;
}

void clgs_weights_init(int32_t *weight, size_t count, uint32_t inputs)
{
    for (size_t i = 0; i < count; i++)
        weight[i] = (int32_t)(CLGS_WEIGHT_ONE / inputs);
}

void clgs_curves_init(uint16_t *curve, size_t count, const clgs_tables *tables)
{
    for (size_t i = 0; i < count; i++) {
        uint32_t place = (uint32_t)(i % CLGS_CURVE_KNOTS) * CLGS_CURVE_STEP;
        if (place == 2 * CLGS_ODDS_LIMIT)
            place--;
        curve[i] = tables->squash[place];
    }
}
