/* Layers of the MLPs for a work-group: GPU form.
 *
 * A group computes SAMPLES samples. The rows of a layer's inputs lie in local memory; a work-item
 * keeps in registers the sums of `units` neighbouring units for a quad of samples. Weights
 * pass through local memory, those of SLICE inputs at a time, so that a work-item reads few numbers
 * for each of its products. Sums go over the inputs in their order, as in the CPU form.
 */
#ifndef CLGS_MLP_GROUP_LAYER_H
#define CLGS_MLP_GROUP_LAYER_H

#include "common/form.h"
#include "common/method.h"
#include "mlp/layout.h"

#ifndef SAMPLES
#define SAMPLES 64
#endif
#ifndef LAYER_ITEMS
#define LAYER_ITEMS 128
#endif
#define LAYER_GROUP GROUP_OF(LAYER_ITEMS)

/* Inputs whose weights are in local memory at a time. */
#ifndef SLICE
#define SLICE 8
#endif

/* Quads of samples, and how many work-items share one. */
#define QUADS (SAMPLES / 4)
#define SHARES (LAYER_ITEMS / QUADS)

/* Units of each work-item in a layer of `layer_units`. */
#define UNITS(layer_units) (((layer_units) + SHARES - 1) / SHARES)
#define MOST_UNITS UNITS(7 * K_OFFSETS)

/* In local memory, rows start in different banks and at multiples of 16 bytes; in a slice of the
 * weights so do the units of a work-item. */
#define ROW_PITCH (SAMPLES + 4)
#define WHOLE_QUADS(units) (((units) + 3) / 4 * 4)
#define SLICE_PITCH (SHARES * WHOLE_QUADS(MOST_UNITS) + 4)
#define SLICE_SIZE (SLICE * SLICE_PITCH)

/* Number i of a vector of four, for a constant i. */
#define NUMBER(four, i) ((i) == 0 ? (four).x : (i) == 1 ? (four).y : (i) == 2 ? (four).z : (four).w)

/* Functions with an argument `units`, a constant: it must be known where their loops are unrolled.
 */
#define CONSTANT_UNITS __attribute__((always_inline))

/* Which of the group's samples and units a work-item computes. */
static inline int own_quad(void)
{
    return (int)get_local_id(0) % QUADS;
}

static inline int own_share(void)
{
    return (int)get_local_id(0) / QUADS;
}

/* Weights of `count` units of a layer: that of unit u and input k is at
 * first[unit_at(u) * unit_stride + input_at(k) * input_stride]; the lists give the places, numbers
 * are their own places if there is no list. */
typedef struct {
    __global const float *first;
    int count;
    int unit_stride;
    int input_stride;
    __local const int *unit_at;
    __local const int *input_at;
} LayerWeights;

/* The weights of all units, a work-item's units side by side, for `some` inputs from `input` on. */
static inline CONSTANT_UNITS void load_slice(const LayerWeights *weights, const int units,
                                             const int input, const int some, __local float *slice)
{
    for (int i = (int)get_local_id(0); i < weights->count * SLICE; i += LAYER_ITEMS) {
        /* neighbouring work-items read neighbouring weights */
        const bool by_input = weights->input_stride == 1;
        const int unit = by_input ? i / SLICE : i % weights->count;
        const int k = by_input ? i % SLICE : i / weights->count;
        if (k >= some)
            continue;
        const int row = weights->unit_at ? weights->unit_at[unit] : unit;
        const int column = weights->input_at ? weights->input_at[input + k] : input + k;
        slice[k * SLICE_PITCH + unit / units * WHOLE_QUADS(units) + unit % units] =
            weights->first[row * weights->unit_stride + column * weights->input_stride];
    }
}

/* sum[u] += weight times row of x, over the inputs of a slice. A function for each width that
 * layers have, a literal number: if it were an argument, AMD's compiler would keep the sums in
 * memory. */
#define DEFINE_ADD_SLICE(name, width)                                                              \
    static inline CONSTANT_UNITS void name(float (*sum)[4], __local const float *slice,            \
                                           __local const float *x, const int some)                 \
    {                                                                                              \
        __local const float4 *rows = (__local const float4 *)x + own_quad();                       \
        __local const float4 *weights =                                                            \
            (__local const float4 *)(slice + own_share() * WHOLE_QUADS(width));                    \
        for (int k = 0; k < some; ++k) {                                                           \
            const float4 quad = rows[k * (ROW_PITCH / 4)];                                         \
            _Pragma("unroll") for (int u = 0; u < (width); ++u)                                    \
            {                                                                                      \
                const float4 four = weights[k * (SLICE_PITCH / 4) + u / 4];                        \
                const float weight = NUMBER(four, u % 4);                                          \
                _Pragma("unroll") for (int i = 0; i < 4; ++i) sum[u][i] =                          \
                    fma(weight, NUMBER(quad, i), sum[u][i]);                                       \
            }                                                                                      \
        }                                                                                          \
    }
