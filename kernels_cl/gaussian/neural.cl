/* Neural Gaussians: the slots of the visible anchors whose opacity is positive, and the way back.
 *
 * Work-item: VEC visible anchors, counted from the middle of the view on, with all their slots. The
 *     drawn slots are gathered one after the other, and arithmetic goes by lanes over them.
 *     neural_pad: a Gaussian.
 * Work-group: any.
 * Launch: a work-item per VEC visible anchors, in neural_backward per VEC columns of output.
 *
 * output is feature-major, (11 K, padded): K opacities, 3 K colors, 7 K covariance numbers. Outputs
 * of slots that are not drawn may hold anything. An entry -1 of visible is no anchor, and Gaussians
 * from number `capacity` on are left out.
 */
#include "common/items.h"
#include "common/method.h"
#include "common/prefetch.h"
#include "common/real.h"
#include "common/rows.h"
#include "gaussian/drawn_slots.h"
#include "gaussian/log_scale.h"
#include "gaussian/output_rows.h"
#include "gaussian/shapes.h"
#include "gaussian/unit_quaternion.h"
#include "gaussian/visible_anchors.h"

/* Arrays of all Gaussians. slot: number of the visible anchor times K, plus that of the slot. */
typedef struct {
    __global float *mean;
    __global float *scale;
    __global float *rotation;
    __global float *color;
    __global float *opacity;
    __global int *slot;
} Gaussians;

/* Writes the Gaussians of the drawn slots, at least one, of the visible anchors from v on. */
static inline void write_gaussians(const VisibleAnchors *anchors, const DrawnSlots *drawn,
                                   const size_t v, const OutputRows *rows, const Gaussians *out)
{
    const AnchorLanes a = load_anchors(anchors->visible, anchors->scaling, v, anchors->count);
    Shapes shapes;
    float mean[3][SLOTS];
    gather_shapes(&a, drawn, rows, &shapes);
    gather_means(anchors, &a, drawn, mean);
    for (size_t m = 0; m < DRAWN(drawn); m += VEC) {
        const size_t n = drawn->first + m, used = min((size_t)VEC, DRAWN(drawn) - m);
        fv scale[3], rotation[4];
        load_shapes(&shapes, m, scale, rotation);
        store_rows3(scale, out->scale, n, used);
        store_rows4(rotation, out->rotation, n, used);
    }
    for (size_t m = 0; m < DRAWN(drawn); ++m) {
        const size_t n = drawn->first + m, j = drawn->offset[m];
        ROW_SPACE const float *sample = rows->at + drawn->lane[m];
#pragma unroll
        for (int i = 0; i < 3; ++i) {
            out->mean[3 * n + i] = mean[i][m];
            out->color[3 * n + i] = sample[(COLOR_ROW + 3 * j + i) * rows->stride];
        }
        out->opacity[n] = sample[j * rows->stride];
        out->slot[n] = (int)((v + drawn->lane[m]) * K_OFFSETS + j);
    }
}

/* The Gaussians of visible anchor v get the numbers from first[v] on. */
__kernel void neural_forward(__global const float *output, __global const int *visible,
                             __global const int *first, __global const int *bits, const int count,
                             const int padded, const int capacity, __global const float *position,
                             __global const float *offset, __global const float *scaling,
                             __global float *mean, __global float *scale, __global float *rotation,
                             __global float *color, __global float *opacity, __global int *slot)
{
    const size_t v = item_from_middle() * VEC, stride = (size_t)padded;
    ComingSlots coming = coming_slots(bits, first, v, (size_t)count, (size_t)capacity);
    if (coming.left == 0 || coming.number >= coming.capacity)
        return;
    const VisibleAnchors anchors = {visible, (size_t)count, position, offset, scaling};
    const Gaussians gaussians = {mean, scale, rotation, color, opacity, slot};
    prefetch_anchors(&anchors, v + VEC, VEC);
    DECLARE_OUTPUT_ROWS(rows, output, stride, v, coming.left, 0);
    DrawnSlots drawn;
    while (next_slots(&coming, &drawn))
        if (drawn.count != 0)
            write_gaussians(&anchors, &drawn, v, &rows, &gaussians);
}

/* Gaussians after the last one get zeros, and the slot -1. */
__kernel void neural_pad(__global const long *total, const int capacity, __global float *mean,
                         __global float *scale, __global float *rotation, __global float *color,
                         __global float *opacity, __global int *slot)
{
    const size_t n = get_global_id(0);
    if (n >= (size_t)capacity || (long)n < *total)
        return;
    vstore3((float3)(0.0f), n, mean);
    vstore3((float3)(0.0f), n, scale);
    vstore4((float4)(0.0f), n, rotation);
    vstore3((float3)(0.0f), n, color);
    opacity[n] = 0.0f;
    slot[n] = -1;
}

