/* Binary range coder with a 64-bit interval, which moves by 32 bits at a time.
 *
 * It narrows the interval as range.h does, and gives and takes bits without a model, too. One
 * struct and one function serve both directions; callers pass `decoding` as a constant,
 * so that the compiler makes one program of each.
 */
#ifndef CLGS_ENTROPY_WIDE_RANGE_H
#define CLGS_ENTROPY_WIDE_RANGE_H

#include "clgs_codec.h"

#if defined(__GNUC__)
#define CLGS_INLINE static inline __attribute__((always_inline))
#else
#define CLGS_INLINE static inline
#endif

#define CLGS_WIDE_TOP ((uint64_t)1 << 56) /* an interval this wide holds a number of one byte */
#define CLGS_WIDE_PADDING 7               /* zero bytes that the decoder may read past the end */
#define CLGS_WIDE_PLAIN 16                /* bits without a model that one step takes, at most */

typedef struct clgs_wide {
    uint64_t range;
    uint64_t low;          /* encoder: start of the interval; decoder: code minus that start */
    size_t read;           /* decoder: bytes taken, with those after the end */
    int failed;            /* encoder: output full; decoder: input used up or senseless */
    const uint8_t *source; /* decoder: all of the input */
    size_t size;
    uint8_t *out; /* encoder: next byte */
    uint8_t *out_begin, *out_end;
} clgs_wide;

static inline void clgs_wide_put(clgs_wide *coder, uint32_t bytes)
{
    if (coder->out_end - coder->out < (ptrdiff_t)bytes) {
        coder->failed = 1;
        return;
    }
    for (; bytes > 0; bytes--) {
        *coder->out++ = (uint8_t)(coder->low >> 56);
        coder->low <<= 8;
    }
}

static inline void clgs_wide_get(clgs_wide *coder, uint32_t bytes)
{
    for (; bytes > 0; bytes--) {
        uint64_t byte = coder->read < coder->size ? coder->source[coder->read] : 0;
        coder->low = coder->low << 8 | byte;
        coder->read++;
    }
    if (coder->read > coder->size + CLGS_WIDE_PADDING)
        coder->failed = 1;
}

static inline void clgs_wide_carry(clgs_wide *coder)
{
    uint8_t *byte = coder->out;
    while (byte > coder->out_begin && ++*--byte == 0) {
    }
}

static inline void clgs_wide_begin_encode(clgs_wide *coder, uint8_t *out, size_t capacity)
{
    *coder = (clgs_wide){.range = UINT64_MAX, .out = out, .out_begin = out};
    coder->out_end = out + capacity;
}

static inline void clgs_wide_begin_decode(clgs_wide *coder, const uint8_t *data, size_t size)
{
    *coder = (clgs_wide){.range = UINT64_MAX, .source = data, .size = size};
    clgs_wide_get(coder, 8);
}

/* Move on by four bytes once the interval is narrow. */
CLGS_INLINE void clgs_wide_shift(clgs_wide *coder, int decoding)
{
    if (coder->range >> 32)
        return;
    coder->range <<= 32;
    if (decoding)
        clgs_wide_get(coder, 4);
    else
        clgs_wide_put(coder, 4);
}

/* Code one bit whose probability of being 1 is `p` / 65536, 0 < p < 65536; returns the bit. */
CLGS_INLINE uint32_t clgs_wide_code(clgs_wide *coder, uint32_t bit, uint32_t p, int decoding)
{
    uint64_t low = coder->low, bound = (coder->range >> 16) * p;
    if (decoding) {
        bit = low < bound;
        if (bit) {
            coder->range = bound;
        } else {
            coder->low = low - bound;
            coder->range -= bound;
        }
    } else { /* the bit is known: no branch to guess wrong */
        uint64_t zero = (uint64_t)bit - 1;
        coder->low = low + (bound & zero);
        coder->range = bound + ((coder->range - 2 * bound) & zero);
        if (coder->low < low)
            clgs_wide_carry(coder);
    }
    clgs_wide_shift(coder, decoding);
    return bit;
}

/* Code the low `bits` bits of `value`, 1 to CLGS_WIDE_PLAIN, all values alike likely. */
CLGS_INLINE uint32_t clgs_wide_plain(clgs_wide *coder, uint32_t value, uint32_t bits, int decoding)
{
    uint64_t low = coder->low;
    coder->range >>= bits;
    if (decoding) {
        uint64_t place = low / coder->range;
        coder->failed |= place >> bits != 0;
        value = (uint32_t)place & ((1u << bits) - 1);
        coder->low = low - value * coder->range;
    } else {
        coder->low = low + value * coder->range;
        if (coder->low < low)
            clgs_wide_carry(coder);
    }
    clgs_wide_shift(coder, decoding);
    return value;
}

/* Bytes that still have to follow until one more pins the interval. */
static inline uint32_t clgs_wide_tail(uint64_t range)
{
    uint32_t bytes = 0;
    for (; range < CLGS_WIDE_TOP; range <<= 8)
        bytes++;
    return bytes;
}

/* Round up within the interval to a number whose low bytes are zero, and write the others. */
static inline void clgs_wide_end_encode(clgs_wide *coder)
{
    uint32_t tail = clgs_wide_tail(coder->range);
    uint64_t low = coder->low, step = CLGS_WIDE_TOP >> 8 * tail;
    coder->low = (low + (step - 1)) & ~(step - 1);
    if (coder->low < low)
        clgs_wide_carry(coder);
    clgs_wide_put(coder, tail + 1);
}

/* The range tells how many bytes an encoder wrote: the input must be as long. */
static inline clgs_error clgs_wide_end_decode(const clgs_wide *coder)
{
    size_t written = coder->read - 7 + clgs_wide_tail(coder->range);
    if (coder->failed || written > coder->size)
        return CLGS_ERROR_TRUNCATED;
    return written < coder->size ? CLGS_ERROR_TRAILING : CLGS_OK;
}

#endif
