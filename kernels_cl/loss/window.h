/* The SSIM window, 11 x 11 Gaussian weights, and the blur of a patch under it. */
#ifndef CLGS_WINDOW_H
#define CLGS_WINDOW_H

#include "common/lanes.h"
#include "common/real.h"
#include "loss/group.h"
#include "loss/patch.h"

/* Window weights from the centre outwards. */
#ifndef SSIM_WEIGHT_0
#define SSIM_WEIGHT_0 0.266011715f
#define SSIM_WEIGHT_1 0.213005543f
#define SSIM_WEIGHT_2 0.109360687f
#define SSIM_WEIGHT_3 0.0360007733f
#define SSIM_WEIGHT_4 0.00759875821f
#define SSIM_WEIGHT_5 0.00102838012f
#endif
#ifndef SKIP_FLAT
#define SKIP_FLAT 1 /* no sums of zeros */
#endif

#define RADIUS 5
#define STAGE_ROWS (PATCH_ROWS + 2 * RADIUS)
#if VEC == 1
#define STRIDE (PATCH_COLUMNS + 2 * RADIUS)
#else
#define STRIDE (2 * PATCH_COLUMNS) /* whole vectors; the last columns are not used */
#endif
#define STAGE_SIZE (STAGE_ROWS * STRIDE)
#define BLURRED_SIZE (STAGE_ROWS * PATCH_COLUMNS)

/* The window along one axis: 11 taps `stride` apart, the first at `values`. Compilers judge it too
 * long to inline, which costs a sixth of the time of the whole stage. */
__attribute__((always_inline)) static inline fv blur(SPACE const float *values, int stride)
{
    fv sum = LOAD_V(0, values) * (fv)(SSIM_WEIGHT_5);
    sum = fma(LOAD_V(0, values + stride), (fv)(SSIM_WEIGHT_4), sum);
    sum = fma(LOAD_V(0, values + 2 * stride), (fv)(SSIM_WEIGHT_3), sum);
    sum = fma(LOAD_V(0, values + 3 * stride), (fv)(SSIM_WEIGHT_2), sum);
    sum = fma(LOAD_V(0, values + 4 * stride), (fv)(SSIM_WEIGHT_1), sum);
    sum = fma(LOAD_V(0, values + 5 * stride), (fv)(SSIM_WEIGHT_0), sum);
    sum = fma(LOAD_V(0, values + 6 * stride), (fv)(SSIM_WEIGHT_1), sum);
    sum = fma(LOAD_V(0, values + 7 * stride), (fv)(SSIM_WEIGHT_2), sum);
    sum = fma(LOAD_V(0, values + 8 * stride), (fv)(SSIM_WEIGHT_3), sum);
    sum = fma(LOAD_V(0, values + 9 * stride), (fv)(SSIM_WEIGHT_4), sum);
    return fma(LOAD_V(0, values + 10 * stride), (fv)(SSIM_WEIGHT_5), sum);
}

/* Blur the rows of `count` staged planes. */
static inline void blur_rows(SPACE const float *stage, SPACE float *blurred, int count)
{
    const int columns = PATCH_COLUMNS / VEC;
    for (int unit = ITEM; unit < STAGE_ROWS * columns; unit += ITEMS) {
        const int row = unit / columns, column = unit % columns * VEC;
        for (int plane = 0; plane < count; ++plane)
            STORE_V(blur(stage + plane * STAGE_SIZE + row * STRIDE + column, 1), 0,
                    blurred + plane * BLURRED_SIZE + row * PATCH_COLUMNS + column);
    }
    SYNC();
}

/* Whether the numbers of all work-items, none of them negative, are zero; NaN is not. */
static inline bool all_zero(const fv sizes, SPACE float4 *scratch)
{
    return SKIP_FLAT && group_sum((float4)(lane_sum(sizes), 0.0f, 0.0f, 0.0f), scratch).x == 0.0f;
}

#endif