/* d * x, but zero if d is zero, even if x is not finite: a bad number never leaves its anchor. */
static inline fv times(const fv d, const fv x)
{
    return d == (fv)(0.0f) ? (fv)(0.0f) : d * x;
}

/* d, but zero if the log scale was clamped. */
static inline float unclamped(const float d, const float log_scale)
{
    return fabs(log_scale) <= LOG_SCALE_LIMIT ? d : 0.0f;
}

/* Replaces the shapes by the gradients by them: by log size, by scale logit and by quaternion. */
static inline void shapes_backward(const DrawnSlots *drawn, __global const float *d_scale,
                                   __global const float *d_rotation, Shapes *shapes)
{
    for (size_t m = 0; m < DRAWN(drawn); m += VEC) {
        const size_t used = min((size_t)VEC, DRAWN(drawn) - m);
        fv d_size[3], d_unit[4], unit[4], along = (fv)(0.0f);
        load_rows3(d_scale, drawn->first + m, used, d_size);
        load_rows4(d_rotation, drawn->first + m, used, d_unit);
        for (int i = 0; i < 3; ++i) {
            const fv fraction = sigmoid_v(LOAD_V(0, shapes->logit[i] + m));
            const fv d_log = times(d_size[i], LOAD_V(0, shapes->size[i] + m) * fraction);
            STORE_V(d_log, 0, shapes->size[i] + m);
            STORE_V(times(d_log, 1.0f - fraction), 0, shapes->logit[i] + m);
        }
        for (int i = 0; i < 4; ++i)
            unit[i] = LOAD_V(0, shapes->quaternion[i] + m);
        /* for n = q / |q|: the part of dL/dn across n, by the length */
        const fv on_length = make_unit(unit);
        for (int i = 0; i < 4; ++i)
            along = fma(d_unit[i], unit[i], along);
        for (int i = 0; i < 4; ++i)
            STORE_V((d_unit[i] - along * unit[i]) * on_length, 0, shapes->quaternion[i] + m);
    }
}

#if VEC == 1
/* Writes a slot's rows of a column of d_output: gradients by its outputs, or zeros if its Gaussian
 * is left out. */
static inline void write_output(const DrawnSlots *drawn, const Shapes *shapes,
                                __global const float *d_color, __global const float *d_opacity,
                                const size_t stride, __global float *d_output)
{
    const size_t n = drawn->first, j = drawn->offset[0];
    const bool known = drawn->count != 0;
    __global float *covariance = d_output + (COVARIANCE_ROW + 7 * j) * stride;
    d_output[j * stride] = known ? d_opacity[n] : 0.0f;
#pragma unroll
    for (size_t i = 0; i < 3; ++i) {
        d_output[(COLOR_ROW + 3 * j + i) * stride] = known ? d_color[3 * n + i] : 0.0f;
        covariance[i * stride] = known ? shapes->logit[i][0] : 0.0f;
    }
#pragma unroll
    for (size_t i = 0; i < 4; ++i)
        covariance[(3 + i) * stride] = known ? shapes->quaternion[i][0] : 0.0f;
}
#else
/* Writes VEC columns of d_output, but only rows of slots that some anchor draws: gradients by the
 * outputs of drawn slots, zeros for the others. */
static inline void write_output(const DrawnSlots *drawn, const Shapes *shapes,
                                __global const float *d_color, __global const float *d_opacity,
                                const size_t stride, __global float *d_output)
{
    float rows[OUTPUT_ROWS * VEC];
    for (size_t j = 0; j < K_OFFSETS; ++j)
        for (size_t i = 0; (drawn->slots >> j & 1) && i < SLOT_ROWS; ++i)
            STORE_V((fv)(0.0f), slot_row(j, i), rows);
    for (size_t m = 0; m < drawn->count; ++m) {
        const size_t n = drawn->first + m, j = drawn->offset[m];
        float *sample = rows + drawn->lane[m];
        float *covariance = sample + (COVARIANCE_ROW + 7 * j) * VEC;
#pragma unroll
        for (int i = 0; i < 3; ++i) {
            sample[(COLOR_ROW + 3 * j + i) * VEC] = d_color[3 * n + i];
            covariance[i * VEC] = shapes->logit[i][m];
        }
#pragma unroll
        for (int i = 0; i < 4; ++i)
            covariance[(3 + i) * VEC] = shapes->quaternion[i][m];
        sample[j * VEC] = d_opacity[n];
    }
    for (size_t j = 0; j < K_OFFSETS; ++j) {
        for (size_t i = 0; (drawn->slots >> j & 1) && i < SLOT_ROWS; ++i) {
            const size_t row = slot_row(j, i);
            PREFETCH_WRITE(d_output + row * stride + LINE);
            STORE_V(LOAD_V(row, rows), 0, d_output + row * stride);
        }
    }
}
#endif

