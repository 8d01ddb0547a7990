/* Weights as integer multiples of a power of two per layer, sized by their row and column. */
#include <string.h>

#include "common/bytes.h"
#include "entropy/symbol.h"

#define MODE_MULTIPLES 2

#define SIGNIFICAND 24 /* bits of a multiple: all are exact as floats */
#define STEP_BIAS 150  /* the step 2^s is stored as s + 150; 0: all weights are 0 */
#define LAST_STEP 254  /* 2^104: (2^24 - 1) of them are the largest float */
#define NOT_FINITE 105 /* exponent of infinities and of what is no number */
#define SCALE_ONE 16   /* expected magnitudes are in 1/16 */
#define FIRST_MAGNITUDE 32
#define COLUMN_PRIOR 16 /* rows that the mean of the layer counts as in the mean of a column */
#define ROW_PRIOR 48    /* columns that count as usual ones in the ratio of a row */
#define RATIO_ONE 256
#define RATIO_LIMIT 65535
#define FINE 5 /* up to 2^5 sixteenths expected, magnitudes are not divided */
#define CLASSES (4 * (FINE + 2))
#define LIMIT 1000
#define WEIGHT_SHIFT 14

typedef struct model {
    clgs_tables tables;
    uint32_t state[CLASSES][CLGS_NODES];
    int32_t weight[CLGS_NODES];
    uint64_t column[CLGS_MAX_COLUMNS]; /* sums of the magnitudes above */
} model;

/* What the layer has shown so far. */
typedef struct layer_scale {
    uint64_t total, count;
    uint64_t row, row_expected; /* of this row, the second in 1/16 */
} layer_scale;

typedef struct weights {
    clgs_range coder;
    model *model;
    const uint32_t *source; /* encoder */
    uint32_t *target;       /* decoder */
} weights;

static uint32_t top_bit(uint64_t value)
{
    uint32_t bit = 0;
    while (value >>= 1)
        bit++;
    return bit;
}

/* The magnitude of a float as a multiple of 2^exponent; 105 there means not finite. */
static uint32_t split(uint32_t word, int32_t *exponent)
{
    uint32_t biased = word >> 23 & 255, fraction = word & 0x7FFFFF;
    *exponent = biased > 0 ? (int32_t)biased - 150 : -149;
    return biased > 0 ? fraction | 0x800000 : fraction;
}

static uint32_t join(uint32_t negative, uint32_t multiple, int32_t step)
{
    uint32_t top = top_bit(multiple);
    int32_t exponent = (int32_t)top + step;
    uint32_t word = exponent < -126
                        ? multiple << (step + 149)
                        : (uint32_t)(exponent + 127) << 23 | (multiple << (23 - top) & 0x7FFFFF);
    return multiple == 0 ? 0 : negative << 31 | word;
}

/* The stored byte of the coarsest step that all words are multiples of; LAST_STEP + 1: none. */
static uint32_t find_step(const uint32_t *word, size_t count)
{
    int32_t step = LAST_STEP - STEP_BIAS, exponent;
    uint32_t any = 0, least = LAST_STEP + 1;
    for (size_t i = 0; i < count; i++) {
        uint32_t fraction = split(word[i], &exponent);
        if (word[i] == 0x80000000u || exponent == NOT_FINITE)
            return least; /* -0 would lose its sign */
        for (; fraction > 0 && !(fraction & 1); fraction >>= 1)
            exponent++;
        any |= fraction;
        if (fraction > 0 && exponent < step)
            step = exponent;
    }
    for (size_t i = 0; i < count; i++) {
        uint32_t fraction = split(word[i], &exponent);
        if (fraction > 0 && (int32_t)top_bit(fraction) + exponent - step >= SIGNIFICAND)
            return least;
    }
    return any ? (uint32_t)(step + STEP_BIAS) : 0;
}

/* Expected magnitude of the next weight, in 1/16: the mean of its column above, times how the row
 * compares with the means of its columns so far. */
