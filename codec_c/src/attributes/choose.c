/* Classes and tables from counts: cells that stand side by side are merged while that saves bits.
 *
 * Only the encoder's choice depends on this; costs are integers, so all machines choose alike.
 */
#include <string.h>

#include "attributes/model.h"

#define FRACTION 16 /* costs are in 2^-16 bits */
#define LOG_BITS 10
#define TABLE_COST ((uint64_t)24 << FRACTION)
#define WORTH 256 /* classes must save one part in WORTH of a channel's bits */
#define SYMBOL_COST ((uint64_t)2 << FRACTION)

typedef struct segment {
    uint32_t count[CLGS_ALPHABET];
    uint32_t total, first; /* first: the first of its cells */
    uint64_t cost, joint;  /* alone; together with the next segment */
} segment;

typedef struct chooser {
    uint32_t log[1 << LOG_BITS]; /* of 1 + i / 1024 */
    uint32_t scale;              /* rows of all data to rows counted, in 1/256 */
    uint32_t segments;
    segment segment[CLGS_CELLS];
} chooser;

/* Base-2 logarithms bit by bit: squaring doubles a logarithm. */
static void fill_log(uint32_t *log)
{
    for (uint32_t i = 0; i < 1u << LOG_BITS; i++) {
        uint64_t x = (uint64_t)((1u << LOG_BITS) + i) << (31 - LOG_BITS);
        uint32_t result = 0;
        for (int bit = 0; bit < FRACTION; bit++) {
            x = x * x >> 31;
            result <<= 1;
            if (x >> 32) {
                x >>= 1;
                result |= 1;
            }
        }
        log[i] = result;
    }
}

static uint64_t log_of(const chooser *c, uint64_t n)
{
    uint32_t top = 0;
    while (n >> top > 1)
        top++;
    uint64_t mantissa = top > LOG_BITS ? n >> (top - LOG_BITS) : n << (LOG_BITS - top);
    return ((uint64_t)top << FRACTION) + c->log[mantissa & ((1u << LOG_BITS) - 1)];
}

/* Bits of the segments a and b (or NULL) with one table, the table included. */
static uint64_t cost_of(const chooser *c, const segment *a, const segment *b)
{
    uint64_t total = a->total + (b ? b->total : 0), bits = total * log_of(c, total);
    uint64_t table = TABLE_COST, skipped = 0;
    for (uint32_t s = 0; s < CLGS_ALPHABET; s++) {
        uint64_t n = a->count[s] + (b ? b->count[s] : 0);
        if (n == 0) {
            skipped += SYMBOL_COST / 8;
            continue;
        }
        bits -= n * log_of(c, n);
        table += SYMBOL_COST + skipped + log_of(c, 1 + n * CLGS_SCALE / total) / 2;
        skipped = 0;
    }
    return (bits * c->scale >> 8) + table;
}

/* One segment for each cell that occurs. */
static void start_segments(chooser *c, const uint32_t *count)
{
    c->segments = 0;
    for (uint32_t cell = 0; cell < CLGS_CELLS; cell++, count += CLGS_TABLE) {
        segment *own = c->segment + c->segments;
        own->total = 0;
        for (uint32_t s = 0; s < CLGS_ALPHABET; s++)
            own->total += count[s];
        if (own->total == 0)
            continue;
        memcpy(own->count, count, sizeof own->count);
        own->first = cell;
        own->cost = cost_of(c, own, NULL);
        c->segments++;
    }
    for (uint32_t i = 0; i + 1 < c->segments; i++)
        c->segment[i].joint = cost_of(c, c->segment + i, c->segment + i + 1);
}

static void merge_next(chooser *c, uint32_t i)
{
    segment *own = c->segment + i, *next = own + 1;
    for (uint32_t s = 0; s < CLGS_ALPHABET; s++)
        own->count[s] += next->count[s];
    own->total += next->total;
    own->cost = own->joint;
    c->segments--;
    memmove(next, next + 1, (c->segments - i - 1) * sizeof *next);
    if (i + 1 < c->segments)
        own->joint = cost_of(c, own, next);
    if (i > 0)
        own[-1].joint = cost_of(c, own - 1, own);
}

/* Merge the pair that saves most until none saves and at most `most_classes` remain. */
static void merge_segments(chooser *c, uint32_t most_classes)
{
    while (c->segments > 1) {
        uint32_t best = 0;
        int64_t most = INT64_MIN;
        for (uint32_t i = 0; i + 1 < c->segments; i++) {
            const segment *own = c->segment + i;
            int64_t saved = (int64_t)(own->cost + own[1].cost) - (int64_t)own->joint;
            if (saved > most) {
                most = saved;
                best = i;
            }
        }
        if (most < 0 && c->segments <= most_classes)
            break;
        merge_next(c, best);
    }
}

