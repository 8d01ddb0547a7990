/* Attributes: two bytes of rows, one of channels and whether there are near rows, two of the
 * header's length, header, chunk. */
#include "fuzz.h"
#include "known.h"

/* Values of any size for known channels, the same for every input. */
static const int32_t *known_values(const clgs_channel *model, size_t rows, size_t channels)
{
    int32_t *value = fuzz_block(FUZZ_VALUE, 4 * rows * channels);
    if (fuzz_known_channels(model, channels) > 0)
        for (size_t i = 0; i < rows * channels; i++)
            value[i] = (int32_t)((uint32_t)i * 2654435761u >> i % 32) - (int32_t)(i % 5);
    return value;
}

static void decode(void *model, fuzz_input chunk, const int32_t *near, size_t rows, size_t channels)
{
    const int32_t *known = known_values(model, rows, channels);
    int32_t *value = fuzz_decoded(model, known, rows, channels);
    void *workspace = fuzz_block(FUZZ_WORKSPACE, clgs_attributes_workspace(rows, channels));
    clgs_attributes_decode(model, chunk.at, chunk.size, value, near, rows, channels, workspace);
}

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size)
{
    fuzz_input input = {data, size};
    size_t rows = fuzz_take_count(&input, 256, 4096) + 1;
    uint32_t shape = fuzz_take(&input, 1);
    size_t channels = fuzz_channels(shape);
    size_t length = fuzz_take(&input, 2);
    if (length > input.size)
        length = input.size;
    size_t model_size = clgs_attributes_model_size(channels);
    void *model = fuzz_block(FUZZ_MODEL, model_size);
    void *workspace = fuzz_block(FUZZ_WORKSPACE, clgs_attributes_header_workspace());
    memset(model, 0, model_size);
    fuzz_input chunk = {input.at + length, input.size - length};
    if (clgs_attributes_header_read(input.at, length, model, channels, workspace) == CLGS_OK)
        decode(model, chunk, shape & 4 ? fuzz_near(rows) : NULL, rows, channels);
    return 0;
}