static uint64_t expect(layer_scale *scale, uint64_t column_sum, uint64_t row)
{
    uint64_t mean = SCALE_ONE * (scale->total + FIRST_MAGNITUDE) / (scale->count + 1);
    uint64_t column = (SCALE_ONE * column_sum + COLUMN_PRIOR * mean) / (row + COLUMN_PRIOR);
    uint64_t ratio = RATIO_ONE * (SCALE_ONE * scale->row + ROW_PRIOR * mean + 1) /
                     (scale->row_expected + ROW_PRIOR * mean + 1);
    uint64_t expected = column * (ratio < RATIO_LIMIT ? ratio : RATIO_LIMIT) / RATIO_ONE;
    scale->row_expected += column;
    return expected > 0 ? expected : 1;
}

/* Code a magnitude: how many times it holds 2^shift, in states of the class, then its low bits. */
static uint32_t code_magnitude(weights *stream, uint64_t expected, uint32_t magnitude)
{
    model *m = stream->model;
    uint32_t top = top_bit(expected), shift = top > FINE ? top - FINE : 0;
    uint32_t row = 4 * (top > FINE ? FINE + 1 : top) + (uint32_t)(expected << 2 >> top & 3);
    shift = shift < SIGNIFICAND - 1 ? shift : SIGNIFICAND - 1;
    clgs_symbol symbol = {
        .mix = {.coder = &stream->coder,
                .tables = &m->tables,
                .inputs = 1,
                .limit = {LIMIT},
                .shift = WEIGHT_SHIFT},
        .base = {m->state[row]},
        .weight = m->weight,
    };
    uint32_t coded = clgs_symbol_size(&symbol, (magnitude >> shift) + 1) - 1;
    if (coded >> (SIGNIFICAND - shift))
        return (uint32_t)1 << SIGNIFICAND;
    while (shift > 0) {
        shift--;
        coded = coded << 1 | clgs_range_code(&stream->coder, magnitude >> shift & 1, 32768);
    }
    return coded;
}

/* Code word `at`, a multiple of 2^step; returns its magnitude, 2^24 if the stream is corrupt. */
static uint32_t code_weight(weights *stream, uint64_t expected, size_t at, int32_t step)
{
    int32_t exponent = step;
    uint32_t word = stream->source ? stream->source[at] : 0;
    uint32_t fraction = split(word, &exponent), magnitude = 0, negative = 0;
    if (fraction > 0 && exponent < step)
        magnitude = fraction >> (step - exponent);
    else if (fraction > 0)
        magnitude = fraction << (exponent - step);
    magnitude = code_magnitude(stream, expected, magnitude);
    if (magnitude >> SIGNIFICAND)
        return magnitude;
    if (magnitude > 0)
        negative = clgs_range_code(&stream->coder, word >> 31, 32768);
    if (stream->target)
        stream->target[at] = join(negative, magnitude, step);
    return magnitude;
}

static clgs_error code_layer(weights *stream, const clgs_layer *layer, size_t first, int32_t step)
{
    model *m = stream->model;
    layer_scale scale = {0};
    memset(m->column, 0, sizeof m->column);
    for (size_t i = 0; i < layer->rows; i++) {
        scale.row = scale.row_expected = 0;
        for (size_t j = 0; j < layer->columns; j++) {
            uint64_t expected = expect(&scale, m->column[j], i);
            uint32_t size = code_weight(stream, expected, first + i * layer->columns + j, step);
            if (size >> SIGNIFICAND)
                return CLGS_ERROR_CORRUPT;
            if (stream->coder.failed)
                return CLGS_ERROR_TRUNCATED;
            m->column[j] += size;
            scale.row += size;
            scale.total += size;
            scale.count++;
        }
    }
    return CLGS_OK;
}

/* Code all layers; `steps` are their stored bytes. */
static clgs_error code_layers(weights *stream, const clgs_layer *layer, size_t layers,
                              const uint8_t *steps)
{
    size_t first = 0;
    clgs_error error = CLGS_OK;
    for (size_t l = 0; l < layers && !error; l++) {
        size_t count = (size_t)layer[l].rows * layer[l].columns;
        if (steps[l] > 0)
            error = code_layer(stream, layer + l, first, (int32_t)steps[l] - STEP_BIAS);
        else if (stream->target)
            memset(stream->target + first, 0, 4 * count);
        first += count;
    }
    return error;
}

