/* Run-length streams of version 1: two bytes of rows, one of channels, then the stream. */
#include "fuzz.h"

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size)
{
    fuzz_input input = {data, size};
    size_t rows = fuzz_take_count(&input, 256, 1024), channels = fuzz_take(&input, 1) % 11 + 1;
    int32_t *value = fuzz_block(FUZZ_VALUE, 4 * rows * channels);
    void *workspace = fuzz_block(FUZZ_WORKSPACE, clgs_runlength_workspace(channels));
    clgs_runlength_decode(input.at, input.size, value, rows, channels, workspace);
    return 0;
}
