#include "container.h"

#include <string.h>

#include "common/bytes.h"

#define MAGIC 0x1A0A0D53474C438Bu
#define HEAD 16
#define ENTRY 32
#define MAX_ENTRIES 64
#define CUT "the file is cut or damaged; copy it again"

#define TAG(a, b, c, d)                                                                            \
    ((uint32_t)(a) | (uint32_t)(b) << 8 | (uint32_t)(c) << 16 | (uint32_t)(d) << 24)

static const uint32_t SCENE_TAGS[] = {
    TAG('M', 'E', 'T', 'A'), TAG('C', 'H', 'N', 'K'), TAG('A', 'N', 'C', 'H'),
    TAG('O', 'F', 'F', 'S'), TAG('F', 'E', 'A', 'T'), TAG('S', 'C', 'A', 'L'),
    TAG('M', 'L', 'P', 'S'),
};
static const uint32_t SPLAT_TAGS[] = {
    TAG('S', 'P', 'L', 'T'),
    TAG('S', 'P', 'O', 'S'),
    TAG('S', 'M', 'U', 'L'),
    TAG('S', 'A', 'T', 'R'),
};

double load_double(const uint8_t *at)
{
    uint64_t bits = clgs_load64(at);
    double value;
    memcpy(&value, &bits, sizeof value);
    return value;
}

/* One entry of the table: the section that follows the byte `*end` of the file. */
static problem read_entry(span file, const uint8_t *entry, uint64_t *end, span *section)
{
    uint64_t offset = clgs_load64(entry + 8), length = clgs_load64(entry + 16);
    if (offset != *end || length > file.size - *end)
        return CUT;
    *section = (span){file.data + offset, (size_t)length};
    *end += length;
    return clgs_crc32c(section->data, section->size) == clgs_load32(entry + 24) ? NULL : CUT;
}

static problem read_entries(span file, uint32_t count, container *result)
{
    const uint32_t *tags = result->splats ? SPLAT_TAGS : SCENE_TAGS;
    uint32_t wanted = result->splats ? 4 : SECTIONS, found = 0;
    uint64_t end = HEAD + ENTRY * (uint64_t)count + 4;
    for (uint32_t i = 0; i < count; i++) {
        const uint8_t *entry = file.data + HEAD + ENTRY * i;
        span section;
        problem wrong = read_entry(file, entry, &end, &section);
        if (wrong)
            return wrong;
        if (found < wanted && clgs_load32(entry) == tags[found])
            result->section[found++] = section;
        else if (clgs_load32(entry + 4) & 1)
            return "the file needs a newer page; export it with a newer clgs";
    }
    return found == wanted && end == file.size ? NULL : CUT;
}

problem container_read(span file, container *result)
{
    if (file.size < HEAD || clgs_load64(file.data) != MAGIC)
        return "this is no .clgs file; `clgs encode` and `clgs pack` make some";
    if ((clgs_load32(file.data + 8) & 0xFFFF) != 1)
        return "the file has another version of the format; export it with a newer clgs";
    uint32_t count = clgs_load32(file.data + 12);
    if (count < 1 || count > MAX_ENTRIES || file.size < HEAD + ENTRY * (size_t)count + 4)
        return CUT;
    size_t table = HEAD + ENTRY * (size_t)count;
    if (clgs_crc32c(file.data, table) != clgs_load32(file.data + table))
        return CUT;
    result->splats = clgs_load32(file.data + HEAD) == SPLAT_TAGS[SPLT];
    return read_entries(file, count, result);
}
