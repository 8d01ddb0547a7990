/* Binary range coder: one 32-bit interval, carries added into the bytes already written.
 *
 * One struct and one function `clgs_range_code` serve both directions, so that a model written
 * once cannot differ between encoder and decoder.
 */
#ifndef CLGS_ENTROPY_RANGE_H
#define CLGS_ENTROPY_RANGE_H

#include "clgs_codec.h"

#define CLGS_RANGE_TOP ((uint32_t)1 << 24)
#define CLGS_RANGE_PADDING 3 /* zero bytes that the decoder may read past the end */

typedef struct clgs_range {
    uint32_t range;
    uint32_t low; /* encoder: start of the interval; decoder: code minus that start */
    int decoding;
    int failed; /* encoder: output full; decoder: input used up */
    size_t padding;
    const uint8_t *source; /* decoder: next byte */
    const uint8_t *source_end;
    uint8_t *out; /* encoder: next byte */
    uint8_t *out_begin, *out_end;
} clgs_range;

static inline void clgs_range_put(clgs_range *coder)
{
    if (coder->out_end - coder->out < 1)
        coder->failed = 1;
    else
        *coder->out++ = (uint8_t)(coder->low >> 24);
    coder->low <<= 8;
}

static inline void clgs_range_get(clgs_range *coder)
{
    uint32_t byte = 0;
    if (coder->source_end - coder->source >= 1)
        byte = *coder->source++;
    else if (++coder->padding > CLGS_RANGE_PADDING)
        coder->failed = 1;
    coder->low = coder->low << 8 | byte;
}

static inline void clgs_range_carry(clgs_range *coder)
{
    uint8_t *byte = coder->out;
    while (byte > coder->out_begin && ++*--byte == 0) {
    }
}

static inline void clgs_range_begin_encode(clgs_range *coder, uint8_t *out, size_t capacity)
{
    *coder = (clgs_range){.range = 0xFFFFFFFFu, .out = out, .out_begin = out};
    coder->out_end = out + capacity;
}

static inline void clgs_range_begin_decode(clgs_range *coder, const uint8_t *data, size_t size)
{
    *coder = (clgs_range){.range = 0xFFFFFFFFu, .decoding = 1, .source = data};
    coder->source_end = data + size;
    for (int i = 0; i < 4; i++)
        clgs_range_get(coder);
}

/* Code one bit whose probability of being 1 is `p` / 65536, 0 < p < 65536; returns the bit. */
static inline uint32_t clgs_range_code(clgs_range *coder, uint32_t bit, uint32_t p)
{
    uint32_t bound = (coder->range >> 16) * p;
    if (coder->decoding)
        bit = coder->low < bound;
    if (bit) {
        coder->range = bound;
    } else {
        uint32_t low = coder->low;
        coder->low = coder->decoding ? low - bound : low + bound;
        coder->range -= bound;
        if (!coder->decoding && coder->low < low)
            clgs_range_carry(coder);
    }
    while (coder->range < CLGS_RANGE_TOP) {
        coder->range <<= 8;
        if (coder->decoding)
            clgs_range_get(coder);
        else
            clgs_range_put(coder);
    }
    return bit;
}

/* One byte more pins the interval: the number with 24 low zero bits that lies in it. */
static inline void clgs_range_end_encode(clgs_range *coder)
{
    uint32_t low = coder->low;
    coder->low = (low + (CLGS_RANGE_TOP - 1)) & ~(CLGS_RANGE_TOP - 1);
    if (coder->low < low)
        clgs_range_carry(coder);
    clgs_range_put(coder);
}

/* The encoder's last byte leaves exactly three padding bytes to a decoder that read it all. */
static inline clgs_error clgs_range_end_decode(const clgs_range *coder)
{
    if (coder->failed)
        return CLGS_ERROR_TRUNCATED;
    if (coder->source != coder->source_end || coder->padding != CLGS_RANGE_PADDING)
        return CLGS_ERROR_TRAILING;
    return CLGS_OK;
}

#endif
