/* Streams of byte planes, the MLP section: two bytes of count, then the stream. */
#include "fuzz.h"

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size)
{
    fuzz_input input = {data, size};
    size_t count = fuzz_take_count(&input, 128, 1024);
    uint32_t *word = fuzz_block(FUZZ_VALUE, 4 * count);
    void *workspace = fuzz_block(FUZZ_WORKSPACE, clgs_planes_workspace());
    clgs_planes_decode(input.at, input.size, word, count, workspace);
    return 0;
}
