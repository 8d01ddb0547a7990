#include "directory.h"

#include <string.h>

#include "clgs_codec.h"
#include "common/bytes.h"
#include "memory.h"

#define COLUMNS 11 /* anchors, least x y z, greatest x y z, bytes in ANCH OFFS FEAT SCAL */
#define GROUP 64
#define HEAD 48
#define MAX_ANCHORS 12000000
#define MAX_LAYERS 64
#define LAYER 12 /* bytes: chunks, hash */
#define MAX_POINTS_PER_BYTE 32768
#define WRONG "the list of the file's chunks is damaged; copy the file again"

typedef int64_t row[COLUMNS];

/* Rows of `bytes`, made absolute; `total`: the row of their group, zeros for the head's rows. */
static problem read_rows(span bytes, size_t count, const row total, row *result)
{
    size_t mark = memory_mark();
    int32_t *coded = memory_take(count * COLUMNS * sizeof *coded);
    void *workspace = memory_take(clgs_runlength_workspace(COLUMNS));
    if (!coded || !workspace)
        return NO_MEMORY;
    if (clgs_runlength_decode(bytes.data, bytes.size, coded, count, COLUMNS, workspace))
        return WRONG;
    for (size_t i = 0; i < count; i++) {
        for (int c = 0; c < COLUMNS; c++)
            result[i][c] = coded[COLUMNS * i + (size_t)c];
        for (int c = 1; c < 4; c++)
            result[i][c] += i > 0 ? result[i - 1][c] : total[c];
        for (int c = 4; c < 7; c++)
            result[i][c] += result[i][c - 3];
        for (int c = 7; c < COLUMNS && total[0] > 0; c++)
            result[i][c] += result[i][0] * total[c] / total[0];
        if (result[i][0] < 1 || result[i][0] > MAX_ANCHORS)
            return WRONG;
    }
    memory_release(mark);
    return NULL;
}

static uint32_t bit_length(uint32_t value)
{
    uint32_t bits = 0;
    for (; value > 0; value >>= 1)
        bits++;
    return bits;
}

/* The least cell of the octree from `origin` that holds the corners of a row. */
static problem find_cell(const row from, const uint8_t *origin, chunk *result)
{
    int64_t least[3];
    result->depth = 0;
    for (int axis = 0; axis < 3; axis++) {
        int64_t start = clgs_signed(clgs_load32(origin + 4 * axis));
        int64_t low = from[1 + axis] - start, high = from[4 + axis] - start;
        if (low < 0 || high < low || high >= 1 << CLGS_MAX_DEPTH)
            return WRONG;
        uint32_t depth = bit_length((uint32_t)low ^ (uint32_t)high);
        result->depth = depth > result->depth ? depth : result->depth;
        least[axis] = low;
    }
    for (int axis = 0; axis < 3; axis++) {
        int64_t start = clgs_signed(clgs_load32(origin + 4 * axis));
        int64_t corner = start + (least[axis] >> result->depth << result->depth);
        if (corner > INT32_MAX)
            return WRONG;
        result->corner[axis] = (int32_t)corner;
    }
    return NULL;
}

/* The next chunk, whose parts follow those before, which end at `end`; of BODY at `end[0]`. */
static problem place_chunk(const container *file, const row from, size_t end[CODED], chunk *result)
{
    for (int i = 0; i < CODED; i++) {
        span section = file->section[ANCH + i];
        size_t *at = &end[i];
        if (file->layers) {
            section = (span){file->section[BODY].data, file->body_size};
            at = &end[0];
        }
        if (from[7 + i] < 0 || (uint64_t)from[7 + i] > section.size - *at)
            return WRONG;
        result->part[i] = (span){section.data + *at, (size_t)from[7 + i]};
        *at += result->part[i].size;
    }
    result->rows = (size_t)from[0];
    memcpy(result->bounds, from + 1, sizeof result->bounds);
    if (result->rows > result->part[0].size * (uint64_t)MAX_POINTS_PER_BYTE)
        return WRONG;
    return find_cell(from, file->section[META].data + 152, result);
}

typedef struct reader {
    const container *file;
    directory *result;
    size_t end[CODED]; /* where the next chunk's parts begin */
} reader;

static problem read_group(reader *r, span bytes, size_t first, size_t count, const row total)
{
    size_t mark = memory_mark();
    row *rows = memory_take(count * sizeof *rows);
    if (!rows)
        return NO_MEMORY;
    if (bytes.size < 8 * count)
        return WRONG;
    span coded = {bytes.data + 8 * count, bytes.size - 8 * count}; /* after the chunks' CRCs */
    problem wrong = read_rows(coded, count, total, rows);
    for (size_t i = 0; i < count && !wrong; i++) {
        chunk *next = &r->result->chunk[first + i];
        next->first = first + i > 0 ? next[-1].first + next[-1].rows : 0;
        next->crc[0] = clgs_load32(bytes.data + 4 * i);
        next->crc[1] = clgs_load32(bytes.data + 4 * (count + i));
        wrong = place_chunk(r->file, rows[i], r->end, next);
        if (!wrong && next->first + next->rows > r->result->anchors)
            wrong = WRONG;
    }
    memory_release(mark);
    return wrong;
}

