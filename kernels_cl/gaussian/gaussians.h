/* Neural Gaussians of the drawn slots of VEC visible anchors. */
#ifndef CLGS_GAUSSIANS_H
#define CLGS_GAUSSIANS_H

#include "gaussian/anchors.h"
#include "common/real.h"
#include "common/rows.h"

#ifndef LOG_SCALE_LIMIT
#define LOG_SCALE_LIMIT 20.0f
#endif

/* A quaternion whose largest component lies outside of these has no direction. */
#define QUATERNION_MIN 1e-35f
#define QUATERNION_MAX 1e37f

/* e^x of VEC log scales, clamped; NaN stays NaN. */
static inline fv bounded_exp(const float *log_scale)
{
    const fv x = LOAD_V(0, log_scale);
    const fv raised = x < (fv)(-LOG_SCALE_LIMIT) ? (fv)(-LOG_SCALE_LIMIT) : x;
    return exp_v(raised > (fv)(LOG_SCALE_LIMIT) ? (fv)(LOG_SCALE_LIMIT) : raised);
}

static inline fv larger(const fv a, const fv b)
{
    return a > b ? a : b;
}

/* Makes unit quaternions, zero where there is no direction, and returns the reciprocals of their
 * lengths. Scaling by the largest component first keeps squares from overflow and underflow. */
static inline fv make_unit(fv unit[4])
{
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

/* What the arithmetic takes of every drawn slot. */
typedef struct {
    float size[3][SLOTS]; /* exp(log scale) */
    float logit[3][SLOTS];
    float quaternion[4][SLOTS];
} Shapes;

static inline void gather_shapes(const Anchors *a, const Drawn *drawn, ROWS *covariance,
                                 const size_t stride, Shapes *shapes)
{
    float size[3][VEC];
    for (int i = 0; i < 3; ++i)
        STORE_V(bounded_exp(a->log_scale[3 + i]), 0, size[i]);
    for (size_t m = 0; m < drawn->count; ++m) {
        const size_t lane = drawn->lane[m];
        ROWS *slot = covariance + 7 * drawn->offset[m] * stride + lane;
#pragma unroll
        for (int i = 0; i < 3; ++i) {
            shapes->size[i][m] = size[i][lane];
            shapes->logit[i][m] = slot[i * stride];
        }
#pragma unroll
        for (int i = 0; i < 4; ++i)
            shapes->quaternion[i][m] = slot[(3 + i) * stride];
    }
}

/* Scales and rotations of VEC drawn slots from number m on. */
static inline void shape_lanes(const Shapes *shapes, const size_t m, fv scale[3], fv rotation[4])
{
    for (int i = 0; i < 3; ++i)
        scale[i] = LOAD_V(0, shapes->size[i] + m) * sigmoid_v(LOAD_V(0, shapes->logit[i] + m));
    for (int i = 0; i < 4; ++i)
        rotation[i] = LOAD_V(0, shapes->quaternion[i] + m);
    make_unit(rotation);
}

/* Offsets of VEC anchors. On a CPU they are copied, all at once, so that the misses overlap. */
#if VEC == 1
#define STEPS __global const float
#define STAGE_STEPS(name, a, offset)                                                               \
    STEPS *name = (offset) + 3 * K_OFFSETS * (size_t)max((a)->anchor[0], 0)
#else
#define STEPS __private const float
#define STAGE_STEPS(name, a, offset)                                                               \
    float name[3 * SLOTS];                                                                         \
    copy_steps(a, offset, name)
#endif

static inline void copy_steps(const Anchors *a, __global const float *offset, float *copy)
{
    for (size_t lane = 0; lane < VEC; ++lane) {
        __global const float *steps = offset + 3 * K_OFFSETS * (size_t)max(a->anchor[lane], 0);
        for (size_t i = 0; i < 3 * K_OFFSETS; ++i)
            copy[3 * K_OFFSETS * lane + i] = steps[i];
    }
}

/* Means of the drawn slots, which are a step away from their anchors. */
static inline void gather_means(const Anchors *a, const Drawn *drawn,
                                __global const float *position, __global const float *offset,
                                float mean[3][SLOTS])
{
    float reach[3][VEC], centre[3][VEC];
    STAGE_STEPS(steps, a, offset);
    for (int i = 0; i < 3; ++i) {
        STORE_V(bounded_exp(a->log_scale[i]), 0, reach[i]);
        for (size_t lane = 0; lane < VEC; ++lane)
            centre[i][lane] = position[3 * (size_t)max(a->anchor[lane], 0) + i];
    }
    for (size_t m = 0; m < drawn->count; ++m) {
        const size_t lane = drawn->lane[m];
        STEPS *step = steps + 3 * (lane * K_OFFSETS + drawn->offset[m]);
#pragma unroll
        for (int i = 0; i < 3; ++i)
            mean[i][m] = fma(step[i], reach[i][lane], centre[i][lane]);
    }
}

/* What the MLPs' outputs are relative to. */
typedef struct {
    __global const int *visible;
    size_t count;
    __global const float *position;
    __global const float *offset;
    __global const float *scaling;
} Parameters;

/* What will be read of the `lanes` visible anchors from v on. */
static inline void fetch_parameters(const Parameters *p, const size_t v, const size_t lanes)
{
    for (size_t lane = 0; lane < lanes && v + lane < p->count; ++lane) {
        const size_t anchor = (size_t)max(p->visible[v + lane], 0);
        PREFETCH(p->scaling + 6 * anchor);
        for (size_t i = 0; i < 3 * K_OFFSETS; i += LINE)
            PREFETCH(p->offset + 3 * K_OFFSETS * anchor + i);
    }
}

/* All that there is of every Gaussian. */
typedef struct {
    __global float *mean;
    __global float *scale;
    __global float *rotation;
    __global float *color;
    __global float *opacity;
    __global int *slot;
} Gaussians;

/* The drawn slots, at least one, of the visible anchors from v on; rows: their outputs. */
static inline void write_gaussians(const Parameters *p, const Drawn *drawn, const size_t v,
                                   ROWS *rows, const size_t stride, const Gaussians *out)
{
    const Anchors a = load_anchors(p->visible, p->scaling, v, p->count);
    Shapes shapes;
    float mean[3][SLOTS];
    gather_shapes(&a, drawn, rows + COVARIANCE_ROW * stride, stride, &shapes);
    gather_means(&a, drawn, p->position, p->offset, mean);
    for (size_t m = 0; m < drawn->count; m += VEC) {
        const size_t n = drawn->first + m, used = min((size_t)VEC, drawn->count - m);
        fv scale[3], rotation[4];
        shape_lanes(&shapes, m, scale, rotation);
        store_rows3(scale, out->scale, n, used);
        store_rows4(rotation, out->rotation, n, used);
    }
    for (size_t m = 0; m < drawn->count; ++m) {
        const size_t n = drawn->first + m, j = drawn->offset[m];
        ROWS *sample = rows + drawn->lane[m];
#pragma unroll
        for (int i = 0; i < 3; ++i) {
            out->mean[3 * n + i] = mean[i][m];
            out->color[3 * n + i] = sample[(COLOR_ROW + 3 * j + i) * stride];
        }
        out->opacity[n] = sample[j * stride];
        out->slot[n] = (int)((v + drawn->lane[m]) * K_OFFSETS + j);
    }
}

#endif
