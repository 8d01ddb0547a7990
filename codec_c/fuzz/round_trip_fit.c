/* Attributes under any predictions and activity, with the encoder's own tables: the header comes
 * back as it was written, and so do the values.
 *
 * One byte of channels, how wide values are, and whether there are near rows; fields of each
 * channel; values of a byte or four.
 */
#include "attributes/model.h"
#include "fuzz.h"
#include "known.h"

#define MAX_CHANNELS 2
#define SCALE_ONE 256
#define MIXED_ROWS 32 /* mixed channels take ten times as long */

static int32_t take_below(fuzz_input *input, uint32_t limit)
{
    return (int32_t)(fuzz_take(input, 2) % limit);
}

static int32_t take_value(fuzz_input *input, uint32_t wide)
{
    uint32_t bits = fuzz_take(input, wide ? 4 : 1);
    if (!wide)
        return (int32_t)bits - 128;
    return bits >> 31 ? -(int32_t)~bits - 1 : (int32_t)bits;
}

/* Terms of channel j: of itself from rows above, of earlier ones from rows around. */
static void take_taps(fuzz_input *input, clgs_channel *channel, int32_t j)
{
    channel->taps = (int32_t)(fuzz_take(input, 1) % (CLGS_TAPS + 1));
    for (int32_t t = 0; t < channel->taps; t++) {
        uint32_t place = fuzz_take(input, 1);
        clgs_tap *tap = channel->tap + t;
        tap->channel = (int32_t)place % (j + 1);
        tap->row = (int32_t)(place >> 2) % (CLGS_TAP_REACH + 1 - CLGS_TAP_NEAR) + CLGS_TAP_NEAR;
        if (tap->channel == j && tap->row >= 0)
            tap->row = -1;
        tap->factor = take_below(input, 2 * CLGS_MAX_FACTOR + 1) - CLGS_MAX_FACTOR;
    }
}

/* Sided, if no term is of the channel itself. */
static void take_side(clgs_channel *channel, int32_t j)
{
    int sided = channel->taps > 0;
    for (int32_t t = 0; t < channel->taps; t++)
        sided &= channel->tap[t].channel < j;
    if (!sided)
        return;
    channel->coder = CLGS_SIDED;
    memset(channel->weight, 0, sizeof channel->weight);
}

static void take_channel(fuzz_input *input, clgs_channel *channel, int32_t j)
{
    uint32_t kind = fuzz_take(input, 1);
    channel->coder = (kind & 7) == 7 ? CLGS_MIXED : (kind & 7) == 6 ? CLGS_KNOWN : CLGS_STATIC;
    channel->span = (int32_t)(kind >> 3 & 3) % ((j < CLGS_MAX_SPAN ? j : CLGS_MAX_SPAN) + 1);
    channel->classes = 1;
    channel->frequency[0][0] = CLGS_SCALE;
    channel->centre = take_value(input, kind & 128);
    channel->gain = take_below(input, CLGS_MAX_GAIN + 1);
    for (int k = 0; k < 3; k++)
        channel->weight[k] = take_below(input, CLGS_MAX_WEIGHT + 1);
    if (kind & 64 && channel->coder != CLGS_KNOWN)
        take_taps(input, channel, j);
    if ((kind & 7) == 5)
        take_side(channel, j);
}

/* Tables from the values; mixed channels have none, and known ones are not given any. */
static void fit(clgs_channel *model, const int32_t *value, const int32_t *near, size_t rows,
                size_t channels)
{
    size_t size = sizeof(uint32_t) * channels * CLGS_CELLS * CLGS_TABLE;
    uint32_t *count = fuzz_block(FUZZ_OUTPUT, size);
    uint64_t cost[MAX_CHANNELS];
    memset(count, 0, size);
    void *workspace = fuzz_block(FUZZ_WORKSPACE, clgs_attributes_workspace(rows, channels));
    fuzz_check(!clgs_attributes_count(model, value, near, rows, channels, count, workspace));
    workspace = fuzz_block(FUZZ_WORKSPACE, clgs_attributes_choose_workspace());
    fuzz_check(!clgs_attributes_choose(model, channels, count, SCALE_ONE, cost, workspace));
    for (size_t j = 0; j < channels; j++)
        fuzz_check(model[j].coder != CLGS_KNOWN || cost[j] == 0);
    for (size_t j = 0; j < channels; j++)
        if (model[j].coder == CLGS_MIXED) {
            model[j].classes = 1;
            memset(model[j].class_of, 0, sizeof model[j].class_of);
            memset(model[j].frequency, 0, sizeof model[j].frequency);
        }
}