static void model_init(model *m)
{
    clgs_tables_init(&m->tables);
    clgs_states_init(m->state[0], CLASSES * CLGS_NODES);
    clgs_weights_init(m->weight, CLGS_NODES, 1);
}

/* Number of words of all layers; SIZE_MAX if a shape is out of range. */
static size_t count_words(const clgs_layer *layer, size_t layers)
{
    size_t count = 0;
    if (layers > CLGS_MAX_LAYERS)
        return SIZE_MAX;
    for (size_t l = 0; l < layers; l++) {
        if (layer[l].columns > CLGS_MAX_COLUMNS || layer[l].rows > CLGS_MAX_ROWS)
            return SIZE_MAX;
        count += (size_t)layer[l].rows * layer[l].columns;
    }
    return count;
}

size_t clgs_weights_bound(const clgs_layer *layer, size_t layers)
{
    size_t count = count_words(layer, layers);
    return count == SIZE_MAX ? 0 : clgs_planes_bound(count);
}

/* After the model there is room for the bytes of one mode while another is tried. */
size_t clgs_weights_workspace(const clgs_layer *layer, size_t layers)
{
    size_t planes = clgs_planes_workspace(), own = sizeof(model);
    size_t bound = clgs_weights_bound(layer, layers);
    return bound > 0 ? (own > planes ? own : planes) + bound : 0;
}

/* Bytes written as multiples; 0 if the weights are no multiples or `capacity` is too small. */
static size_t encode_multiples(const uint32_t *word, const clgs_layer *layer, size_t layers,
                               uint8_t *out, size_t capacity, model *m)
{
    weights stream = {.model = m, .source = word};
    size_t first = 0;
    if (capacity < 1 + layers + 1)
        return 0;
    out[0] = MODE_MULTIPLES;
    for (size_t l = 0; l < layers; l++) {
        size_t count = (size_t)layer[l].rows * layer[l].columns;
        uint32_t step = find_step(word + first, count);
        if (step > LAST_STEP)
            return 0;
        out[1 + l] = (uint8_t)step;
        first += count;
    }
    model_init(m);
    clgs_range_begin_encode(&stream.coder, out + 1 + layers, capacity - 1 - layers);
    if (code_layers(&stream, layer, layers, out + 1) != CLGS_OK)
        return 0;
    clgs_range_end_encode(&stream.coder);
    return stream.coder.failed ? 0 : (size_t)(stream.coder.out - out);
}

size_t clgs_weights_encode(const uint32_t *word, const clgs_layer *layer, size_t layers,
                           uint8_t *out, size_t capacity, void *workspace)
{
    size_t bound = clgs_weights_bound(layer, layers);
    if (bound == 0 || capacity < bound)
        return 0;
    uint8_t *spare = (uint8_t *)workspace + clgs_weights_workspace(layer, layers) - bound;
    size_t size = encode_multiples(word, layer, layers, spare, bound, workspace);
    size_t planes = clgs_planes_encode(word, (bound - 1) / 4, out, bound, workspace);
    if (size == 0 || planes <= size)
        return planes;
    memcpy(out, spare, size);
    return size;
}

clgs_error clgs_weights_decode(const uint8_t *data, size_t size, uint32_t *word,
                               const clgs_layer *layer, size_t layers, void *workspace)
{
    weights stream = {.model = workspace, .target = word};
    size_t bound = clgs_weights_bound(layer, layers);
    if (bound == 0)
        return CLGS_ERROR_ARGUMENT;
    if (size == 0 || data[0] != MODE_MULTIPLES)
        return clgs_planes_decode(data, size, word, (bound - 1) / 4, workspace);
    if (size < 1 + layers)
        return CLGS_ERROR_TRUNCATED;
    for (size_t l = 0; l < layers; l++)
        if (data[1 + l] > LAST_STEP)
            return CLGS_ERROR_CORRUPT;
    model_init(stream.model);
    clgs_range_begin_decode(&stream.coder, data + 1 + layers, size - 1 - layers);
    clgs_error error = code_layers(&stream, layer, layers, data + 1);
    return error ? error : clgs_range_end_decode(&stream.coder);
}
