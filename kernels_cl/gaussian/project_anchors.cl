/* Color and covariance heads, neural Gaussians and their projection at once, for pictures without
 * gradients: what the stages mlp, neural and project do, but on a CPU nothing that only they read
 * leaves its cache. In the GPU form the heads are computed before (mlp/forward_gpu.cl).
 *
 * Work-item: a block of BLOCK samples, blocks counted from the middle one on, with all that comes
 *     of them. Vectors keep the outputs of the MLPs private. project_anchors_pad: a Gaussian.
 * Work-group: any; no local memory.
 * Launch: padded / BLOCK work-items or more.
 */
#include "common/items.h"
#include "common/lanes.h"
#include "common/method.h"
#include "common/real.h"
#include "common/rows.h"
#include "gaussian/drawn_slots.h"
#include "gaussian/output_rows.h"
#include "gaussian/projected_gaussians.h"
#include "gaussian/projection.h"
#include "gaussian/screen.h"
#include "gaussian/shapes.h"
#include "gaussian/visible_anchors.h"
#define OUTPUT_SPACE ROW_SPACE
#include "mlp/block/layer.h"
#include "mlp/inputs.h"
#include "mlp/layout.h"
#include "mlp/slots.h"

/* Arrays of all that blending reads. */
typedef struct {
    ProjectedArrays projected;
    __global float *color;
    __global float *opacity;
} BlendInputs;

/* Writes the Gaussians of the drawn slots, at least one, of the visible anchors from v on. */
static inline void write_projected(const VisibleAnchors *anchors, const DrawnSlots *drawn,
                                   const size_t v, const OutputRows *rows,
                                   __global const float *camera, const float8 screen,
                                   const BlendInputs *out)
{
    const AnchorLanes a = load_anchors(anchors->visible, anchors->scaling, v, anchors->count);
    Shapes shapes;
    float mean[3][SLOTS], opaque[SLOTS];
    gather_shapes(&a, drawn, rows, &shapes);
    gather_means(anchors, &a, drawn, mean);
    for (size_t m = 0; m < DRAWN(drawn); ++m) {
        const size_t n = drawn->first + m, j = drawn->offset[m];
        ROW_SPACE const float *sample = rows->at + drawn->lane[m];
#pragma unroll
        for (int i = 0; i < 3; ++i)
            out->color[3 * n + i] = sample[(COLOR_ROW + 3 * j + i) * rows->stride];
        opaque[m] = sample[j * rows->stride];
    }
    for (size_t m = 0; m < DRAWN(drawn); m += VEC) {
        fv centre[3], scale[3], rotation[4];
        for (int i = 0; i < 3; ++i)
            centre[i] = LOAD_V(0, mean[i] + m);
        load_shapes(&shapes, m, scale, rotation);
        const Blurs blurs = blurs_of(screen, centre, camera);
        const Projection p = make_projection(centre, scale, rotation, camera, blurs.blur);
        const fv shown = LOAD_V(0, opaque + m) * kept_share(&p, blurs.blur, blurs.learned);
        const ProjectedGaussians projected = project_gaussians(&p, rotation, shown, camera);
        const size_t first = drawn->first + m, used = min((size_t)VEC, DRAWN(drawn) - m);
        store_projected(&projected, &out->projected, first, used);
        store_rows1(&shown, out->opacity, first, used);
    }
}

/* output: (11 K, padded); in the CPU form its opacities alone, the rest is private.
 * The Gaussians of sample v get the numbers from numbers[v] on, one for each bit of bits[v]. */
__kernel void project_anchors_forward(
    __global const float *feature, __global const float *position, __global const int *visible,
    const int count, __global const float *weights, __global const float *camera,
    const float8 screen, const int padded, __global const float *offset,
    __global const float *scaling, __global const int *numbers, __global const int *bits,
    const int capacity, __global float *output, __global float *mean2d, __global float *whitening,
    __global float *depth, __global float *extent, __global float *color, __global float *opacity)
{
    const size_t first = item_from_middle() * BLOCK, stride = (size_t)padded;
    if (first >= (size_t)count)
        return;
    const int slots = computed_slots(output + first, stride);
    if (SKIP_OPACITY_FIRST && slots == 0)
        return;
    const VisibleAnchors anchors = {visible, (size_t)count, position, offset, scaling};
#if VEC == 1
    (void)feature, (void)weights;
    __global const float *block = output + first;
    const size_t block_stride = stride;
#else
    fv vectors[OUTPUT_ROWS * VECTORS];
    float *block = (float *)vectors;
    const size_t block_stride = BLOCK;
    for (int j = 0; j < K_OFFSETS; ++j)
        for (int s = 0; s < VECTORS; ++s)
            vectors[j * VECTORS + s] = LOAD_ALIGNED(s, output + j * stride + first);
    const Inputs inputs = {feature, position, visible, (size_t)count, camera};
    float x[(INPUT_DIM + 1) * BLOCK], hidden[HIDDEN_DIM * BLOCK];
    size_t listed[OUTPUT_ROWS];
    gather_inputs(&inputs, first, x);
    prefetch_anchors(&anchors, first, BLOCK);
    for (int head = COLOR; head < HEADS; ++head) {
        __global const float *weight = weights + head_start(head);
        hidden_layer(weight, x, hidden);
        output_layer(weight + HIDDEN_SIZE, head, hidden, listed, rows_of(slots, head, listed),
                     block + first_output(head) * block_stride, block_stride);
    }
#endif
    const BlendInputs out = {{mean2d, whitening, depth, extent}, color, opacity};
    for (size_t s = 0; s < VECTORS; ++s) {
        const size_t v = first + s * VEC;
        const OutputRows rows = {block + s * VEC, block_stride};
        ComingSlots coming = coming_slots(bits, numbers, v, (size_t)count, (size_t)capacity);
        DrawnSlots drawn;
        while (next_slots(&coming, &drawn))
            if (drawn.count != 0)
                write_projected(&anchors, &drawn, v, &rows, camera, screen, &out);
    }
}

/* Gaussians after the last one get zeros. */
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