static void check_header(clgs_channel *model, size_t channels)
{
    size_t size = channels * sizeof *model, bound = clgs_attributes_header_bound(channels);
    clgs_channel *again = fuzz_block(FUZZ_DECODED, size);
    uint8_t *out = fuzz_block(FUZZ_OUTPUT, bound);
    void *workspace = fuzz_block(FUZZ_WORKSPACE, clgs_attributes_header_workspace());
    size_t written = clgs_attributes_header_write(model, channels, out, bound, workspace);
    fuzz_check(written > 0);
    fuzz_check(!clgs_attributes_header_read(out, written, again, channels, workspace));
    fuzz_check(clgs_model_valid(again, channels));
    fuzz_check(memcmp(model, again, size) == 0);
}

static void check_measure(const clgs_channel *model, const int32_t *value, const int32_t *near,
                          size_t rows, size_t channels)
{
    uint64_t measured[MAX_CHANNELS] = {0};
    void *workspace = fuzz_block(FUZZ_WORKSPACE, clgs_attributes_workspace(rows, channels));
    uint8_t *out = fuzz_block(FUZZ_OUTPUT, clgs_attributes_measure_bound(rows));
    fuzz_check(
        !clgs_attributes_measure(model, value, near, rows, channels, measured, out, workspace));
    for (size_t j = 0; j < channels; j++)
        fuzz_check((measured[j] > 0) == (model[j].coder == CLGS_MIXED));
}

static void check_chunk(const clgs_channel *model, const int32_t *value, const int32_t *near,
                        size_t rows, size_t channels)
{
    size_t bound = clgs_attributes_bound(model, rows, channels);
    uint8_t *out = fuzz_block(FUZZ_OUTPUT, bound);
    int32_t *decoded = fuzz_decoded(model, value, rows, channels);
    void *workspace = fuzz_block(FUZZ_WORKSPACE, clgs_attributes_workspace(rows, channels));
    size_t size = clgs_attributes_encode(model, value, near, rows, channels, out, bound, workspace);
    fuzz_check((size > 0) == (fuzz_known_channels(model, channels) < channels));
    fuzz_check(size <= bound);
    workspace = fuzz_block(FUZZ_WORKSPACE, clgs_attributes_workspace(rows, channels));
    fuzz_check(!clgs_attributes_decode(model, out, size, decoded, near, rows, channels, workspace));
    fuzz_check(memcmp(value, decoded, 4 * rows * channels) == 0);
}

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size)
{
    fuzz_input input = {data, size};
    uint32_t shape = fuzz_take(&input, 1);
    size_t channels = shape % MAX_CHANNELS + 1, width = shape & 128 ? 4 : 1;
    clgs_channel *model = fuzz_block(FUZZ_MODEL, clgs_attributes_model_size(channels));
    memset(model, 0, clgs_attributes_model_size(channels));
    for (size_t j = 0; j < channels; j++)
        take_channel(&input, model + j, (int32_t)j);
    size_t rows = input.size / (width * channels);
    for (size_t j = 0; j < channels; j++)
        if (model[j].coder == CLGS_MIXED && rows > MIXED_ROWS)
            rows = MIXED_ROWS;
    if (rows == 0)
        return 0;
    int32_t *value = fuzz_block(FUZZ_VALUE, 4 * rows * channels);
    for (size_t i = 0; i < rows * channels; i++)
        value[i] = take_value(&input, shape & 128);
    const int32_t *near = shape & 32 ? fuzz_near(rows) : NULL;
    fit(model, value, near, rows, channels);
    check_header(model, channels);
    if (shape & 64)
        check_measure(model, value, near, rows, channels);
    check_chunk(model, value, near, rows, channels);
    return 0;
}