/* Which symbol's frequency is best changed by one: most occurrences per share if it grows. */
static uint32_t pick(const segment *own, const uint16_t *frequency, int grow)
{
    uint32_t best = 0;
    uint64_t best_count = 0, best_share = 0;
    for (uint32_t s = 0; s < CLGS_ALPHABET; s++) {
        uint64_t count = own->count[s], share = 2u * frequency[s] + (grow ? 1 : 0) - (grow ? 0 : 1);
        if (count == 0 || (!grow && frequency[s] < 2))
            continue;
        uint64_t mine = count * best_share, other = best_count * share;
        if (best_share == 0 || (grow ? mine > other : mine < other)) {
            best = s;
            best_count = count;
            best_share = share;
        }
    }
    return best;
}

/* Frequencies in proportion to the counts, at least 1 if there is one, of sum CLGS_SCALE. */
static void set_frequencies(const segment *own, uint16_t *frequency)
{
    uint32_t sum = 0;
    for (uint32_t s = 0; s < CLGS_ALPHABET; s++) {
        uint64_t share = ((uint64_t)own->count[s] * CLGS_SCALE + own->total / 2) / own->total;
        frequency[s] = (uint16_t)(own->count[s] > 0 && share == 0 ? 1 : share);
        sum += frequency[s];
    }
    for (; sum < CLGS_SCALE; sum++)
        frequency[pick(own, frequency, 1)]++;
    for (; sum > CLGS_SCALE; sum--)
        frequency[pick(own, frequency, 0)]--;
}

static uint64_t literal_cost(const chooser *c, const segment *own)
{
    uint64_t bits = 0;
    for (uint32_t s = CLGS_DIRECT; s < CLGS_ALPHABET; s++)
        bits += (uint64_t)own->count[s] * clgs_literal_bits(s);
    return (bits << FRACTION) * c->scale >> 8;
}

/* Classes of one channel: merge while that saves, then to one class if several save little. */
static void find_classes(chooser *c, const uint32_t *count)
{
    uint64_t cost = 0;
    start_segments(c, count);
    merge_segments(c, CLGS_CLASSES);
    for (uint32_t k = 0; k < c->segments; k++)
        cost += c->segment[k].cost;
    merge_segments(c, 1);
    if (cost + c->segment[0].cost / WORTH < c->segment[0].cost) {
        start_segments(c, count);
        merge_segments(c, CLGS_CLASSES);
    }
}

static uint64_t choose(chooser *c, clgs_channel *channel, const uint32_t *count)
{
    uint64_t cost = 0;
    memset(channel->class_of, 0, sizeof channel->class_of);
    memset(channel->frequency, 0, sizeof channel->frequency);
    channel->classes = 1;
    if (channel->coder == CLGS_KNOWN)
        return 0;
    find_classes(c, count);
    channel->classes = (int32_t)c->segments;
    for (uint32_t k = 0; k < c->segments; k++) {
        set_frequencies(c->segment + k, channel->frequency[k]);
        for (uint32_t cell = c->segment[k].first; cell < CLGS_CELLS && k > 0; cell++)
            channel->class_of[cell] = (uint8_t)k;
        cost += c->segment[k].cost + literal_cost(c, c->segment + k);
    }
    return cost;
}

size_t clgs_attributes_choose_workspace(void)
{
    return sizeof(chooser);
}

clgs_error clgs_attributes_choose(void *model, size_t channels, const uint32_t *count,
                                  uint32_t scale, uint64_t *cost, void *workspace)
{
    chooser *c = workspace;
    clgs_channel *channel = model;
    if (channels < 1 || channels > CLGS_MAX_CHANNELS)
        return CLGS_ERROR_ARGUMENT;
    fill_log(c->log);
    c->scale = scale;
    for (size_t j = 0; j < channels; j++, count += CLGS_CELLS * CLGS_TABLE) {
        uint32_t total = 0;
        for (uint32_t i = 0; i < CLGS_CELLS * CLGS_TABLE; i++)
            total |= count[i];
        if (total == 0)
            return CLGS_ERROR_ARGUMENT;
        cost[j] = choose(c, channel + j, count);
    }
    return CLGS_OK;
}
