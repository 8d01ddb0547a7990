/* What is encoded comes back: rows by both run-length coders, words by planes.
 *
 * One byte: coder, channels and how wide the values are; then the values, one to four bytes each.
 */
#include "fuzz.h"

typedef struct matrix {
    size_t rows, channels, size; /* size: bytes of the values */
    int32_t *value, *decoded;
} matrix;

static void check_same(const matrix *m)
{
    fuzz_check(m->size == 0 || memcmp(m->value, m->decoded, m->size) == 0);
}

static void runlength(const matrix *m)
{
    size_t bound = clgs_runlength_bound(m->rows, m->channels);
    uint8_t *out = fuzz_block(FUZZ_OUTPUT, bound);
    void *workspace = fuzz_block(FUZZ_WORKSPACE, clgs_runlength_workspace(m->channels));
    size_t size = clgs_runlength_encode(m->value, m->rows, m->channels, out, bound, workspace);
    fuzz_check(size > 0 && size <= bound);
    fuzz_check(!clgs_runlength_decode(out, size, m->decoded, m->rows, m->channels, workspace));
    check_same(m);
}

static void paper(const matrix *m)
{
    size_t bound = clgs_paper_bound(m->rows, m->channels);
    uint8_t *out = fuzz_block(FUZZ_OUTPUT, bound);
    size_t size = clgs_paper_encode(m->value, m->rows, m->channels, out, bound);
    fuzz_check(size > 0 && size <= bound);
    fuzz_check(!clgs_paper_decode(out, size, m->decoded, m->rows, m->channels));
    check_same(m);
}

static void planes(const matrix *m)
{
    size_t count = m->rows * m->channels, bound = clgs_planes_bound(count);
    uint8_t *out = fuzz_block(FUZZ_OUTPUT, bound);
    void *workspace = fuzz_block(FUZZ_WORKSPACE, clgs_planes_workspace());
    size_t size = clgs_planes_encode((uint32_t *)m->value, count, out, bound, workspace);
    fuzz_check(size > 0 && size <= bound);
    fuzz_check(!clgs_planes_decode(out, size, (uint32_t *)m->decoded, count, workspace));
    check_same(m);
}

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size)
{
    fuzz_input input = {data, size};
    uint32_t shape = fuzz_take(&input, 1);
    size_t width = shape % 4 + 1, channels = shape / 4 % 7 + 1;
    matrix m = {.rows = input.size / (width * channels), .channels = channels};
    m.size = 4 * m.rows * channels;
    m.value = fuzz_block(FUZZ_VALUE, m.size);
    m.decoded = fuzz_block(FUZZ_DECODED, m.size);
    for (size_t i = 0; i < m.rows * channels; i++) {
        uint32_t bits = fuzz_take(&input, width) << 8 * (4 - width);
        int32_t value = bits >> 31 ? -(int32_t)~bits - 1 : (int32_t)bits;
        m.value[i] = value / (1 << 8 * (4 - width));
    }
    switch (shape / 28 % 3) {
    case 0:
        runlength(&m);
        break;
    case 1:
        paper(&m);
        break;
    default:
        planes(&m);
    }
    return 0;
}
