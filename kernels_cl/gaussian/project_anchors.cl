/* Color and covariance heads, neural Gaussians and their projection at once, for pictures without
 * gradients: what the stages mlp, neural and project do, but on a CPU nothing that only they read
 * leaves its cache.
 */
#include "gaussian/anchors.h"
#include "common/real.h"

#if VEC == 1
#define OUTPUT_SPACE __global
#else
#define OUTPUT_SPACE __private
#endif
#include "gaussian/gaussians.h"
#include "common/items.h"
#include "mlp/dense.h"
#include "mlp/inputs.h"
#include "mlp/layout.h"
#include "mlp/slots.h"
#include "gaussian/projection.h"

/* Gaussians on the screen. */
typedef struct {
    Screen screen;
    __global float *color;
    __global float *opacity;
} Splats;

/* The drawn slots, at least one, of the visible anchors from v on; rows: their outputs. */
static inline void write_splats(const Parameters *p, const Drawn *drawn, const size_t v, ROWS *rows,
                                const size_t stride, __global const float *camera,
                                const Splats *out)
{
    const Anchors a = load_anchors(p->visible, p->scaling, v, p->count);
    Shapes shapes;
    float mean[3][SLOTS], opaque[SLOTS];
    gather_shapes(&a, drawn, rows + COVARIANCE_ROW * stride, stride, &shapes);
    gather_means(&a, drawn, p->position, p->offset, mean);
    for (size_t m = 0; m < drawn->count; ++m) {
        const size_t n = drawn->first + m, j = drawn->offset[m];
        ROWS *sample = rows + drawn->lane[m];
#pragma unroll
        for (int i = 0; i < 3; ++i)
            out->color[3 * n + i] = sample[(COLOR_ROW + 3 * j + i) * stride];
        out->opacity[n] = opaque[m] = sample[j * stride];
    }
    for (size_t m = 0; m < drawn->count; m += VEC) {
        fv centre[3], scale[3], rotation[4];
        for (int i = 0; i < 3; ++i)
            centre[i] = LOAD_V(0, mean[i] + m);
        shape_lanes(&shapes, m, scale, rotation);
        const Splat s = make_splat(centre, scale, rotation, camera);
        const Projection lanes = project_splat(&s, rotation, LOAD_V(0, opaque + m), camera);
        store_projection(&lanes, &out->screen, drawn->first + m,
                         min((size_t)VEC, drawn->count - m));
    }
}

/* One work-item a block of samples. output: (110, padded), of which the opacities are there; the
 * Gaussians of sample v go to numbers[v] and on, for each bit of bits[v]. */
__kernel void project_anchors_forward(
    __global const float *feature, __global const float *position, __global const int *visible,
    const int count, __global const float *weights, __global const float *camera, const int padded,
    __global const float *offset, __global const float *scaling, __global const int *numbers,
    __global const int *bits, const int capacity, __global float *output, __global float *mean2d,
    __global float *whitening, __global float *depth, __global float *extent, __global float *color,
    __global float *opacity)
{
    const size_t first = item_from_middle() * BLOCK, stride = (size_t)padded;
    if (first >= (size_t)count)
        return;
    const int slots = computed_slots(output + first, stride);
    if (SKIP_OPACITY_FIRST && slots == 0)
        return;
#if VEC == 1
    __global float *rows = output + first;
    const size_t rows_stride = stride;
#else
    fv lanes[OUTPUT_ROWS * VECTORS];
    float *rows = (float *)lanes;
    const size_t rows_stride = BLOCK;
    for (int j = 0; j < K_OFFSETS; ++j)
        for (int s = 0; s < VECTORS; ++s)
            lanes[j * VECTORS + s] = LOAD_ALIGNED(s, output + j * stride + first);
#endif
    const Inputs inputs = {feature, position, visible, (size_t)count, camera};
    const Parameters parameters = {visible, (size_t)count, position, offset, scaling};
    float x[(INPUT_DIM + 1) * BLOCK], hidden[HIDDEN_DIM * BLOCK];
    size_t listed[OUTPUT_ROWS];
    gather_inputs(&inputs, first, x);
    fetch_parameters(&parameters, first, BLOCK);
    for (int head = COLOR; head < HEADS; ++head) {
        __global const float *weight = weights + head_start(head);
        hidden_layer(weight, x, hidden);
        output_layer(weight + HIDDEN_SIZE, head, hidden, listed, rows_of(slots, head, listed),
                     rows + first_output(head) * rows_stride, rows_stride);
    }
    const Splats splats = {{mean2d, whitening, depth, extent}, color, opacity};
    for (size_t s = 0; s < VECTORS; ++s) {
        const size_t v = first + s * VEC;
        const Drawn drawn = list_drawn(bits, numbers, v, (size_t)count, (size_t)capacity);
        if (drawn.count != 0)
            write_splats(&parameters, &drawn, v, rows + s * VEC, rows_stride, camera, &splats);
    }
}

/* One work-item a place for a Gaussian: those behind the last get zeros. */
__kernel void project_anchors_pad(__global const long *total, const int capacity,
                                  __global float *mean2d, __global float *whitening,
                                  __global float *depth, __global float *extent,
                                  __global float *color, __global float *opacity)
{
    const size_t n = get_global_id(0);
    if (n >= (size_t)capacity || (long)n < *total)
        return;
    vstore2((float2)(0.0f), n, mean2d);
    vstore3((float3)(0.0f), n, whitening);
    depth[n] = 0.0f;
    vstore2((float2)(0.0f), n, extent);
    vstore3((float3)(0.0f), n, color);
    opacity[n] = 0.0f;
}
