/* Near rows of points in any order: those that a look at all earlier rows finds.
 *
 * One byte of how far apart points are; three bytes a point.
 */
#include "fuzz.h"

static int64_t distance_of(const int32_t *a, const int32_t *b)
{
    int64_t sum = 0;
    for (int axis = 0; axis < 3; axis++)
        sum += ((int64_t)a[axis] - b[axis]) * ((int64_t)a[axis] - b[axis]);
    return sum;
}

/* Earlier rows that come before row `k` among the near rows of row i. */
static size_t rank_of(const int32_t *position, size_t i, size_t k)
{
    int64_t mine = distance_of(position + 3 * i, position + 3 * k);
    size_t before = 0;
    for (size_t other = 0; other < i; other++) {
        int64_t its = distance_of(position + 3 * i, position + 3 * other);
        before += its < mine || (its == mine && other > k);
    }
    return before;
}

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size)
{
    fuzz_input input = {data, size};
    uint32_t shift = fuzz_take(&input, 1) % 13;
    size_t rows = input.size / 3;
    int32_t *position = fuzz_block(FUZZ_VALUE, 12 * rows);
    int32_t *near = fuzz_block(FUZZ_NEAR, 4 * CLGS_NEAR * rows);
    for (size_t i = 0; i < 3 * rows; i++)
        position[i] = (int32_t)(fuzz_take(&input, 1) << shift) - (1 << 20);
    void *workspace = fuzz_block(FUZZ_WORKSPACE, clgs_near_workspace(rows));
    fuzz_check(!clgs_near(position, rows, near, workspace));
    for (size_t i = 0; i < rows; i++)
        for (size_t k = 0; k < CLGS_NEAR; k++) {
            int32_t row = near[CLGS_NEAR * i + k];
            fuzz_check(k < i ? row >= 0 && (size_t)row < i : row == -1);
            fuzz_check(row < 0 || rank_of(position, i, (size_t)row) == k);
        }
    return 0;
}
