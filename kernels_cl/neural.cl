/* Neural Gaussians: the slots of the visible anchors whose opacity is positive, and the way back.
 *
 * output is feature-major, (11 K, padded): K opacities, 3 K colors, 7 K covariance numbers, for
 * each slot three scale logits and a quaternion w x y z. A work-item owns VEC visible anchors,
 * one a lane: what needs arithmetic goes by lanes, what is scattered anchor by anchor. A gradient
 * of zero stays zero whatever it is multiplied with, so that a bad number never leaves its own
 * anchor.
 */
#include "include/real.h"

#ifndef K_OFFSETS
#define K_OFFSETS 10
#endif
#ifndef LOG_SCALE_LIMIT
#define LOG_SCALE_LIMIT 20.0f
#endif

#define COLOR_ROW K_OFFSETS
#define COVARIANCE_ROW (4 * K_OFFSETS)

/* A quaternion whose largest component lies outside of these has no direction. */
#define QUATERNION_MIN 1e-35f
#define QUATERNION_MAX 1e37f

/* VEC visible anchors; lanes past the last hold zeros and are not used. */
typedef struct {
    size_t used;        /* lanes with an anchor */
    size_t anchor[VEC]; /* its index */
    size_t first[VEC];  /* number of its first Gaussian */
    float log_scale[6][VEC];
} Anchors;

inline Anchors load_anchors(__global const int *visible, __global const int *first,
                            __global const float *scaling, const size_t v, const size_t count)
{
    Anchors a;
    a.used = v < count ? min((size_t)VEC, count - v) : 0;
    for (size_t lane = 0; lane < VEC; ++lane) {
        const bool used = lane < a.used;
        a.anchor[lane] = used ? (size_t)visible[v + lane] : 0;
        a.first[lane] = used ? (size_t)first[v + lane] : 0;
        for (size_t i = 0; i < 6; ++i)
            a.log_scale[i][lane] = used ? scaling[6 * a.anchor[lane] + i] : 0.0f;
    }
    return a;
}

/* e^x of VEC log scales, clamped; NaN stays NaN. */
inline fv bounded_exp(const float *log_scale)
{
    const fv x = LOAD_V(0, log_scale);
    const fv raised = x < (fv)(-LOG_SCALE_LIMIT) ? (fv)(-LOG_SCALE_LIMIT) : x;
    return exp_v(raised > (fv)(LOG_SCALE_LIMIT) ? (fv)(LOG_SCALE_LIMIT) : raised);
}

inline fv larger(const fv a, const fv b)
{
    return a > b ? a : b;
}

/* Unit quaternions along four rows, and the reciprocals of their lengths; zeros where there is no
 * direction. Scaling by the largest component first keeps squares from overflow and underflow. */
inline fv unit_quaternion(__global const float *rows, const size_t stride, fv unit[4])
{
    for (int i = 0; i < 4; ++i)
        unit[i] = LOAD_V(0, rows + i * stride);
    const fv largest =
        larger(larger(fabs(unit[0]), fabs(unit[1])), larger(fabs(unit[2]), fabs(unit[3])));
    const fv shrink = 1.0f / largest;
    fv square = (fv)(0.0f);
    for (int i = 0; i < 4; ++i) {
        unit[i] *= shrink;
        square = fma(unit[i], unit[i], square);
    }
    /* written so that a NaN in any component fails */
    const iv valid = (largest > (fv)(QUATERNION_MIN)) & (largest < (fv)(QUATERNION_MAX)) &
                     (square >= (fv)(0.99f));
    const fv on_length = 1.0f / sqrt(square);
    for (int i = 0; i < 4; ++i)
        unit[i] = valid ? unit[i] * on_length : (fv)(0.0f);
    return valid ? on_length * shrink : (fv)(0.0f);
}

/* One work-item a visible anchor: how many of its opacities are positive. */
__kernel void neural_count(__global const float *output, const int count, const int padded,
                           __global int *counts)
{
    const int v = (int)get_global_id(0);
    if (v >= count)
        return;
    int positive = 0;
    for (int j = 0; j < K_OFFSETS; ++j)
        positive += output[(size_t)j * (size_t)padded + (size_t)v] > 0.0f ? 1 : 0;
    counts[v] = positive;
}

/* Slots of one anchor with a positive opacity, in order; returns how many. NaN is not positive. */
inline int list_drawn(__global const float *alpha, const size_t stride, int drawn[K_OFFSETS])
{
    int count = 0;
#pragma unroll
    for (int j = 0; j < K_OFFSETS; ++j) {
        drawn[count] = j; /* overwritten unless it counts: cheaper than a branch */
        count += alpha[j * stride] > 0.0f ? 1 : 0;
    }
    return count;
}

