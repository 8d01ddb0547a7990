/* The wide range coder: what is encoded comes back and ends exactly; any bytes can be decoded.
 *
 * Two bytes per step: bit 0: a decision with a probability, or bits without; the rest says which.
 */
#include "entropy/wide_range.h"
#include "fuzz.h"

#define MAX_STEPS 256

/* Code one step; returns the decision or the bits. */
static uint32_t code(clgs_wide *coder, uint32_t step, uint32_t value, int decoding)
{
    if (step & 1)
        return clgs_wide_code(coder, value & 1, (step >> 1) * 2 + 1, decoding);
    uint32_t bits = (step >> 1) % CLGS_WIDE_PLAIN + 1;
    return clgs_wide_plain(coder, value & ((1u << bits) - 1), bits, decoding);
}

static uint32_t value_of(uint32_t step)
{
    return step * 40503u >> 8;
}

static void round_trip(const uint16_t *step, size_t steps)
{
    uint8_t *out = fuzz_block(FUZZ_OUTPUT, 2 * steps + 8);
    clgs_wide coder;
    clgs_wide_begin_encode(&coder, out, 2 * steps + 8);
    for (size_t i = 0; i < steps; i++)
        code(&coder, step[i], value_of(step[i]), 0);
    clgs_wide_end_encode(&coder);
    fuzz_check(!coder.failed);
    clgs_wide_begin_decode(&coder, out, (size_t)(coder.out - out));
    for (size_t i = 0; i < steps; i++) {
        uint32_t bits = step[i] & 1 ? 1 : (step[i] >> 1) % CLGS_WIDE_PLAIN + 1;
        uint32_t expected = value_of(step[i]) & ((1u << bits) - 1);
        fuzz_check(code(&coder, step[i], 0, 1) == expected);
    }
    fuzz_check(clgs_wide_end_decode(&coder) == CLGS_OK);
}

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size)
{
    uint16_t step[MAX_STEPS];
    size_t steps = size / 2 < MAX_STEPS ? size / 2 : MAX_STEPS;
    fuzz_input input = {data, size};
    clgs_wide coder;
    for (size_t i = 0; i < steps; i++)
        step[i] = (uint16_t)fuzz_take(&input, 2);
    round_trip(step, steps);
    clgs_wide_begin_decode(&coder, data, size);
    for (size_t i = 0; i < steps && !coder.failed; i++)
        code(&coder, step[i], 0, 1);
    clgs_wide_end_decode(&coder);
    return 0;
}
