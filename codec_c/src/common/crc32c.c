#include "common/bytes.h"

/* Processors with an instruction for this checksum use it; all others give the same from tables. */
#if defined(__x86_64__) && defined(__GNUC__)
#ifdef __clang__ /* may know the instruction apart from the others of SSE 4.2 */
#define HARDWARE __attribute__((target("sse4.2,crc32")))
#else
#define HARDWARE __attribute__((target("sse4.2")))
#endif
#define HAS_HARDWARE() __builtin_cpu_supports("sse4.2")
#define CRC_WORD(crc, word) ((uint32_t)__builtin_ia32_crc32di(crc, word))
#define CRC_BYTE(crc, byte) __builtin_ia32_crc32qi(crc, byte)
#elif defined(__ARM_FEATURE_CRC32)
#include <arm_acle.h>
#define HARDWARE
#define HAS_HARDWARE() 1
#define CRC_WORD(crc, word) __crc32cd(crc, word)
#define CRC_BYTE(crc, byte) __crc32cb(crc, byte)
#endif

#define SLICES 16 /* half bytes of what the tables take at once */
#define WORTH_TABLES 512

/* CRC of every 4-bit value, reflected polynomial 0x82F63B78. */
static const uint32_t NIBBLE[16] = {
    0x00000000, 0x105EC76F, 0x20BD8EDE, 0x30E349B1, 0x417B1DBC, 0x5125DAD3, 0x61C69362, 0x7198540D,
    0x82F63B78, 0x92A8FC17, 0xA24BB5A6, 0xB21572C9, 0xC38D26C4, 0xD3D3E1AB, 0xE330A81A, 0xF36E6F75,
};

static uint32_t next_nibble(uint32_t crc)
{
    return NIBBLE[crc & 15] ^ crc >> 4;
}

static uint32_t update_bytes(uint32_t crc, const uint8_t *data, size_t size)
{
    for (size_t i = 0; i < size; i++)
        crc = next_nibble(next_nibble(crc ^ data[i]));
    return crc;
}

/* Eight bytes per step: one look-up for each half byte, by its distance from the end. */
static uint32_t update_slices(uint32_t crc, const uint8_t *data, size_t words)
{
    uint32_t table[SLICES][16];
    for (uint32_t n = 0; n < 16; n++) {
        table[0][n] = NIBBLE[n];
        for (uint32_t k = 1; k < SLICES; k++)
            table[k][n] = next_nibble(table[k - 1][n]);
    }
    for (; words > 0; words--, data += 8) {
        uint64_t word = clgs_load64(data) ^ crc;
        crc = 0;
        for (uint32_t k = 0; k < SLICES; k++)
            crc ^= table[SLICES - 1 - k][word >> 4 * k & 15];
    }
    return crc;
}

static uint32_t update_portable(uint32_t crc, const uint8_t *data, size_t size)
{
    size_t words = size < WORTH_TABLES ? 0 : size / 8;
    if (words > 0)
        crc = update_slices(crc, data, words);
    return update_bytes(crc, data + 8 * words, size - 8 * words);
}

#ifdef HARDWARE
HARDWARE static uint32_t update_hardware(uint32_t crc, const uint8_t *data, size_t size)
{
    for (; size >= 8; size -= 8, data += 8)
        crc = CRC_WORD(crc, clgs_load64(data));
    for (; size > 0; size--, data++)
        crc = CRC_BYTE(crc, *data);
    return crc;
}
#endif

uint32_t clgs_crc32c(const uint8_t *data, size_t size)
{
#ifdef HARDWARE
    if (HAS_HARDWARE())
        return ~update_hardware(0xFFFFFFFFu, data, size);
#endif
    return clgs_crc32c_portable(data, size);
}

uint32_t clgs_crc32c_portable(const uint8_t *data, size_t size)
{
    return ~update_portable(0xFFFFFFFFu, data, size);
}