/* Writes d_offset of the drawn slots, and adds to `sum`, the gradients by the log scales of the
 * anchors. */
static inline void add_anchors(const AnchorLanes *a, const DrawnSlots *drawn, const Shapes *shapes,
                               __global const float *d_mean, __global const float *offset,
                               __global float *d_offset, float sum[6][VEC])
{
    float reach[3][VEC];
    for (int i = 0; i < 3; ++i)
        STORE_V(exp_log_scale(LOAD_V(0, a->log_scale[i])), 0, reach[i]);
    for (size_t m = 0; m < DRAWN(drawn); ++m) {
        const size_t lane = drawn->lane[m], n = drawn->first + m;
        const size_t step = 3 * ((size_t)a->anchor[lane] * K_OFFSETS + drawn->offset[m]);
#pragma unroll
        for (int i = 0; i < 3; ++i) {
            const float d = d_mean[3 * n + i], scaled = d * reach[i][lane];
            const float d_step = d == 0.0f ? 0.0f : scaled, product = d_step * offset[step + i];
            d_offset[step + i] = d_step;
            sum[i][lane] += d_step == 0.0f ? 0.0f : product;
            sum[3 + i][lane] += shapes->size[i][m];
        }
    }
}

/* Writes d_scaling of the anchors. */
static inline void write_scaling(const AnchorLanes *a, float sum[6][VEC], __global float *d_scaling)
{
    for (size_t lane = 0; lane < VEC; ++lane)
        for (int i = 0; i < 6 && a->anchor[lane] >= 0; ++i)
            d_scaling[6 * (size_t)a->anchor[lane] + i] =
                unclamped(sum[i][lane], a->log_scale[i][lane]);
}

/* Prefetches what add_anchors reads, and what is written, of the VEC anchors from v on. */
static inline void prefetch_gradients(const VisibleAnchors *anchors, const size_t v,
                                      __global float *d_offset, __global float *d_scaling)
{
    prefetch_anchors(anchors, v, VEC);
    for (size_t lane = 0; lane < VEC && v + lane < anchors->count; ++lane) {
        const size_t anchor = (size_t)max(anchors->visible[v + lane], 0);
        PREFETCH_WRITE(d_scaling + 6 * anchor);
        for (size_t i = 0; i < 3 * K_OFFSETS; i += LINE)
            PREFETCH_WRITE(d_offset + 3 * K_OFFSETS * anchor + i);
        PREFETCH_WRITE(d_offset + 3 * K_OFFSETS * (anchor + 1) - 1);
    }
}

/* d_output: (11 K, padded); rows of slots that are not drawn may stay as they were. d_offset and
 * d_scaling are those of all anchors, zero before. */
__kernel void neural_backward(__global const float *output, __global const int *visible,
                              __global const int *first, __global const int *bits, const int count,
                              const int padded, const int capacity, __global const float *offset,
                              __global const float *scaling, __global const float *d_mean,
                              __global const float *d_scale, __global const float *d_rotation,
                              __global const float *d_color, __global const float *d_opacity,
                              __global float *d_output, __global float *d_offset,
                              __global float *d_scaling)
{
    const size_t v = item_from_middle() * VEC, stride = (size_t)padded;
    ComingSlots coming = coming_slots(bits, first, v, (size_t)count, (size_t)capacity);
    const VisibleAnchors anchors = {visible, (size_t)count, 0, offset, scaling};
    prefetch_gradients(&anchors, v + VEC, d_offset, d_scaling);
    if (coming.left == 0)
        return;
    DECLARE_OUTPUT_ROWS(rows, output, stride, v, coming.left, COVARIANCE_ROW);
    float sum[6][VEC];
    for (int i = 0; i < 6; ++i)
        STORE_V((fv)(0.0f), 0, sum[i]);
    const bool within = coming.number < coming.capacity;
    Shapes shapes;
    DrawnSlots drawn;
    while (next_slots(&coming, &drawn)) {
        /* once per slot: to keep them through the loop takes more registers than some GPUs have */
        const AnchorLanes a = load_anchors(visible, scaling, v, (size_t)count);
        if (drawn.count != 0) {
            gather_shapes(&a, &drawn, &rows, &shapes);
            shapes_backward(&drawn, d_scale, d_rotation, &shapes);
            add_anchors(&a, &drawn, &shapes, d_mean, offset, d_offset, sum);
        }
        write_output(&drawn, &shapes, d_color, d_opacity, stride, d_output + v);
    }
    if (within) {
        const AnchorLanes a = load_anchors(visible, scaling, v, (size_t)count);
        write_scaling(&a, sum, d_scaling);
    }
}