DEFINE_ADD_SLICE(add_slice_opacity, UNITS(K_OFFSETS))
DEFINE_ADD_SLICE(add_slice_color, UNITS(3 * K_OFFSETS))
DEFINE_ADD_SLICE(add_slice_hidden, UNITS(HIDDEN_DIM))
DEFINE_ADD_SLICE(add_slice_input, UNITS(INPUT_DIM))
DEFINE_ADD_SLICE(add_slice_covariance, UNITS(7 * K_OFFSETS))

static inline CONSTANT_UNITS void add_slice(float (*sum)[4], const int units,
                                            __local const float *slice, __local const float *x,
                                            const int some)
{
    if (units == UNITS(K_OFFSETS))
        add_slice_opacity(sum, slice, x, some);
    else if (units == UNITS(3 * K_OFFSETS))
        add_slice_color(sum, slice, x, some);
    else if (units == UNITS(HIDDEN_DIM))
        add_slice_hidden(sum, slice, x, some);
    else if (units == UNITS(INPUT_DIM))
        add_slice_input(sum, slice, x, some);
    else
        add_slice_covariance(sum, slice, x, some);
}

/* sum[u] += weights times x, over all `inputs`. units: a constant, at most MOST_UNITS. Begins with
 * a barrier, after which x is read. */
static inline CONSTANT_UNITS void add_layer(float (*sum)[4], const int units,
                                            const LayerWeights *weights, __local const float *x,
                                            const int inputs, __local float *slice)
{
    for (int input = 0; input < inputs; input += SLICE) {
        const int some = min(SLICE, inputs - input);
        barrier(CLK_LOCAL_MEM_FENCE);
        load_slice(weights, units, input, some, slice);
        barrier(CLK_LOCAL_MEM_FENCE);
        if (own_share() * units < weights->count)
            add_slice(sum, units, slice, x + input * ROW_PITCH, some);
    }
}

/* The place of unit number u of a work-item's, in the layer's list. */
static inline int unit_of(const int units, const int u)
{
    return own_share() * units + u;
}

/* Sets all samples of a quad to one number. */
static inline void fill_quad(float quad[4], const float value)
{
#pragma unroll
    for (int i = 0; i < 4; ++i)
        quad[i] = value;
}

static inline float4 whole_quad(const float quad[4])
{
    return (float4)(quad[0], quad[1], quad[2], quad[3]);
}

/* The work-item's quads of the hidden units of one head; a NaN stays one. x: INPUT_DIM rows. */
static inline CONSTANT_UNITS void hidden_quads(__global const float *weight, __local const float *x,
                                               __local float *slice,
                                               float sum[UNITS(HIDDEN_DIM)][4])
{
    const LayerWeights weights = {weight, HIDDEN_DIM, INPUT_DIM, 1, 0, 0};
    __global const float *bias = weight + HIDDEN_DIM * INPUT_DIM;
#pragma unroll
    for (int u = 0; u < UNITS(HIDDEN_DIM); ++u)
        fill_quad(sum[u], bias[min(unit_of(UNITS(HIDDEN_DIM), u), HIDDEN_DIM - 1)]);
    add_layer(sum, UNITS(HIDDEN_DIM), &weights, x, INPUT_DIM, slice);
#pragma unroll
    for (int u = 0; u < UNITS(HIDDEN_DIM); ++u)
#pragma unroll
        for (int i = 0; i < 4; ++i)
            sum[u][i] = sum[u][i] < 0.0f ? 0.0f : sum[u][i];
}

/* Writes a work-item's quads to its rows of local memory. */
static inline CONSTANT_UNITS void store_quads(float (*quads)[4], const int units, const int count,
                                              __local float *rows)
{
#pragma unroll
    for (int u = 0; u < units; ++u)
        if (unit_of(units, u) < count)
            *(__local float4 *)(rows + unit_of(units, u) * ROW_PITCH + 4 * own_quad()) =
                whole_quad(quads[u]);
}

#endif
