#include "clgs_codec.h"

/* CRC of every 4-bit value, reflected polynomial 0x82F63B78. */
static const uint32_t NIBBLE[16] = {
    0x00000000, 0x105EC76F, 0x20BD8EDE, 0x30E349B1, 0x417B1DBC, 0x5125DAD3, 0x61C69362, 0x7198540D,
    0x82F63B78, 0x92A8FC17, 0xA24BB5A6, 0xB21572C9, 0xC38D26C4, 0xD3D3E1AB, 0xE330A81A, 0xF36E6F75,
};

uint32_t clgs_crc32c(const uint8_t *data, size_t size)
{
    uint32_t crc = 0xFFFFFFFFu;
    for (size_t i = 0; i < size; i++) {
        crc ^= data[i];
        crc = NIBBLE[crc & 15] ^ (crc >> 4);
        crc = NIBBLE[crc & 15] ^ (crc >> 4);
    }
    return crc ^ 0xFFFFFFFFu;
}
