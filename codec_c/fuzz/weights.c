/* Weights as integers, the MLP section: one byte of layers, two bytes each for them, the stream. */
#include "fuzz.h"

#define MAX_LAYERS 3

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size)
{
    fuzz_input input = {data, size};
    clgs_layer layer[MAX_LAYERS];
    size_t layers = fuzz_take(&input, 1) % MAX_LAYERS + 1, count = 0;
    for (size_t i = 0; i < layers; i++) {
        layer[i].rows = fuzz_take(&input, 1) % 32 + 1;
        layer[i].columns = fuzz_take(&input, 1) % 32 + 1;
        count += (size_t)layer[i].rows * layer[i].columns;
    }
    uint32_t *word = fuzz_block(FUZZ_VALUE, 4 * count);
    uint32_t *again = fuzz_block(FUZZ_DECODED, 4 * count);
    size_t bound = clgs_weights_bound(layer, layers);
    uint8_t *out = fuzz_block(FUZZ_OUTPUT, bound);
    void *workspace = fuzz_block(FUZZ_WORKSPACE, clgs_weights_workspace(layer, layers));
    if (clgs_weights_decode(input.at, input.size, word, layer, layers, workspace) == CLGS_OK) {
        size_t written = clgs_weights_encode(word, layer, layers, out, bound, workspace);
        fuzz_check(written > 0 && written <= bound);
        fuzz_check(!clgs_weights_decode(out, written, again, layer, layers, workspace));
        fuzz_check(memcmp(word, again, 4 * count) == 0);
    }
    return 0;
}
