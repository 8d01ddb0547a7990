/* Range coder and models: decisions with probabilities of the input survive, and end exactly.
 *
 * Two bytes per decision: bit 0 the decision, bit 1: mixed or as it is, the rest the probability or
 * which states are mixed.
 */
#include "entropy/mix.h"
#include "fuzz.h"

#define STATES 16
#define MAX_DECISIONS 2048

typedef struct models {
    clgs_range coder;
    clgs_tables tables;
    uint32_t state[STATES];
    int32_t weight[2 * STATES];
    uint16_t curve[CLGS_CURVE_KNOTS];
} models;

static void begin(models *m)
{
    clgs_tables_init(&m->tables);
    clgs_states_init(m->state, STATES);
    clgs_weights_init(m->weight, 2 * STATES, 2);
    clgs_curves_init(m->curve, CLGS_CURVE_KNOTS, &m->tables);
}

static uint32_t code(models *m, uint32_t choice, uint32_t bit)
{
    uint32_t rest = choice >> 2;
    if (!(choice & 2))
        return clgs_range_code(&m->coder, bit, rest * 4 + 1);
    clgs_mix mix = {
        .coder = &m->coder,
        .tables = &m->tables,
        .inputs = 2,
        .limit = {250, 1000},
        .state = {m->state + rest % STATES, m->state + rest / STATES % STATES},
        .weight = m->weight + 2 * (rest / 256 % STATES),
        .curve = rest & 4096 ? m->curve : NULL,
        .shift = 14,
    };
    return clgs_mix_code(&mix, bit);
}

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size)
{
    static models m;
    uint8_t out[4 * MAX_DECISIONS];
    size_t count = size / 2 < MAX_DECISIONS ? size / 2 : MAX_DECISIONS;
    fuzz_input input = {data, size};
    begin(&m);
    clgs_range_begin_encode(&m.coder, out, sizeof out);
    for (size_t i = 0; i < count; i++) {
        uint32_t choice = fuzz_take(&input, 2);
        code(&m, choice, choice & 1);
    }
    clgs_range_end_encode(&m.coder);
    fuzz_check(!m.coder.failed);
    size_t written = (size_t)(m.coder.out - out);
    input = (fuzz_input){data, size};
    begin(&m);
    clgs_range_begin_decode(&m.coder, out, written);
    for (size_t i = 0; i < count; i++) {
        uint32_t choice = fuzz_take(&input, 2);
        fuzz_check(code(&m, choice & ~1u, 0) == (choice & 1));
    }
    fuzz_check(clgs_range_end_decode(&m.coder) == CLGS_OK);
    return 0;
}
