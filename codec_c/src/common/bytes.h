/* Little-endian words, zigzag variable-length integers with every read checked, cache lines. */
#ifndef CLGS_COMMON_BYTES_H
#define CLGS_COMMON_BYTES_H

#include "clgs_codec.h"

#define CLGS_MAX_VARINT 5 /* bytes of the longest zigzag integer */

static inline void clgs_store32(uint8_t *out, uint32_t value)
{
    for (int i = 0; i < 4; i++)
        out[i] = (uint8_t)(value >> 8 * i);
}

static inline uint32_t clgs_load32(const uint8_t *data)
{
    return (uint32_t)data[0] | (uint32_t)data[1] << 8 | (uint32_t)data[2] << 16 |
           (uint32_t)data[3] << 24;
}

static inline uint64_t clgs_load64(const uint8_t *data)
{
    return clgs_load32(data) | (uint64_t)clgs_load32(data + 4) << 32;
}

/* Round a number of bytes up to whole cache lines. */
static inline size_t clgs_align(size_t size)
{
    return (size + 63) / 64 * 64;
}

/* The bits of `value` as a two's complement number, without an implementation-defined cast. */
static inline int32_t clgs_signed(uint32_t value)
{
    return value < 0x80000000u ? (int32_t)value : -(int32_t)(0xFFFFFFFFu - value) - 1;
}

/* Zigzag (0, -1, 1, -2, ...) in groups of 7 bits, lowest first, at most 5 bytes. */
static inline uint8_t *clgs_store_varint(uint8_t *out, int32_t value)
{
    uint32_t zigzag = (uint32_t)value << 1 ^ (value < 0 ? 0xFFFFFFFFu : 0);
    for (; zigzag >= 128; zigzag >>= 7)
        *out++ = (uint8_t)(zigzag | 128);
    *out++ = (uint8_t)zigzag;
    return out;
}

/* Returns the byte after the integer, or NULL if it is cut or longer than 32 bits. */
static inline const uint8_t *clgs_load_varint(const uint8_t *at, const uint8_t *end, int32_t *value)
{
    uint64_t zigzag = 0;
    for (uint32_t shift = 0; shift < 35; shift += 7) {
        if (end - at < 1)
            return NULL;
        uint8_t byte = *at++;
        zigzag |= (uint64_t)(byte & 127) << shift;
        if (byte < 128) {
            uint32_t half = (uint32_t)(zigzag >> 1);
            *value = clgs_signed(zigzag & 1 ? ~half : half);
            return zigzag >> 32 ? NULL : at;
        }
    }
    return NULL;
}

#endif
