/* Attributes: two bytes of rows, one of channels, two of the header's length, header, chunk. */
#include "fuzz.h"

static void decode(void *model, fuzz_input chunk, size_t rows, size_t channels)
{
    int32_t *value = fuzz_allocate(4 * rows * channels);
    void *workspace = fuzz_workspace(clgs_attributes_workspace(rows, channels));
    clgs_attributes_decode(model, chunk.at, chunk.size, value, rows, channels, workspace);
    free(value);
}

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size)
{
    fuzz_input input = {data, size};
    size_t rows = fuzz_take(&input, 2) % 1024 + 1, channels = fuzz_take(&input, 1) % 4 + 1;
    size_t length = fuzz_take(&input, 2);
    if (length > input.size)
        length = input.size;
    size_t model_size = clgs_attributes_model_size(channels);
    void *model = fuzz_allocate(model_size);
    void *workspace = fuzz_allocate(clgs_attributes_header_workspace());
    memset(model, 0, model_size);
    fuzz_input chunk = {input.at + length, input.size - length};
    if (clgs_attributes_header_read(input.at, length, model, channels, workspace) == CLGS_OK)
        decode(model, chunk, rows, channels);
    free(workspace);
    free(model);
    return 0;
}
