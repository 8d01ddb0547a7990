/* Model of attribute channels: what the header of a stream says, and what every chunk follows.
 *
 * A channel's values lose their centre and a linear prediction; the residuals become symbols and
 * literal bits; each symbol is coded by the table of its class, which earlier symbols choose.
 */
#ifndef CLGS_ATTRIBUTES_MODEL_H
#define CLGS_ATTRIBUTES_MODEL_H

#include "clgs_codec.h"

#define CLGS_TAPS 16       /* terms of a prediction */
#define CLGS_TAP_REACH 3   /* rows that a term may lie before or after */
#define CLGS_TAP_NEAR (-4) /* in place of a row: the mean of the near rows */
#define CLGS_FACTOR_BITS 8 /* factors are in 1/256 */
#define CLGS_MAX_FACTOR 2047
#define CLGS_TAP_CLAMP 32767 /* predictions use values within this of their centre */
#define CLGS_MAX_GAIN 65535
#define CLGS_GAIN_BITS 4
#define CLGS_MAX_WEIGHT 8191
#define CLGS_WEIGHT_BITS 10
#define CLGS_MAX_MAGNITUDE 255
#define CLGS_MAX_ACTIVITY 1023
#define CLGS_MAX_SPAN 2
#define CLGS_LEVELS 32               /* levels of activity */
#define CLGS_CELLS (2 * CLGS_LEVELS) /* a level, and whether symbols before differ from 0 */
#define CLGS_CLASSES 16
#define CLGS_DIRECT 128   /* smaller residuals are symbols of their own */
#define CLGS_ALPHABET 228 /* the others share four symbols an octave */
#define CLGS_TABLE 256    /* entries of a table of symbols */
#define CLGS_SCALE_BITS 12
#define CLGS_SCALE (1u << CLGS_SCALE_BITS)

/* Known channels are not coded: both sides have their values, and others may look at them. Sided
 * ones have tables, too; how far their terms are from 0 chooses these, and their sign is that of
 * residuals. */
enum { CLGS_STATIC = 0, CLGS_MIXED = 1, CLGS_KNOWN = 2, CLGS_SIDED = 3 };

typedef struct clgs_tap {
    int32_t channel; /* this one or an earlier one */
    int32_t row;     /* relative; an earlier one if the channel is this one; or CLGS_TAP_NEAR */
    int32_t factor;
} clgs_tap;

/* One channel; the same layout as the array that the caller holds: no padding. */
typedef struct clgs_channel {
    int32_t centre;
    int32_t taps;
    clgs_tap tap[CLGS_TAPS];
    int32_t gain;      /* magnitude = symbol's size * gain >> CLGS_GAIN_BITS */
    int32_t weight[3]; /* of activity: own column, this row, the rows above and below it */
    int32_t span;      /* earlier channels whose symbols are looked at for zeros */
    int32_t coder;
    int32_t classes;
    uint8_t class_of[CLGS_CELLS];
    uint16_t frequency[CLGS_CLASSES][CLGS_TABLE];
} clgs_channel;

_Static_assert(sizeof(clgs_channel) == 57 * 4 + CLGS_CELLS + CLGS_CLASSES * CLGS_TABLE * 2,
               "the caller's array has this layout");

/* Whether every field is in range, so that chunks can follow the model without further checks. */
int clgs_model_valid(const clgs_channel *channel, size_t channels);

static inline int clgs_has_tables(const clgs_channel *channel)
{
    return channel->coder == CLGS_STATIC || channel->coder == CLGS_SIDED;
}

/* Whether levels of more than one number occur among the cells of a channel's symbols. */
static inline int clgs_has_levels(const clgs_channel *channel)
{
    return channel->weight[0] || channel->weight[1] || channel->weight[2] ||
           channel->coder == CLGS_SIDED;
}

/* Whether a channel's symbols fall into more than one cell. */
static inline int clgs_has_cells(const clgs_channel *channel)
{
    return channel->span || clgs_has_levels(channel);
}

/* Literal bits that follow a symbol of CLGS_DIRECT or more. */
static inline uint32_t clgs_literal_bits(uint32_t symbol)
{
    return 5 + (symbol - CLGS_DIRECT) / 4;
}

#endif
