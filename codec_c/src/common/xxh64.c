/* XXH64 with seed 0, from its published description (github.com/Cyan4973/xxHash, doc/). */
#include "common/bytes.h"

#define PRIME1 0x9E3779B185EBCA87u
#define PRIME2 0xC2B2AE3D27D4EB4Fu
#define PRIME3 0x165667B19E3779F9u
#define PRIME4 0x85EBCA77C2B2AE63u
#define PRIME5 0x27D4EB2F165667C5u

static uint64_t rotate(uint64_t value, uint32_t bits)
{
    return value << bits | value >> (64 - bits);
}

static uint64_t mix_lane(uint64_t lane, uint64_t word)
{
    return rotate(lane + word * PRIME2, 31) * PRIME1;
}

/* Four lanes over whole stripes of 32 bytes, then the lanes together. */
static uint64_t hash_stripes(const uint8_t *data, size_t stripes)
{
    uint64_t lane[4] = {PRIME1 + PRIME2, PRIME2, 0, 0 - PRIME1};
    for (; stripes > 0; stripes--)
        for (uint32_t i = 0; i < 4; i++, data += 8)
            lane[i] = mix_lane(lane[i], clgs_load64(data));
    uint64_t hash =
        rotate(lane[0], 1) + rotate(lane[1], 7) + rotate(lane[2], 12) + rotate(lane[3], 18);
    for (uint32_t i = 0; i < 4; i++)
        hash = (hash ^ mix_lane(0, lane[i])) * PRIME1 + PRIME4;
    return hash;
}

static uint64_t hash_rest(uint64_t hash, const uint8_t *data, size_t size)
{
    for (; size >= 8; size -= 8, data += 8)
        hash = rotate(hash ^ mix_lane(0, clgs_load64(data)), 27) * PRIME1 + PRIME4;
    if (size >= 4) {
        hash = rotate(hash ^ clgs_load32(data) * PRIME1, 23) * PRIME2 + PRIME3;
        size -= 4;
        data += 4;
    }
    for (; size > 0; size--, data++)
        hash = rotate(hash ^ *data * PRIME5, 11) * PRIME1;
    return hash;
}

uint64_t clgs_xxh64(const uint8_t *data, size_t size)
{
    size_t striped = size / 32 * 32;
    uint64_t hash = striped > 0 ? hash_stripes(data, size / 32) : PRIME5;
    hash = hash_rest(hash + size, data + striped, size - striped);
    hash = (hash ^ hash >> 33) * PRIME2;
    hash = (hash ^ hash >> 29) * PRIME3;
    return hash ^ hash >> 32;
}