/* The groups of a head of `groups` groups, whose own rows are `coded`. */
static problem read_groups(reader *r, span list, size_t groups, span coded)
{
    static const row none;
    row *totals = memory_take((groups + 1) * sizeof *totals);
    if (!totals)
        return NO_MEMORY;
    problem wrong = read_rows(coded, groups, none, totals);
    size_t at = HEAD + 8 * groups + coded.size;
    for (size_t g = 0; g < groups && !wrong; g++) {
        size_t size = clgs_load32(list.data + HEAD + 8 * g), first = GROUP * g;
        size_t count = r->result->chunks - first < GROUP ? r->result->chunks - first : GROUP;
        if (size > list.size - at)
            return WRONG;
        wrong = read_group(r, (span){list.data + at, size}, first, count, totals[g]);
        at += size;
    }
    return wrong ? wrong : at == list.size ? NULL : WRONG;
}

/* The headers that chunks share, at the beginning of their sections. */
static problem read_headers(reader *r, span list)
{
    for (int i = 0; i < CODED; i++) {
        size_t size = clgs_load32(list.data + 8 + 8 * i);
        if (size > r->file->section[ANCH + i].size)
            return WRONG;
        r->result->header[i] = (span){r->file->section[ANCH + i].data, size};
        r->end[i] = r->file->layers ? 0 : size;
    }
    return NULL;
}

/* The ends of layers, once the chunks are known. The last one of a file with DETL has details. */
static problem read_layers(const container *file, directory *result)
{
    span list = file->section[LAYR];
    result->layers = 1;
    if (file->layers) {
        result->layers = list.size < 4 ? 0 : clgs_load32(list.data);
        if (result->layers < 1 || result->layers > MAX_LAYERS)
            return WRONG;
        if (list.size != 4 + LAYER * result->layers)
            return WRONG;
    }
    result->layer = memory_take((result->layers + 1) * sizeof *result->layer);
    if (!result->layer)
        return NO_MEMORY;
    result->layer[0] =
        (layer){result->chunks, result->anchors, 0, clgs_load64(file->section[META].data + 144)};
    size_t end = 0;
    for (size_t i = 0; file->layers && i < result->layers; i++) {
        const uint8_t *entry = list.data + 4 + LAYER * i;
        size_t chunks = clgs_load32(entry);
        if (chunks < 1 || chunks > result->chunks - end)
            return WRONG;
        end += chunks;
        const chunk *last = result->chunk + end - 1;
        size_t bytes = (size_t)(last->part[CODED - 1].data - file->section[BODY].data);
        result->layer[i] = (layer){end, last->first + last->rows,
                                   bytes + last->part[CODED - 1].size, clgs_load64(entry + 4)};
    }
    if (file->details)
        result->layer[result->layers++] =
            (layer){2 * result->chunks, result->anchors, file->body_size, 0};
    return !file->layers || end == result->chunks ? NULL : WRONG;
}

problem directory_read(const container *file, directory *result)
{
    span meta = file->section[META], list = file->section[CHNK];
    if (meta.size != 168 || list.size < HEAD || clgs_load32(meta.data) > MAX_ANCHORS)
        return WRONG;
    reader r = {.file = file, .result = result};
    result->anchors = clgs_load32(meta.data);
    result->chunks = clgs_load32(list.data + 4);
    size_t groups = (result->chunks + GROUP - 1) / GROUP, rows = clgs_load32(list.data + 40);
    if (groups > (list.size - HEAD) / 8 || rows > list.size - HEAD - 8 * groups)
        return WRONG;
    result->chunk = memory_take((result->chunks + 1) * sizeof *result->chunk);
    if (!result->chunk)
        return NO_MEMORY;
    problem wrong = read_headers(&r, list);
    if (!wrong)
        wrong = read_groups(&r, list, groups, (span){list.data + HEAD + 8 * groups, rows});
    if (!wrong)
        wrong = details_read(file, result->chunks, r.end[0], &result->details);
    if (wrong)
        return wrong;
    const chunk *last = result->chunk + result->chunks - 1;
    size_t end = result->chunks > 0 ? last->first + last->rows : 0;
    return end == result->anchors ? read_layers(file, result) : WRONG;
}
