/* L1 and SSIM of an image against a photo, and the maps that the backward pass blurs.
 *
 * SSIM of image x against target y under the window w (11 x 11 Gaussian, zero padding):
 *     S = A1 A2 / (B1 B2),  A1 = 2 mu_x mu_y + C1,  B1 = mu_x^2 + mu_y^2 + C1,
 *     A2 = 2 cov(x, y) + C2,  B2 = A2 + var(x - y).
 * Moments are taken of x' = x - c_x and y' = y - c_y, c = the middle of the patch's range: flat
 * areas of any level then cancel nothing. Padding is left out of the sums and restored through the
 * window's coverage of the image (1 inside, less at the rim).
 * With V = 2 A1/(B1 B2), W = V var(x - y)/B2 and P = dS/dmu_x at fixed variances,
 *     dS/dx_j = sum_p w_pj [P + V ((y - x)_j - (mu_y - mu_x)) + W (x_j - mu_x)]
 * holds no difference of large terms if x is close to y. If all x' and y' that a patch sees are
 * zero, as in a background, so are their sums, and x' and y' are all that v and w are multiplied
 * with.
 *
 * A work-group owns a patch of PATCH_ROWS x PATCH_COLUMNS pixels of one channel: on a CPU
 * one work-item, VEC pixels at a time, with the patch and its rim in private memory; on a GPU ITEMS
 * work-items, with both in local memory. Launch size: (patches across * work-items of a group,
 * patches down, 3). */
#include "common/lanes.h"
#include "common/real.h"
#include "loss/group.h"
#include "loss/patch.h"
#include "loss/pixel_sums.h"
#include "loss/window.h"

#ifndef SSIM_C1
#define SSIM_C1 9.99999975e-05f
#define SSIM_C2 8.99999985e-04f
#endif

/* The window's weight at a tap. An array would lie in memory: its index is computed. */
static inline float tap_weight(const int tap)
{
    const int distance = tap < 0 ? -tap : tap;
    return distance == 0   ? SSIM_WEIGHT_0
           : distance == 1 ? SSIM_WEIGHT_1
           : distance == 2 ? SSIM_WEIGHT_2
           : distance == 3 ? SSIM_WEIGHT_3
           : distance == 4 ? SSIM_WEIGHT_4
                           : SSIM_WEIGHT_5;
}

/* The part of the window around `position` that lies on an axis of `size` pixels; 1 inside. */
static inline float coverage(int position, int size)
{
    if (position >= RADIUS && position + RADIUS < size)
        return 1.0f;
    float sum = 0.0f;
    for (int tap = -RADIUS; tap <= RADIUS; ++tap)
        if (position + tap >= 0 && position + tap < size)
            sum += tap_weight(tap);
    return sum;
}

/* The same for lanes along x. */
static inline fv column_coverage(int x, int width)
{
    if (x >= RADIUS && x + VEC + RADIUS <= width)
        return (fv)(1.0f);
    float lanes[VEC];
    for (int lane = 0; lane < VEC; ++lane)
        lanes[lane] = coverage(x + lane, width);
    return LOAD_V(0, lanes);
}

/* 1 for lanes from a staged column on that the window reaches, else 0: the range must not depend on
 * the width of vectors. */
static inline fv rim_mask(const int column)
{
    float lanes[VEC];
    for (int lane = 0; lane < VEC; ++lane)
        lanes[lane] = column + lane < PATCH_COLUMNS + 2 * RADIUS ? 1.0f : 0.0f;
    return LOAD_V(0, lanes);
}

/* Load image and target with a rim of RADIUS; the middle of their ranges as (c_x, c_y), in steps
 * of 1/256 so that differences of such numbers are exact. */
static inline float2 stage_images(Patch patch, __global const float *image,
                                  __global const uchar *target, SPACE float *stage,
                                  SPACE float4 *scratch)
{
    const fv far = (fv)(1e30f);
    fv low_x = far, low_y = far, high_x = far, high_y = far; /* high: of the negated values */
    const int columns = STRIDE / VEC;
    for (int unit = ITEM; unit < STAGE_ROWS * columns; unit += ITEMS) {
        const int row = unit / columns, column = unit % columns * VEC;
        const int px = patch.x + column - RADIUS, py = patch.y + row - RADIUS;
        const fv x = load_pixels(patch, image, px, py), y = load_levels(patch, target, px, py);
        const fv outside = (1.0f - image_mask(patch, px, py) * rim_mask(column)) * far;
        low_x = x + outside < low_x ? x + outside : low_x;
        high_x = outside - x < high_x ? outside - x : high_x;
        low_y = y + outside < low_y ? y + outside : low_y;
        high_y = outside - y < high_y ? outside - y : high_y;
        STORE_V(x, 0, stage + row * STRIDE + column);
        STORE_V(y, 0, stage + STAGE_SIZE + row * STRIDE + column);
    }
    const float4 range = group_min(
        (float4)(lane_min(low_x), lane_min(high_x), lane_min(low_y), lane_min(high_y)), scratch);
    return rint(128.0f * (range.xz - range.yw)) / 256.0f;
}

/* Staged x, y become x', y', (x' - y')^2, x' y', zero outside of the image. Returns whether all are
 * zero. */