/* Scales and unit quaternions of VEC slots, as rows of VEC numbers. */
inline void decode_shape(__global const float *covariance, const size_t stride, const fv size[3],
                         float shape[7][VEC])
{
    for (int i = 0; i < 3; ++i)
        STORE_V(size[i] * sigmoid_v(LOAD_V(0, covariance + i * stride)), 0, shape[i]);
    fv unit[4];
    unit_quaternion(covariance + 3 * stride, stride, unit);
    for (int i = 0; i < 4; ++i)
        STORE_V(unit[i], 0, shape[3 + i]);
}

/* One work-item VEC visible anchors; the Gaussians of anchor v go to first[v] and on. */
__kernel void neural_forward(__global const float *output, __global const int *visible,
                             __global const int *first, const int count, const int padded,
                             __global const float *position, __global const float *offset,
                             __global const float *scaling, __global float *mean,
                             __global float *scale, __global float *rotation, __global float *color,
                             __global float *opacity, __global int *slot)
{
    const size_t v = get_global_id(0) * VEC, stride = (size_t)padded;
    if (v >= (size_t)count)
        return;
    Anchors a = load_anchors(visible, first, scaling, v, (size_t)count);
    float reach[3][VEC];
    fv size[3];
    for (int i = 0; i < 3; ++i) {
        STORE_V(bounded_exp(a.log_scale[i]), 0, reach[i]);
        size[i] = bounded_exp(a.log_scale[3 + i]);
    }
    float shape[K_OFFSETS][7][VEC];
    for (int j = 0; j < K_OFFSETS; ++j)
        decode_shape(output + (COVARIANCE_ROW + 7 * j) * stride + v, stride, size, shape[j]);
    for (size_t lane = 0; lane < a.used; ++lane) {
        const size_t anchor = a.anchor[lane];
        __global const float *sample = output + v + lane;
        int drawn[K_OFFSETS];
        const int draws = list_drawn(sample, stride, drawn);
        for (int draw = 0; draw < draws; ++draw) {
            const size_t n = a.first[lane] + draw;
            const int j = drawn[draw];
#pragma unroll
            for (int i = 0; i < 3; ++i) {
                mean[3 * n + i] = fma(offset[3 * (anchor * K_OFFSETS + j) + i], reach[i][lane],
                                      position[3 * anchor + i]);
                scale[3 * n + i] = shape[j][i][lane];
                color[3 * n + i] = sample[(COLOR_ROW + 3 * j + i) * stride];
            }
#pragma unroll
            for (int i = 0; i < 4; ++i)
                rotation[4 * n + i] = shape[j][3 + i][lane];
            opacity[n] = sample[j * stride];
            slot[n] = (int)(v + lane) * K_OFFSETS + j;
        }
    }
}

/* The gradients of VEC slots, a row of VEC numbers each; zeros where nothing was drawn. */
typedef struct {
    float scale[3][VEC];
    float rotation[4][VEC];
    float color[3][VEC];
    float opacity[VEC];
} SlotGradients;

#define SLOT_GRADIENT_ROWS 11

/* d * x, but zero where d is zero, even if x is not finite. */
inline fv times(const fv d, const fv x)
{
    return d == (fv)(0.0f) ? (fv)(0.0f) : d * x;
}

/* Gradients by scale logits and quaternions of VEC slots; adds those by log scale. */
inline void covariance_backward(__global const float *covariance, const size_t stride,
                                const fv size[3], const SlotGradients *d, fv d_log_size[3],
                                __global float *d_covariance)
{
    for (int i = 0; i < 3; ++i) {
        const fv fraction = sigmoid_v(LOAD_V(0, covariance + i * stride));
        const fv d_log = times(LOAD_V(0, d->scale[i]), size[i] * fraction);
        d_log_size[i] += d_log;
        STORE_V(times(d_log, 1.0f - fraction), 0, d_covariance + i * stride);
    }
    /* for n = q / |q|: the part of dL/dn across n, by the length */
    fv unit[4], along = (fv)(0.0f);
    const fv on_length = unit_quaternion(covariance + 3 * stride, stride, unit);
    for (int i = 0; i < 4; ++i)
        along = fma(LOAD_V(0, d->rotation[i]), unit[i], along);
    for (int i = 0; i < 4; ++i)
        STORE_V((LOAD_V(0, d->rotation[i]) - along * unit[i]) * on_length, 0,
                d_covariance + (3 + i) * stride);
}

/* dL/d(offset) and its share of dL/d(log scale) for slot j of an anchor and its Gaussian n. */
inline void step_backward(__global const float *d_mean, const size_t n, const float reach[3],
                          __global const float *offset, __global float *d_offset, const size_t step,
                          float d_log_reach[3])
{
#pragma unroll
    for (int i = 0; i < 3; ++i) {
        const float d = d_mean[3 * n + i], d_step = d == 0.0f ? 0.0f : d * reach[i];
        d_offset[3 * step + i] = d_step;
        d_log_reach[i] += d_step == 0.0f ? 0.0f : d_step * offset[3 * step + i];
    }
}

