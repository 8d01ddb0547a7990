/* Attributes under a model of the input: what can be encoded comes back.
 *
 * One byte of channels, two of the header's length, the header, then values of a byte or four. One
 * byte in 32 asks for long columns, of up to three channels: the rows of the input, again and
 * again.
 */
#include "attributes/columns.h"
#include "fuzz.h"
#include "known.h"

static void round_trip(void *model, const int32_t *value, size_t rows, size_t channels)
{
    size_t bound = clgs_attributes_bound(model, rows, channels);
    uint8_t *out = fuzz_block(FUZZ_OUTPUT, bound);
    int32_t *decoded = fuzz_decoded(model, value, rows, channels);
    void *workspace = fuzz_block(FUZZ_WORKSPACE, clgs_attributes_workspace(rows, channels));
    size_t size = clgs_attributes_encode(model, value, NULL, rows, channels, out, bound, workspace);
    fuzz_check(size <= bound);
    if (size > 0) { /* 0: a symbol that the tables lack, or all channels are known */
        fuzz_check(
            !clgs_attributes_decode(model, out, size, decoded, NULL, rows, channels, workspace));
        fuzz_check(memcmp(value, decoded, 4 * rows * channels) == 0);
    }
}

static int32_t take_value(fuzz_input *input, uint32_t wide)
{
    uint32_t bits = fuzz_take(input, wide ? 4 : 1);
    if (!wide)
        return (int32_t)bits - 128;
    return bits >> 31 ? -(int32_t)~bits - 1 : (int32_t)bits;
}

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size)
{
    fuzz_input input = {data, size};
    uint32_t shape = fuzz_take(&input, 1);
    size_t channels = fuzz_channels(shape), length = fuzz_take(&input, 2),
           width = shape & 128 ? 4 : 1;
    if (length > input.size)
        length = input.size;
    size_t given = (input.size - length) / (width * channels), rows = given;
    if ((shape >> 2 & 31) == 31 && given > 0 && channels < 4)
        rows += CLGS_LONG_ROWS;
    size_t model_size = clgs_attributes_model_size(channels);
    void *model = fuzz_block(FUZZ_MODEL, model_size);
    void *workspace = fuzz_block(FUZZ_WORKSPACE, clgs_attributes_header_workspace());
    int32_t *value = fuzz_block(FUZZ_VALUE, 4 * rows * channels);
    memset(model, 0, model_size);
    const uint8_t *header = input.at;
    input = (fuzz_input){header + length, input.size - length};
    for (size_t i = 0; i < rows * channels; i++)
        value[i] =
            i < given * channels ? take_value(&input, shape & 128) : value[i - given * channels];
    if (clgs_attributes_header_read(header, length, model, channels, workspace) == CLGS_OK &&
        rows > 0)
        round_trip(model, value, rows, channels);
    return 0;
}