static inline bool stage_products(Patch patch, float2 shift, SPACE float *stage,
                                  SPACE float4 *scratch)
{
    const int columns = STRIDE / VEC;
    fv sizes = (fv)(0.0f);
    for (int unit = ITEM; unit < STAGE_ROWS * columns; unit += ITEMS) {
        const int row = unit / columns, column = unit % columns * VEC;
        SPACE float *at = stage + row * STRIDE + column;
        const fv in_image = image_mask(patch, patch.x + column - RADIUS, patch.y + row - RADIUS);
        const fv x = (LOAD_V(0, at) - shift.x) * in_image;
        const fv y = (LOAD_V(0, at + STAGE_SIZE) - shift.y) * in_image;
        STORE_V(x, 0, at);
        STORE_V(y, 0, at + STAGE_SIZE);
        STORE_V((x - y) * (x - y), 0, at + 2 * STAGE_SIZE);
        STORE_V(x * y, 0, at + 3 * STAGE_SIZE);
        sizes += fabs(x) + fabs(y);
    }
    SYNC();
    return all_zero(sizes, scratch);
}

typedef struct {
    fv loss; /* 1 - S */
    fv r;    /* P - V (mu_y - mu_x) - W mu_x, means relative to the patch's shift */
    fv v;
    fv w;
} Ssim;

/* One row of pixels: SSIM and its derivatives from the four blurred moments. */
static inline Ssim ssim_terms(fv x, fv y, fv square, fv product, fv covered, float2 shift)
{
    const fv missing = 1.0f - covered;
    const float gap = shift.y - shift.x;
    const fv centred_x = fma(-missing, (fv)(shift.x), x); /* mu_x - c_x */
    const fv step = fma(-missing, (fv)(gap), y - x);      /* (mu_y - c_y) - (mu_x - c_x) */
    const fv mu_x = centred_x + shift.x, mu_y = fma(covered, (fv)(shift.y), y);
    const fv difference = step + gap;
    /* what padding adds: the window outside of the image sees -c */
    const fv rim_square = missing * gap * fma(covered, (fv)(gap), 2.0f * (y - x));
    const fv rim_product = missing * (shift.x * y + shift.y * x + covered * (shift.x * shift.y));
    fv variance = fma(x - y, y - x, square) + rim_square;
    variance = variance < (fv)(0.0f) ? (fv)(0.0f) : variance;
    const fv covariance = fma(-x, y, product) + rim_product;
    fv both = fma((fv)(2.0f), covariance, variance);
    both = both < (fv)(0.0f) ? (fv)(0.0f) : both;

    const fv a1 = fma(2.0f * mu_x, mu_y, (fv)(SSIM_C1));
    const fv b1 = fma(mu_x, mu_x, fma(mu_y, mu_y, (fv)(SSIM_C1)));
    const fv a2 = fma((fv)(2.0f), covariance, (fv)(SSIM_C2));
    const fv by_b1 = 1.0f / b1, by_b2 = 1.0f / (both + SSIM_C2);
    const fv luminance = a1 * by_b1, lost = variance * by_b2;
    Ssim s;
    s.loss = fma(difference * difference, by_b1, luminance * lost);
    s.v = 2.0f * luminance * by_b2;
    s.w = s.v * lost;
    const fv p =
        2.0f * (a2 * by_b2) * difference * fma(mu_y, mu_x + mu_y, (fv)(SSIM_C1)) * (by_b1 * by_b1);
    s.r = p - fma(s.v, step, s.w * centred_x);
    return s;
}

/* Out: shifts (patches, 2), the maps r, v, w, each (3, H, W), and
 * block sums (patches, 2) of |x - y| and 1 - S. */
GROUP_SIZED __kernel void loss_forward(__global const float *image, __global const uchar *target,
                                       const int width, const int height, __global float *shifts,
                                       __global float *r_map, __global float *v_map,
                                       __global float *w_map, __global float *sums)
{
    SPACE float stage[4 * STAGE_SIZE];
    SPACE float blurred[4 * BLURRED_SIZE] __attribute__((aligned(16)));
    SPACE float4 *scratch = (SPACE float4 *)blurred; /* until something is blurred */
    const Patch patch = make_patch(width, height);
    const float2 shift = stage_images(patch, image, target, stage, scratch);
    const bool flat = stage_products(patch, shift, stage, scratch);
    if (!flat)
        blur_rows(stage, blurred, 4);

    const int columns = PATCH_COLUMNS / VEC;
    DECLARE_PIXEL_SUMS(l1, stage);
    DECLARE_PIXEL_SUMS(ssim, stage + PATCH_PIXELS);
    for (int unit = ITEM; unit < PATCH_ROWS * columns; unit += ITEMS) {
        const int row = unit / columns, column = unit % columns * VEC;
        const int px = patch.x + column, py = patch.y + row;
        if (!(py < height && px < width))
            continue;
        const fv covered = coverage(py, height) * column_coverage(px, width);
        SPACE const float *top = blurred + row * PATCH_COLUMNS + column;
        fv x = (fv)(0.0f), y = x, square = x, product = x;
        if (!flat) { /* no array: with a computed index it would lie in memory */
            x = blur(top, PATCH_COLUMNS);
            y = blur(top + BLURRED_SIZE, PATCH_COLUMNS);
            square = blur(top + 2 * BLURRED_SIZE, PATCH_COLUMNS);
            product = blur(top + 3 * BLURRED_SIZE, PATCH_COLUMNS);
        }
        const Ssim s = ssim_terms(x, y, square, product, covered, shift);
        store_pixels(patch, s.r, r_map, px, py);
        store_pixels(patch, s.v, v_map, px, py);
        store_pixels(patch, s.w, w_map, px, py);
        const fv in_image = image_mask(patch, px, py);
        const fv error = load_pixels(patch, image, px, py) - load_levels(patch, target, px, py);
        ADD_PIXELS(l1, unit, fabs(error));
        ADD_PIXELS(ssim, unit, s.loss * in_image);
    }
    const size_t index = patch_index((int)get_group_id(0), (int)get_group_id(1));
    STORE_PIXEL_SUM(l1, sums + 2 * index);
    STORE_PIXEL_SUM(ssim, sums + 2 * index + 1);
    if (ITEM == 0)
        vstore2(shift, index, shifts);
}
