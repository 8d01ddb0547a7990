/* Octree streams of all modes: two bytes of count, then the stream. */
#include "fuzz.h"

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size)
{
    fuzz_input input = {data, size};
    size_t count = fuzz_take_count(&input, 512, 4096) + 1;
    int32_t *position = fuzz_block(FUZZ_VALUE, 12 * count);
    void *workspace = fuzz_block(FUZZ_WORKSPACE, clgs_octree_workspace(count));
    clgs_octree_decode(input.at, input.size, position, count, workspace);
    return 0;
}