/* The gradients by scale, rotation, color and opacity of Gaussian n, to one lane. */
inline void gather_slot(__global const float *d_scale, __global const float *d_rotation,
                        __global const float *d_color, __global const float *d_opacity,
                        const size_t n, const size_t lane, SlotGradients *d)
{
#pragma unroll
    for (int i = 0; i < 3; ++i) {
        d->scale[i][lane] = d_scale[3 * n + i];
        d->color[i][lane] = d_color[3 * n + i];
    }
#pragma unroll
    for (int i = 0; i < 4; ++i)
        d->rotation[i][lane] = d_rotation[4 * n + i];
    d->opacity[lane] = d_opacity[n];
}

/* Zero where a log scale was clamped. */
inline float unclamped(const float d, const float log_scale)
{
    return fabs(log_scale) <= LOG_SCALE_LIMIT ? d : 0.0f;
}

/* Columns of d_output for VEC anchors, from the gathered gradients; writes d_scaling[3:6]. */
inline void slots_backward(const Anchors *a, const SlotGradients d[K_OFFSETS],
                           __global const float *output, const size_t stride,
                           __global float *d_output, __global float *d_scaling)
{
    fv size[3], d_log_size[3];
    for (int i = 0; i < 3; ++i) {
        size[i] = bounded_exp(a->log_scale[3 + i]);
        d_log_size[i] = (fv)(0.0f);
    }
    for (int j = 0; j < K_OFFSETS; ++j) {
        STORE_V(LOAD_V(0, d[j].opacity), 0, d_output + j * stride);
        for (int i = 0; i < 3; ++i)
            STORE_V(LOAD_V(0, d[j].color[i]), 0, d_output + (COLOR_ROW + 3 * j + i) * stride);
        const size_t row = (size_t)(COVARIANCE_ROW + 7 * j) * stride;
        covariance_backward(output + row, stride, size, d + j, d_log_size, d_output + row);
    }
    for (int i = 0; i < 3; ++i) {
        float lanes[VEC];
        STORE_V(d_log_size[i], 0, lanes);
        for (size_t lane = 0; lane < a->used; ++lane)
            d_scaling[6 * a->anchor[lane] + 3 + i] =
                unclamped(lanes[lane], a->log_scale[3 + i][lane]);
    }
}

/* One work-item VEC columns of d_output, which are written whole: zeros for slots without Gaussian
 * and for padding. d_offset and d_scaling are dense and zero before. */
__kernel void neural_backward(__global const float *output, __global const int *visible,
                              __global const int *first, const int count, const int padded,
                              __global const float *offset, __global const float *scaling,
                              __global const float *d_mean, __global const float *d_scale,
                              __global const float *d_rotation, __global const float *d_color,
                              __global const float *d_opacity, __global float *d_output,
                              __global float *d_offset, __global float *d_scaling)
{
    const size_t v = get_global_id(0) * VEC, stride = (size_t)padded;
    if (v >= stride)
        return;
    const Anchors a = load_anchors(visible, first, scaling, v, (size_t)count);
    float reach[3][VEC];
    for (int i = 0; i < 3; ++i)
        STORE_V(bounded_exp(a.log_scale[i]), 0, reach[i]);
    SlotGradients d[K_OFFSETS];
    for (size_t row = 0; row < K_OFFSETS * SLOT_GRADIENT_ROWS; ++row)
        STORE_V((fv)(0.0f), row, (float *)d);
    for (size_t lane = 0; lane < a.used; ++lane) {
        const float step_scale[3] = {reach[0][lane], reach[1][lane], reach[2][lane]};
        float d_log_reach[3] = {0.0f, 0.0f, 0.0f};
        int drawn[K_OFFSETS];
        const int draws = list_drawn(output + v + lane, stride, drawn);
        for (int draw = 0; draw < draws; ++draw) {
            const size_t n = a.first[lane] + draw, j = (size_t)drawn[draw];
            step_backward(d_mean, n, step_scale, offset, d_offset, a.anchor[lane] * K_OFFSETS + j,
                          d_log_reach);
            gather_slot(d_scale, d_rotation, d_color, d_opacity, n, lane, d + j);
        }
        for (int i = 0; i < 3; ++i)
            d_scaling[6 * a.anchor[lane] + i] = unclamped(d_log_reach[i], a.log_scale[i][lane]);
    }
    slots_backward(&a, d, output + v, stride, d_output + v, d_scaling);
}

/* One work-item a visible anchor: dL/d(position) is the sum over its Gaussians. */
__kernel void neural_backward_position(__global const int *visible, __global const int *first,
                                       const int count, __global const float *d_mean,
                                       __global float *d_position)
{
    const size_t v = get_global_id(0);
    if (v >= (size_t)count)
        return;
    for (size_t i = 0; i < 3; ++i) {
        float sum = 0.0f;
        for (size_t n = (size_t)first[v]; n < (size_t)first[v + 1]; ++n)
            sum += d_mean[3 * n + i];
        d_position[3 * (size_t)visible[v] + i] = sum;
    }
}
