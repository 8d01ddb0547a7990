/* Points that are encoded come back; points that must be refused are. One byte: how far apart
 * cells lie; then three, six or twelve bytes per point. */
#include "fuzz.h"

static int by_code(const void *a, const void *b)
{
    uint64_t x = *(const uint64_t *)a, y = *(const uint64_t *)b;
    return (x > y) - (x < y);
}

/* Positions of Morton codes, x in bits 3b + 2; `count` is lowered to the different ones. */
static void place(uint64_t *code, size_t *count, const int32_t origin[3], int32_t *position)
{
    size_t unique = 0;
    qsort(code, *count, sizeof *code, by_code);
    for (size_t i = 0; i < *count; i++) {
        if (i > 0 && code[i] == code[i - 1])
            continue;
        for (uint32_t axis = 0; axis < 3; axis++) {
            uint32_t cell = 0;
            for (uint32_t bit = 0; bit < 21; bit++)
                cell |= (uint32_t)(code[i] >> (3 * bit + 2 - axis) & 1) << bit;
            position[3 * unique + axis] = origin[axis] + (int32_t)cell;
        }
        unique++;
    }
    *count = unique;
}

static void round_trip(const int32_t *position, size_t count, const int32_t origin[3])
{
    size_t bound = clgs_octree_bound(count);
    uint8_t *out = fuzz_block(FUZZ_OUTPUT, bound);
    int32_t *decoded = fuzz_block(FUZZ_DECODED, 12 * count);
    void *workspace = fuzz_block(FUZZ_WORKSPACE, clgs_octree_workspace(count));
    size_t size = clgs_octree_encode(position, count, origin, out, bound, workspace);
    fuzz_check(size > 0 && size <= bound);
    fuzz_check(clgs_octree_decode(out, size, decoded, count, workspace) == CLGS_OK);
    fuzz_check(memcmp(position, decoded, 12 * count) == 0);
    if (count > 1) { /* one point twice */
        memcpy(decoded, decoded + 3, 12);
        fuzz_check(clgs_octree_encode(decoded, count, origin, out, bound, workspace) == 0);
    }
}

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size)
{
    fuzz_input input = {data, size};
    uint32_t shape = fuzz_take(&input, 1), low = fuzz_take(&input, 4);
    size_t width = shape % 8 + 1, count = input.size / width;
    uint32_t far = shape & 128 ? 0x7FE00000u : low & 0x3FFFFFFFu;
    const int32_t origin[3] = {(int32_t)far, -(int32_t)far, 0};
    if (count == 0)
        return 0;
    uint64_t *code = fuzz_block(FUZZ_MODEL, 8 * count);
    int32_t *position = fuzz_block(FUZZ_VALUE, 12 * count);
    for (size_t i = 0; i < count; i++) {
        uint64_t bits = fuzz_take(&input, width < 4 ? width : 4);
        bits |= (uint64_t)fuzz_take(&input, width < 4 ? 0 : width - 4) << 32;
        code[i] = bits << (shape / 8 % 16) & (((uint64_t)1 << 63) - 1);
    }
    place(code, &count, origin, position);
    round_trip(position, count, origin);
    return 0;
}
