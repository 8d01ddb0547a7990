#include "morton.h"
#include "clgs_codec.h"

clgs_error clgs_morton_encode(const int32_t *position, size_t count, const int32_t origin[3],
                              uint64_t *code)
{
    for (size_t i = 0; i < count; i++) {
        uint64_t interleaved = 0;
        for (int axis = 0; axis < 3; axis++) {
            int64_t cell = (int64_t)position[3 * i + (size_t)axis] - origin[axis];
            if (cell < 0 || cell >= (int64_t)1 << CLGS_MAX_DEPTH)
                return CLGS_ERROR_ARGUMENT;
            interleaved |= clgs_spread((uint64_t)cell) << (2 - axis);
        }
        code[i] = interleaved;
    }
    return CLGS_OK;
}
