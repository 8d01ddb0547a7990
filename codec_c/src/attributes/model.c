/* The header of attributes: one decision stream for the models of all channels. */
#include <string.h>

#include "attributes/model.h"
#include "entropy/symbol.h"

#define MODE_MODEL 1
#define LIMIT 250 /* states of the header */

/* Bytes at most: a decision costs 12 bits. A number of 32 bits has 36 of them and 28 plain bits, a
 * frequency 18 and 9. Before its tables a channel has 57 numbers, then a decision per cell. */
#define NUMBER_MOST 62
#define FREQUENCY_MOST 29
#define TABLES_MOST (2 * CLGS_CELLS + FREQUENCY_MOST * CLGS_CLASSES * CLGS_ALPHABET)

/* What a number of the header is; each kind has states of its own. */
enum {
    FIELD_PLAIN,
    FIELD_CENTRE,
    FIELD_TAPS,
    FIELD_TAP_CHANNEL,
    FIELD_TAP_ROW,
    FIELD_TAP_FACTOR,
    FIELD_GAIN,
    FIELD_WEIGHT,
    FIELD_SPAN = FIELD_WEIGHT + 3,
    FIELD_CODER,
    FIELD_CLASS,
    FIELD_FREQUENCY, /* + bits of the expected one */
    FIELDS = FIELD_FREQUENCY + CLGS_SCALE_BITS + 2
};

typedef struct header {
    clgs_range coder;
    clgs_tables tables;
    uint32_t state[FIELDS][CLGS_NODES];
    int32_t weight[FIELDS][CLGS_NODES];
    int failed;
} header;

static clgs_symbol field_symbol(header *h, uint32_t field)
{
    return (clgs_symbol){
        .mix =
            {.coder = &h->coder, .tables = &h->tables, .inputs = 1, .limit = {LIMIT}, .shift = 14},
        .base = {h->state[field]},
        .weight = h->weight[field],
    };
}

static int32_t code_number(header *h, uint32_t field, int32_t value)
{
    clgs_symbol symbol = field_symbol(h, field);
    int64_t number = clgs_symbol_value(&symbol, value);
    if (number < INT32_MIN || number > INT32_MAX) {
        h->failed = 1;
        return 0;
    }
    return (int32_t)number;
}

/* A number that must lie in [low, high]; if it does not, `low` and a failure. */
static int32_t code_within(header *h, uint32_t field, int32_t value, int32_t low, int32_t high)
{
    value = code_number(h, field, value);
    if (value >= low && value <= high)
        return value;
    h->failed = 1;
    return low;
}

static void code_taps(header *h, clgs_channel *channel, int32_t j)
{
    channel->taps = code_within(h, FIELD_TAPS, channel->taps, 0, CLGS_TAPS);
    for (int32_t t = 0; t < channel->taps; t++) {
        clgs_tap *tap = channel->tap + t;
        int32_t back = code_within(h, FIELD_TAP_CHANNEL, j - tap->channel, 0, j);
        int32_t last = back == 0 ? -1 : CLGS_TAP_REACH;
        tap->channel = j - back;
        tap->row = code_within(h, FIELD_TAP_ROW, tap->row, CLGS_TAP_NEAR, last);
        tap->factor =
            code_within(h, FIELD_TAP_FACTOR, tap->factor, -CLGS_MAX_FACTOR, CLGS_MAX_FACTOR);
    }
}

/* Whether a cell can occur; the upper half needs a span. */
static int reachable(const clgs_channel *channel, uint32_t cell)
{
    return (clgs_has_levels(channel) || cell % CLGS_LEVELS == 0) &&
           (channel->span > 0 || cell < CLGS_LEVELS);
}

/* Which cells start a class; cells that cannot occur have class 0. */
static void code_classes(header *h, clgs_channel *channel)
{
    clgs_symbol symbol = field_symbol(h, FIELD_CLASS);
    uint32_t last = 0;
    for (uint32_t cell = 1; cell < CLGS_CELLS; cell++) {
        uint32_t own = channel->class_of[cell];
        channel->class_of[cell] = 0;
        if (!reachable(channel, cell))
            continue;
        last += clgs_symbol_bit(&symbol, CLGS_NODE_ZERO, own != last);
        if (last >= CLGS_CLASSES) {
            h->failed = 1;
            last = CLGS_CLASSES - 1;
        }
        channel->class_of[cell] = (uint8_t)last;
    }
    channel->class_of[0] = 0;
    channel->classes = (int32_t)last + 1;
}

