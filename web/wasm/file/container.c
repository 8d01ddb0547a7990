#include "container.h"

#include <string.h>

#include "common/bytes.h"

#define MAGIC 0x1A0A0D53474C438Bu
#define HEAD 16
#define ENTRY 32
#define MAX_ENTRIES 64

#define TAG(a, b, c, d)                                                                            \
    ((uint32_t)(a) | (uint32_t)(b) << 8 | (uint32_t)(c) << 16 | (uint32_t)(d) << 24)

static const uint32_t SCENE_TAGS[] = {
    TAG('M', 'E', 'T', 'A'), TAG('C', 'H', 'N', 'K'), TAG('A', 'N', 'C', 'H'),
    TAG('O', 'F', 'F', 'S'), TAG('F', 'E', 'A', 'T'), TAG('S', 'C', 'A', 'L'),
    TAG('M', 'L', 'P', 'S'), TAG('L', 'A', 'Y', 'R'), TAG('D', 'E', 'T', 'L'),
    TAG('B', 'O', 'D', 'Y'),
};
static const uint32_t SPLAT_TAGS[] = {
    TAG('S', 'P', 'L', 'T'),
    TAG('S', 'P', 'O', 'S'),
    TAG('S', 'M', 'U', 'L'),
    TAG('S', 'A', 'T', 'R'),
};

#define PHOT TAG('P', 'H', 'O', 'T')

double load_double(const uint8_t *at)
{
    uint64_t bits = clgs_load64(at);
    double value;
    memcpy(&value, &bits, sizeof value);
    return value;
}

/* One entry of the table: the section that follows the byte `*end` of the file. */
static problem read_entry(span file, const uint8_t *entry, int may_be_cut, uint64_t *end,
                          span *section)
{
    uint64_t offset = clgs_load64(entry + 8), length = clgs_load64(entry + 16);
    if (offset != *end || offset > file.size || length > SIZE_MAX / 2 - offset)
        return CUT;
    *end += length;
    size_t rest = file.size - (size_t)offset;
    *section = (span){file.data + offset, length < rest ? (size_t)length : rest};
    if (section->size < length)
        return may_be_cut ? NULL : CUT;
    return clgs_crc32c(section->data, section->size) == clgs_load32(entry + 24) ? NULL : CUT;
}

/* The next section to find, after `found` of them: DETL may be left out. */
static uint32_t next_section(uint32_t tag, const uint32_t *tags, uint32_t found)
{
    int leaves_out = tags == SCENE_TAGS && found == DETL && tag == tags[BODY];
    return leaves_out ? BODY : found;
}

static problem read_entries(span file, uint32_t count, container *result)
{
    const uint32_t *tags = result->splats ? SPLAT_TAGS : SCENE_TAGS;
    uint32_t known = result->splats ? 4 : SECTIONS, found = 0;
    uint64_t end = HEAD + ENTRY * (uint64_t)count + 4;
    for (uint32_t i = 0; i < count; i++) {
        const uint8_t *entry = file.data + HEAD + ENTRY * i;
        found = next_section(clgs_load32(entry), tags, found);
        int next = found < known && clgs_load32(entry) == tags[found];
        int body = next && !result->splats && found == BODY;
        span section;
        problem wrong = read_entry(file, entry, body && i + 1 == count, &end, &section);
        if (wrong)
            return wrong;
        if (body) {
            result->layers = 1;
            result->begin = (size_t)(section.data - file.data);
            result->body_size = (size_t)end - result->begin;
        }
        if (next)
            result->section[found++] = section;
        else if (!result->splats && clgs_load32(entry) == PHOT)
            result->photos = section;
        else if (clgs_load32(entry + 4) & 1)
            return "the file needs a newer page; export it with a newer clgs";
    }
    result->details = result->section[DETL].data != NULL;
    uint32_t wanted = result->splats ? 4 : result->layers ? SECTIONS : LAYR;
    return found == wanted && end >= file.size ? NULL : CUT;
}

/* Verify the table, if all of it is there; `*size`: its bytes and those before it, else 0. */
static problem check_table(span file, size_t *size)
{
    *size = 0;
    if (file.size >= 8 && clgs_load64(file.data) != MAGIC)
        return "this is no .clgs file; `clgs encode` and `clgs pack` make some";
    if (file.size < HEAD)
        return NULL;
    if ((clgs_load32(file.data + 8) & 0xFFFF) != 1)
        return "the file has another version of the format; export it with a newer clgs";
    uint32_t count = clgs_load32(file.data + 12);
    if (count < 1 || count > MAX_ENTRIES)
        return CUT;
    size_t table = HEAD + ENTRY * (size_t)count;
    if (file.size < table + 4)
        return NULL;
    *size = table;
    return clgs_crc32c(file.data, table) == clgs_load32(file.data + table) ? NULL : CUT;
}

problem container_size(span file, uint64_t *size, uint64_t *front)
{
    size_t table;
    *size = *front = 0;
    problem wrong = check_table(file, &table);
    if (wrong || table == 0)
        return wrong;
    const uint8_t *last = file.data + table - ENTRY;
    uint64_t offset = clgs_load64(last + 8), length = clgs_load64(last + 16);
    if (offset > SIZE_MAX / 2 || length > SIZE_MAX / 2 - offset)
        return NO_MEMORY;
    *size = offset + length;
    *front = clgs_load32(last) == SCENE_TAGS[BODY] ? offset : *size;
    return NULL;
}

problem container_read(span file, container *result)
{
    size_t table;
    problem wrong = check_table(file, &table);
    if (wrong)
        return wrong;
    if (table == 0)
        return file.size < 8 ? "this is no .clgs file; `clgs encode` and `clgs pack` make some"
                             : CUT;
    result->splats = clgs_load32(file.data + HEAD) == SPLAT_TAGS[SPLT];
    return read_entries(file, (uint32_t)(table - HEAD) / ENTRY, result);
}
