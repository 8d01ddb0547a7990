/* Words byte by byte from the top; each byte in the context of the one above it. */
#include "common/bytes.h"
#include "entropy/mix.h"

#define MODE_RAW 0
#define MODE_CODED 1

#define INPUTS 2
#define LIMIT 250
#define WEIGHT_SHIFT 14

/* Bytes are spelled from the top bit; node = 1 followed by the bits so far. */
typedef struct model {
    clgs_tables tables;
    uint32_t plain[4][256];
    uint32_t joint[4][256][256]; /* also by the byte above; at the top byte, by the last word's */
    int32_t weight[4][256][INPUTS];
} model;

static uint32_t code_byte(model *m, clgs_range *coder, uint32_t plane, uint32_t context,
                          uint32_t byte)
{
    clgs_mix mix = {
        .coder = coder,
        .tables = &m->tables,
        .inputs = INPUTS,
        .limit = {LIMIT, LIMIT},
        .shift = WEIGHT_SHIFT,
    };
    uint32_t node = 1;
    for (uint32_t shift = 8; shift-- > 0;) {
        mix.state[0] = &m->plain[plane][node];
        mix.state[1] = &m->joint[plane][context][node];
        mix.weight = m->weight[plane][node];
        node = node << 1 | clgs_mix_code(&mix, byte >> shift & 1);
    }
    return node & 255;
}

/* Code one word from its top byte; `top` is the top byte of the word before. */
static uint32_t code_word(model *m, clgs_range *coder, uint32_t word, uint32_t top)
{
    uint32_t coded = 0, exponent = top;
    for (uint32_t plane = 0; plane < 4; plane++) {
        uint32_t byte = code_byte(m, coder, plane, exponent, word >> (24 - 8 * plane) & 255);
        coded = coded << 8 | byte;
        if (plane == 0)
            exponent = byte;
        else if (plane == 1)
            exponent = (coded >> 7) & 255;
    }
    return coded;
}

static void model_init(model *m)
{
    clgs_tables_init(&m->tables);
    clgs_states_init(m->plain[0], 4 * 256);
    clgs_states_init(m->joint[0][0], 4 * 256 * 256);
    clgs_weights_init(m->weight[0][0], 4 * 256 * INPUTS, INPUTS);
}

size_t clgs_planes_bound(size_t count)
{
    return count > CLGS_MAX_POINTS ? 0 : 1 + 4 * count;
}

size_t clgs_planes_workspace(void)
{
    return sizeof(model);
}

static size_t encode_coded(model *m, const uint32_t *word, size_t count, uint8_t *out,
                           size_t capacity)
{
    clgs_range coder;
    uint32_t top = 0;
    out[0] = MODE_CODED;
    clgs_range_begin_encode(&coder, out + 1, capacity - 1);
    for (size_t i = 0; i < count && !coder.failed; i++)
        top = code_word(m, &coder, word[i], top) >> 24;
    clgs_range_end_encode(&coder);
    return coder.failed ? 0 : (size_t)(coder.out - out);
}

size_t clgs_planes_encode(const uint32_t *word, size_t count, uint8_t *out, size_t capacity,
                          void *workspace)
{
    size_t bound = clgs_planes_bound(count);
    if (bound == 0 || capacity < bound)
        return 0;
    model_init(workspace);
    size_t size = count > 0 ? encode_coded(workspace, word, count, out, bound) : 0;
    if (size > 0)
        return size;
    out[0] = MODE_RAW;
    for (size_t i = 0; i < count; i++)
        clgs_store32(out + 1 + 4 * i, word[i]);
    return bound;
}

clgs_error clgs_planes_decode(const uint8_t *data, size_t size, uint32_t *word, size_t count,
                              void *workspace)
{
    size_t bound = clgs_planes_bound(count);
    clgs_range coder;
    uint32_t top = 0;
    if (bound == 0)
        return CLGS_ERROR_ARGUMENT;
    if (size < 1)
        return CLGS_ERROR_TRUNCATED;
    if (data[0] == MODE_RAW) {
        if (size != bound)
            return size < bound ? CLGS_ERROR_TRUNCATED : CLGS_ERROR_TRAILING;
        for (size_t i = 0; i < count; i++)
            word[i] = clgs_load32(data + 1 + 4 * i);
        return CLGS_OK;
    }
    if (data[0] != MODE_CODED || count == 0)
        return CLGS_ERROR_CORRUPT;
    model_init(workspace);
    clgs_range_begin_decode(&coder, data + 1, size - 1);
    for (size_t i = 0; i < count && !coder.failed; i++) {
        word[i] = code_word(workspace, &coder, 0, top);
        top = word[i] >> 24;
    }
    return clgs_range_end_decode(&coder);
}