/* The frequency to expect: that of the same size with the other sign, or a geometric decay. */
static uint32_t expected(const uint16_t *frequency, uint32_t symbol)
{
    if (symbol == 0)
        return 0;
    if (symbol % 2 == 0 || symbol == 1)
        return frequency[symbol - 1];
    uint32_t last = (uint32_t)frequency[symbol - 1] + frequency[symbol - 2];
    uint32_t before = (uint32_t)frequency[symbol - 3] + frequency[symbol > 3 ? symbol - 4 : 0];
    return (before > last ? last * last / before : last) / 2;
}

static void code_frequencies(header *h, uint16_t *frequency)
{
    uint32_t left = CLGS_SCALE;
    for (uint32_t s = 0; s < CLGS_ALPHABET && left > 0; s++) {
        uint32_t guess = expected(frequency, s), bits = 0;
        guess = guess < left ? guess : left;
        while (guess >> bits)
            bits++;
        int32_t off = code_within(h, FIELD_FREQUENCY + bits, (int32_t)frequency[s] - (int32_t)guess,
                                  -(int32_t)guess, (int32_t)(left - guess));
        frequency[s] = (uint16_t)((int32_t)guess + off);
        left -= frequency[s];
    }
    h->failed |= left != 0;
}

static int is_plain(const clgs_channel *channel)
{
    return channel->taps == 0 && channel->gain == 0 && channel->weight[0] == 0 &&
           channel->weight[1] == 0 && channel->weight[2] == 0 && channel->span == 0 &&
           channel->coder == CLGS_STATIC;
}

static void code_channel(header *h, clgs_channel *channel, int32_t j)
{
    channel->centre = code_number(h, FIELD_CENTRE, channel->centre);
    if (!code_within(h, FIELD_PLAIN, !is_plain(channel), 0, 1)) {
        channel->classes = 1;
        code_frequencies(h, channel->frequency[0]);
        return;
    }
    code_taps(h, channel, j);
    channel->gain = code_within(h, FIELD_GAIN, channel->gain, 0, CLGS_MAX_GAIN);
    for (uint32_t i = 0; i < 3; i++)
        channel->weight[i] =
            code_within(h, FIELD_WEIGHT + i, channel->weight[i], 0, CLGS_MAX_WEIGHT);
    channel->span =
        code_within(h, FIELD_SPAN, channel->span, 0, j < CLGS_MAX_SPAN ? j : CLGS_MAX_SPAN);
    channel->coder = code_within(h, FIELD_CODER, channel->coder, CLGS_STATIC, CLGS_SIDED);
    if (!clgs_has_tables(channel)) {
        channel->classes = 1;
        return;
    }
    code_classes(h, channel);
    for (int32_t k = 0; k < channel->classes; k++)
        code_frequencies(h, channel->frequency[k]);
}

static int code_channels(header *h, clgs_channel *channel, size_t channels)
{
    clgs_tables_init(&h->tables);
    clgs_states_init(h->state[0], (size_t)FIELDS * CLGS_NODES);
    clgs_weights_init(h->weight[0], (size_t)FIELDS * CLGS_NODES, 1);
    h->failed = 0;
    for (size_t j = 0; j < channels && !h->failed; j++)
        code_channel(h, channel + j, (int32_t)j);
    return !h->failed;
}

size_t clgs_attributes_model_size(size_t channels)
{
    return channels >= 1 && channels <= CLGS_MAX_CHANNELS ? channels * sizeof(clgs_channel) : 0;
}

size_t clgs_attributes_header_bound(size_t channels)
{
    int fits = channels >= 1 && channels <= CLGS_MAX_CHANNELS;
    return fits ? 8 + channels * (57 * NUMBER_MOST + TABLES_MOST) : 0;
}

size_t clgs_attributes_header_workspace(void)
{
    return sizeof(header);
}

size_t clgs_attributes_header_write(void *model, size_t channels, uint8_t *out, size_t capacity,
                                    void *workspace)
{
    header *h = workspace;
    if (clgs_attributes_model_size(channels) == 0 || capacity < 1)
        return 0;
    out[0] = MODE_MODEL;
    clgs_range_begin_encode(&h->coder, out + 1, capacity - 1);
    if (!code_channels(h, model, channels) || !clgs_model_valid(model, channels))
        return 0;
    clgs_range_end_encode(&h->coder);
    return h->coder.failed ? 0 : (size_t)(h->coder.out - out);
}

