/* Streams of the plain run-length coder: two bytes of rows, one of channels, then the stream. */
#include "fuzz.h"

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size)
{
    fuzz_input input = {data, size};
    size_t rows = fuzz_take_count(&input, 512, 4096), channels = fuzz_take(&input, 1) % 9 + 1;
    int32_t *value = fuzz_block(FUZZ_VALUE, 4 * rows * channels);
    clgs_paper_decode(input.at, input.size, value, rows, channels);
    return 0;
}
