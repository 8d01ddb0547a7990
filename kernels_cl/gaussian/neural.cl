/* Neural Gaussians: the slots of the visible anchors whose opacity is positive, and the way back.
 *
 * output is feature-major, (11 K, padded): K opacities, 3 K colors, 7 K covariance numbers, for
 * each slot three scale logits and a quaternion w x y z. A work-item owns VEC visible anchors;
 * the slots of theirs that are drawn are gathered one behind the other, and arithmetic goes by
 * lanes over those. Outputs of slots that are not drawn may hold anything. A gradient of zero stays
 * zero whatever it is multiplied with, so that a bad number never leaves its own anchor. An entry
 * -1 of visible is no anchor, and Gaussians from number `capacity` on are left out.
 */
#include "gaussian/anchors.h"
#include "gaussian/gaussians.h"
#include "common/items.h"
#include "common/real.h"
#include "common/rows.h"

/* One work-item VEC visible anchors: which of their opacities are positive, and how many. NaN is
 * not positive. */
__kernel void neural_count(__global const float *output, __global const int *visible,
                           const int count, const int padded, __global int *drawn,
                           __global int *counts)
{
    const size_t v = item_from_middle() * VEC;
    if (v >= (size_t)count)
        return;
    iv bits = (iv)(0);
    for (int j = 0; j < K_OFFSETS; ++j) {
        const fv opacity = LOAD_V(0, output + (size_t)j * (size_t)padded + v);
        bits |= opacity > (fv)(0.0f) ? (iv)(1 << j) : (iv)(0);
    }
    int lanes[VEC];
    STORE_V(bits, 0, lanes);
    for (size_t lane = 0; lane < VEC && v + lane < (size_t)count; ++lane) {
        const int positive = visible[v + lane] >= 0 ? lanes[lane] : 0;
        drawn[v + lane] = positive;
        counts[v + lane] = popcount(positive);
    }
}

/* One work-item VEC visible anchors; the Gaussians of anchor v go to first[v] and on. */
__kernel void neural_forward(__global const float *output, __global const int *visible,
                             __global const int *first, __global const int *bits, const int count,
                             const int padded, const int capacity, __global const float *position,
                             __global const float *offset, __global const float *scaling,
                             __global float *mean, __global float *scale, __global float *rotation,
                             __global float *color, __global float *opacity, __global int *slot)
{
    const size_t v = item_from_middle() * VEC, stride = (size_t)padded;
    const Drawn drawn = list_drawn(bits, first, v, (size_t)count, (size_t)capacity);
    if (drawn.count == 0)
        return;
    const Parameters parameters = {visible, (size_t)count, position, offset, scaling};
    const Gaussians gaussians = {mean, scale, rotation, color, opacity, slot};
    fetch_parameters(&parameters, v, VEC);
    STAGE(rows, output, stride, v, drawn.slots, 0);
    write_gaussians(&parameters, &drawn, v, rows, rows_stride, &gaussians);
}

/* One work-item a place for a Gaussian: those behind the last get zeros, and the slot -1. */
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

/* d * x, but zero where d is zero, even if x is not finite. */
static inline fv times(const fv d, const fv x)
{
    return d == (fv)(0.0f) ? (fv)(0.0f) : d * x;
}

/* Zero where a log scale was clamped. */
static inline float unclamped(const float d, const float log_scale)
{
    return fabs(log_scale) <= LOG_SCALE_LIMIT ? d : 0.0f;
}

/* Gradients of the drawn slots in place of what they are gradients by: by log size, by scale logit
 * and by quaternion. */