clgs_error clgs_attributes_header_read(const uint8_t *data, size_t size, void *model,
                                       size_t channels, void *workspace)
{
    header *h = workspace;
    size_t model_size = clgs_attributes_model_size(channels);
    if (model_size == 0)
        return CLGS_ERROR_ARGUMENT;
    if (size < 1)
        return CLGS_ERROR_TRUNCATED;
    if (data[0] != MODE_MODEL)
        return CLGS_ERROR_CORRUPT;
    memset(model, 0, model_size);
    clgs_range_begin_decode(&h->coder, data + 1, size - 1);
    if (!code_channels(h, model, channels) || !clgs_model_valid(model, channels))
        return h->coder.failed ? CLGS_ERROR_TRUNCATED : CLGS_ERROR_CORRUPT;
    return clgs_range_end_decode(&h->coder);
}

int clgs_attributes_known(const void *model, size_t channels)
{
    const clgs_channel *channel = model;
    size_t known[2] = {0}, sided = 0; /* known: of even and of odd number */
    for (size_t j = 0; j < channels; j++) {
        known[j % 2] += channel[j].coder == CLGS_KNOWN;
        sided += channel[j].coder == CLGS_SIDED;
    }
    if (known[0] + known[1] == 0)
        return sided ? -1 : 0;
    return known[0] == (channels + 1) / 2 && known[1] == 0 ? 1 : -1;
}

static int within(int32_t value, int32_t low, int32_t high)
{
    return value >= low && value <= high;
}

static int taps_valid(const clgs_channel *channel, int32_t j)
{
    if (!within(channel->taps, 0, CLGS_TAPS))
        return 0;
    for (int32_t t = 0; t < channel->taps; t++) {
        const clgs_tap *tap = channel->tap + t;
        if (!within(tap->channel, 0, j) ||
            !within(tap->row, CLGS_TAP_NEAR, tap->channel == j ? -1 : CLGS_TAP_REACH) ||
            !within(tap->factor, -CLGS_MAX_FACTOR, CLGS_MAX_FACTOR))
            return 0;
    }
    return 1;
}

/* Sided channels look at others alone, so that a decoder knows their terms before their symbols. */
static int sided_valid(const clgs_channel *channel, int32_t j)
{
    if (channel->taps == 0 || channel->weight[0] || channel->weight[1] || channel->weight[2])
        return 0;
    for (int32_t t = 0; t < channel->taps; t++)
        if (channel->tap[t].channel == j)
            return 0;
    return 1;
}

static int tables_valid(const clgs_channel *channel, int32_t j)
{
    if (channel->coder == CLGS_MIXED)
        return channel->classes == 1;
    if (channel->coder == CLGS_KNOWN)
        return channel->classes == 1 && channel->taps == 0;
    if (channel->coder == CLGS_SIDED && !sided_valid(channel, j))
        return 0;
    if (!clgs_has_tables(channel) || !within(channel->classes, 1, CLGS_CLASSES))
        return 0;
    for (uint32_t cell = 0; cell < CLGS_CELLS; cell++)
        if (channel->class_of[cell] >= channel->classes)
            return 0;
    for (int32_t k = 0; k < channel->classes; k++) {
        uint32_t sum = 0;
        for (uint32_t s = 0; s < CLGS_ALPHABET; s++)
            sum += channel->frequency[k][s];
        if (sum != CLGS_SCALE)
            return 0;
    }
    return 1;
}

int clgs_model_valid(const clgs_channel *channel, size_t channels)
{
    for (size_t j = 0; j < channels; j++) {
        const clgs_channel *c = channel + j;
        int32_t before = (int32_t)j;
        if (!taps_valid(c, before) || !within(c->gain, 0, CLGS_MAX_GAIN) ||
            !within(c->weight[0], 0, CLGS_MAX_WEIGHT) ||
            !within(c->weight[1], 0, CLGS_MAX_WEIGHT) ||
            !within(c->weight[2], 0, CLGS_MAX_WEIGHT) ||
            !within(c->span, 0, before < CLGS_MAX_SPAN ? before : CLGS_MAX_SPAN) ||
            !tables_valid(c, before))
            return 0;
    }
    return 1;
}
