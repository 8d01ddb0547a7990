/* Octree streams of all modes: two bytes of count, then the stream. */
#include "fuzz.h"

#define MAX_POINTS 4096

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size)
{
    fuzz_input input = {data, size};
    size_t count = fuzz_take(&input, 2) % MAX_POINTS + 1;
    int32_t *position = fuzz_allocate(12 * count);
    void *workspace = fuzz_workspace(clgs_octree_workspace(count));
    clgs_octree_decode(input.at, input.size, position, count, workspace);
    free(position);
    return 0;
}