static inline void shapes_backward(const Drawn *drawn, __global const float *d_scale,
                                   __global const float *d_rotation, Shapes *shapes)
{
    for (size_t m = 0; m < drawn->count; m += VEC) {
        const size_t used = min((size_t)VEC, drawn->count - m);
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

/* Columns of d_output, of the slots that some anchor draws: gradients of the drawn slots, zeros of
 * the others. */
static inline void write_output(const Drawn *drawn, const Shapes *shapes,
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

/* d_offset of the drawn slots, and d_scaling of the anchors: sums over their slots. */
static inline void write_anchors(const Anchors *a, const Drawn *drawn, const Shapes *shapes,
                                 __global const float *d_mean, __global const float *offset,
                                 __global float *d_offset, __global float *d_scaling)
{
    float reach[3][VEC], sum[6][VEC];
    for (int i = 0; i < 3; ++i)
        STORE_V(bounded_exp(a->log_scale[i]), 0, reach[i]);
    for (int i = 0; i < 6; ++i)
        STORE_V((fv)(0.0f), 0, sum[i]);
    for (size_t m = 0; m < drawn->count; ++m) {
        const size_t lane = drawn->lane[m], n = drawn->first + m;
        const size_t step = 3 * ((size_t)a->anchor[lane] * K_OFFSETS + drawn->offset[m]);
#pragma unroll
        for (int i = 0; i < 3; ++i) {
            const float d = d_mean[3 * n + i], d_step = d == 0.0f ? 0.0f : d * reach[i][lane];
            d_offset[step + i] = d_step;
            sum[i][lane] += d_step == 0.0f ? 0.0f : d_step * offset[step + i];
            sum[3 + i][lane] += shapes->size[i][m];
        }
    }
    for (size_t lane = 0; lane < VEC; ++lane)
        for (int i = 0; i < 6 && a->anchor[lane] >= 0; ++i)
            d_scaling[6 * (size_t)a->anchor[lane] + i] =
                unclamped(sum[i][lane], a->log_scale[i][lane]);
}

/* What write_anchors reads and writes of the VEC anchors from v on. */
static inline void fetch_anchors(__global const int *visible, const size_t v, const size_t count,
                                 __global const float *offset, __global const float *scaling,
                                 __global float *d_offset, __global float *d_scaling)
{
    for (size_t lane = 0; lane < VEC && v + lane < count; ++lane) {
        const size_t anchor = (size_t)max(visible[v + lane], 0);
        PREFETCH(scaling + 6 * anchor);
        PREFETCH_WRITE(d_scaling + 6 * anchor);
        for (size_t i = 0; i < 3 * K_OFFSETS; i += LINE) {
            PREFETCH(offset + 3 * K_OFFSETS * anchor + i);
            PREFETCH_WRITE(d_offset + 3 * K_OFFSETS * anchor + i);
        }
    }
}

/* One work-item VEC columns of d_output: where a slot is not drawn it may stay as it was.
 * d_offset and d_scaling are dense and zero before. */
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
    const Drawn drawn = list_drawn(bits, first, v, (size_t)count, (size_t)capacity);
    Shapes shapes;
    fetch_anchors(visible, v + VEC, (size_t)count, offset, scaling, d_offset, d_scaling);
    if (drawn.count != 0) {
        const Anchors a = load_anchors(visible, scaling, v, (size_t)count);
        STAGE(covariance, output, stride, v, drawn.slots, COVARIANCE_ROW);
        gather_shapes(&a, &drawn, covariance, covariance_stride, &shapes);
        shapes_backward(&drawn, d_scale, d_rotation, &shapes);
        write_anchors(&a, &drawn, &shapes, d_mean, offset, d_offset, d_scaling);
    }
    write_output(&drawn, &shapes, d_color, d_opacity, stride, d_output + v);
}

/* One work-item a visible anchor: dL/d(position) is the sum over its Gaussians. */
__kernel void neural_backward_position(__global const int *visible, __global const int *first,
                                       const int count, const int capacity,
                                       __global const float *d_mean, __global float *d_position)
{
    const size_t v = get_global_id(0);
    if (v >= (size_t)count || visible[v] < 0)
        return;
    const size_t end = min((size_t)first[v + 1], (size_t)capacity);
    for (size_t i = 0; i < 3; ++i) {
        float sum = 0.0f;
        for (size_t n = (size_t)first[v]; n < end; ++n)
            sum += d_mean[3 * n + i];
        d_position[3 * (size_t)visible[v] + i] = sum;
    }
}
