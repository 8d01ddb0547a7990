/* Known channels, whose values are there before a chunk is decoded. */
#ifndef CLGS_FUZZ_KNOWN_H
#define CLGS_FUZZ_KNOWN_H

#include "attributes/model.h"
#include "fuzz.h"

static inline size_t fuzz_known_channels(const clgs_channel *model, size_t channels)
{
    size_t known = 0;
    for (size_t j = 0; j < channels; j++)
        known += model[j].coder == CLGS_KNOWN;
    return known;
}

/* A block to decode to: `value` in known channels, 0 in others; without known ones, as new. */
static inline int32_t *fuzz_decoded(const clgs_channel *model, const int32_t *value, size_t rows,
                                    size_t channels)
{
    int32_t *decoded = fuzz_block(FUZZ_DECODED, 4 * rows * channels);
    if (fuzz_known_channels(model, channels) > 0)
        for (size_t i = 0; i < rows * channels; i++)
            decoded[i] = model[i % channels].coder == CLGS_KNOWN ? value[i] : 0;
    return decoded;
}

#endif
