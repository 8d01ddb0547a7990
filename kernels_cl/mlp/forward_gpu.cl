/* The three decoding MLPs (opacity, color, covariance), forward: GPU form. Between the two kernels,
 * the one of order_gpu.cl puts the samples of each chunk in the order of their drawn slots. Nothing
 * but the outputs is kept, as in the CPU form.
 *
 * Work-item: some units of each layer for a quad of samples, see group/layer.h.
 * Work-group: SAMPLES samples, LAYER_ITEMS work-items; inputs, hidden values and a slice of the
 *     weights lie in local memory.
 * Launch: a work-group per SAMPLES samples.
 */
#include "common/method.h"
#include "mlp/block/layer.h"
#include "mlp/group/inputs.h"
#include "mlp/group/layer.h"
#include "mlp/inputs.h"
#include "mlp/layout.h"

/* What a group keeps in local memory. */
typedef struct {
    __local float *x;
    __local float *hidden;
    __local float *slice;
    __local int *rows;
} Local;

/* Outputs of one head for the group at `first`: the rows of `slots`, one per bit. `units` a
 * constant. Samples that do not count get 0 or NaN if it is the opacities' head. */
static inline CONSTANT_UNITS void head_forward(__global const float *weight, const int head,
                                               const int units, const int slots,
                                               const Local *memory, __global float *output,
                                               const size_t first, const size_t stride)
{
    float hidden[UNITS(HIDDEN_DIM)][4], sum[MOST_UNITS][4];
    hidden_quads(weight, memory->x, memory->slice, hidden);
    store_quads(hidden, UNITS(HIDDEN_DIM), HIDDEN_DIM, memory->hidden);
    const int count = list_rows(slots, head, memory->rows);
    __global const float *layer = weight + HIDDEN_SIZE;
    const LayerWeights weights = {layer, count, HIDDEN_DIM, 1, memory->rows, 0};
    __global const float *bias = layer + K_OFFSETS * slot_rows(head) * HIDDEN_DIM;
    for (int u = 0; u < MOST_UNITS; ++u)
        fill_quad(sum[u], bias[memory->rows[min(unit_of(units, u), count - 1)]]);
    add_layer(sum, units, &weights, memory->hidden, HIDDEN_DIM, memory->slice);
    const size_t sample = first + (size_t)(4 * own_quad());
    const float4 counts =
        *(__local const float4 *)(memory->x + INPUT_DIM * ROW_PITCH + 4 * own_quad());
#pragma unroll
    for (int u = 0; u < units; ++u) {
#pragma unroll
        for (int i = 0; i < 4; ++i) {
            const bool right = head != OPACITY || NUMBER(counts, i) == 1.0f;
            sum[u][i] = right ? activate(sum[u][i], head) : NUMBER(counts, i);
        }
        if (unit_of(units, u) < count && sample < stride) {
            const size_t row = (size_t)memory->rows[unit_of(units, u)];
            *(__global float4 *)(output + row * stride + sample) = whole_quad(sum[u]);
        }
    }
}

#define DECLARE_LOCAL(name)                                                                        \
    __local float name##_x[(INPUT_DIM + 1) * ROW_PITCH] __attribute__((aligned(16)));              \
    __local float name##_hidden[HIDDEN_DIM * ROW_PITCH] __attribute__((aligned(16)));              \
    __local float name##_slice[SLICE_SIZE] __attribute__((aligned(16)));                           \
    __local int name##_rows[7 * K_OFFSETS];                                                        \
    const Local name = {name##_x, name##_hidden, name##_slice, name##_rows}

/* opacity: (K, padded), in the order of visible. Zero if there is no anchor, NaN if an input is not
 * finite. */
LAYER_GROUP __kernel void mlp_opacity(__global const float *feature, __global const float *position,
                                      __global const int *visible, const int count,
                                      __global const float *weights, __global const float *camera,
                                      const int padded, __global float *opacity)
{
    const size_t first = get_group_id(0) * SAMPLES, stride = (size_t)padded;
    const Inputs inputs = {feature, position, visible, (size_t)count, camera};
    DECLARE_LOCAL(memory);
    __local int shared;
    const int item = (int)get_local_id(0);
    if (group_or(anchor_of(&inputs, first + (size_t)(item % SAMPLES)) >= 0 ? 1 : 0, &shared) == 0) {
        for (int i = item; i < K_OFFSETS * SAMPLES; i += LAYER_ITEMS) /* padding */
            if (first + (size_t)(i % SAMPLES) < stride)
                opacity[(size_t)(i / SAMPLES) * stride + first + (size_t)(i % SAMPLES)] = 0.0f;
        return;
    }
    gather_rows(&inputs, first, memory.x);
    head_forward(weights, OPACITY, UNITS(K_OFFSETS), (1 << K_OFFSETS) - 1, &memory, opacity, first,
                 stride);
}

/* Color and covariance rows of output (110, padded), whose opacities are there. Rows of slots that
 * no sample of the group draws are left as they are. */
LAYER_GROUP __kernel void mlp_heads(__global const float *feature, __global const float *position,
                                    __global const int *visible, const int count,
                                    __global const float *weights, __global const float *camera,
                                    const int padded, __global float *output)
{
    const size_t first = get_group_id(0) * SAMPLES, stride = (size_t)padded;
    const Inputs inputs = {feature, position, visible, (size_t)count, camera};
    DECLARE_LOCAL(memory);
    __local int shared;
    const int slots = group_slots(output, first, stride, stride, &shared);
    if (slots == 0)
        return;
    gather_rows(&inputs, first, memory.x);
    head_forward(weights + head_start(COLOR), COLOR, UNITS(3 * K_OFFSETS), slots, &memory,
                 output + first_output(COLOR) * stride, first, stride);
    head_forward(weights + head_start(COVARIANCE), COVARIANCE, UNITS(7 * K_OFFSETS), slots, &memory,
                 output + first_output(COVARIANCE) * stride, first, stride);
}
