/* L1, SSIM and the volume term, with their gradients.
 *
 * SSIM of image x against target y under the window w (11 x 11 Gaussian, zero padding):
 *     S = A1 A2 / (B1 B2),  A1 = 2 mu_x mu_y + C1,  B1 = mu_x^2 + mu_y^2 + C1,
 *     A2 = 2 cov(x, y) + C2,  B2 = A2 + var(x - y).
 * Moments are taken of x' = x - c_x and y' = y - c_y, c = the middle of the tile's range: flat
 * areas of any level then cancel nothing. Padding is left out of the sums and restored through the
 * window's coverage of the image (1 inside, less at the rim).
 * With V = 2 A1/(B1 B2), W = V var(x - y)/B2 and P = dS/dmu_x at fixed variances,
 *     dS/dx_j = sum_p w_pj [P + V ((y - x)_j - (mu_y - mu_x)) + W (x_j - mu_x)]
 * holds no difference of large terms where x is close to y. Where all x' and y' that a tile sees
 * are zero, as in a background, so are their sums, and x' and y' are all that v and w are
 * multiplied with.
 */
#include "loss/group.h"
#include "common/lanes.h"
#include "loss/pixels.h"
#include "common/real.h"
#include "common/rows.h"

/* Window weights from the centre outwards. */
#ifndef SSIM_WEIGHT_0
#define SSIM_WEIGHT_0 0.266011715f
#define SSIM_WEIGHT_1 0.213005543f
#define SSIM_WEIGHT_2 0.109360687f
#define SSIM_WEIGHT_3 0.0360007733f
#define SSIM_WEIGHT_4 0.00759875821f
#define SSIM_WEIGHT_5 0.00102838012f
#endif
#ifndef SSIM_C1
#define SSIM_C1 9.99999975e-05f
#define SSIM_C2 8.99999985e-04f
#endif

#ifndef SKIP_FLAT
#define SKIP_FLAT 1 /* no sums of zeros */
#endif

#define RADIUS 5
#define STAGE_ROWS (TILE_ROWS + 2 * RADIUS)
#if VEC == 1
#define STRIDE (TILE_COLUMNS + 2 * RADIUS)
#else
#define STRIDE (2 * TILE_COLUMNS) /* whole vectors; the last columns are not used */
#endif
#define STAGE_SIZE (STAGE_ROWS * STRIDE)
#define BLURRED_SIZE (STAGE_ROWS * TILE_COLUMNS)

/* The window along one axis: 11 taps `stride` apart, the first at `values`. Compilers judge it too
 * long to inline, which costs a sixth of the time of the whole stage. */
__attribute__((always_inline)) inline fv blur(SPACE const float *values, int stride)
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
inline void blur_rows(SPACE const float *stage, SPACE float *blurred, int count)
{
    const int columns = TILE_COLUMNS / VEC;
    for (int unit = ITEM; unit < STAGE_ROWS * columns; unit += ITEMS) {
        const int row = unit / columns, column = unit % columns * VEC;
        for (int plane = 0; plane < count; ++plane)
            STORE_V(blur(stage + plane * STAGE_SIZE + row * STRIDE + column, 1), 0,
                    blurred + plane * BLURRED_SIZE + row * TILE_COLUMNS + column);
    }
    SYNC();
}

/* The part of the window around `position` that lies on an axis of `size` pixels; 1 inside. */
inline float coverage(int position, int size)
{
    const float weights[RADIUS + 1] = {SSIM_WEIGHT_0, SSIM_WEIGHT_1, SSIM_WEIGHT_2,
                                       SSIM_WEIGHT_3, SSIM_WEIGHT_4, SSIM_WEIGHT_5};
    if (position >= RADIUS && position + RADIUS < size)
        return 1.0f;
    float sum = 0.0f;
    for (int tap = -RADIUS; tap <= RADIUS; ++tap)
        if (position + tap >= 0 && position + tap < size)
            sum += weights[tap < 0 ? -tap : tap];
    return sum;
}

/* The same for lanes along x. */
inline fv column_coverage(int x, int width)
{
    if (x >= RADIUS && x + VEC + RADIUS <= width)
        return (fv)(1.0f);
    float lanes[VEC];
    for (int lane = 0; lane < VEC; ++lane)
        lanes[lane] = coverage(x + lane, width);
    return LOAD_V(0, lanes);
}

/* Load image and target with a rim of RADIUS; the middle of their ranges as (c_x, c_y), in steps
 * of 1/256 so that differences of such numbers are exact. */
inline float2 stage_images(Tile tile, __global const float *image, __global const uchar *target,
                           SPACE float *stage, SPACE float4 *scratch)
{
    const fv far = (fv)(1e30f);
    fv low_x = far, low_y = far, high_x = far, high_y = far; /* high: of the negated values */
    const int columns = STRIDE / VEC;
    for (int unit = ITEM; unit < STAGE_ROWS * columns; unit += ITEMS) {
        const int row = unit / columns, column = unit % columns * VEC;
        const int px = tile.x + column - RADIUS, py = tile.y + row - RADIUS;
        const fv x = load_pixels(tile, image, px, py), y = load_levels(tile, target, px, py);
        const fv outside = (1.0f - image_mask(tile, px, py)) * far;
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

/* Whether the numbers of all work-items, none of them negative, are zero; NaN is not. */
inline bool all_zero(const fv sizes, SPACE float4 *scratch)
{
    return SKIP_FLAT && group_sum((float4)(lane_sum(sizes), 0.0f, 0.0f, 0.0f), scratch).x == 0.0f;
}

/* Staged x, y become x', y', (x' - y')^2, x' y', zero outside of the image. Returns whether all are
 * zero. */
inline bool stage_products(Tile tile, float2 shift, SPACE float *stage, SPACE float4 *scratch)
{
    const int columns = STRIDE / VEC;
    fv sizes = (fv)(0.0f);
    for (int unit = ITEM; unit < STAGE_ROWS * columns; unit += ITEMS) {
        const int row = unit / columns, column = unit % columns * VEC;
        SPACE float *at = stage + row * STRIDE + column;
        const fv in_image = image_mask(tile, tile.x + column - RADIUS, tile.y + row - RADIUS);
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
    fv r;    /* P - V (mu_y - mu_x) - W mu_x, means relative to the tile's shift */
    fv v;
    fv w;
} Ssim;

/* One row of pixels: SSIM and its derivatives from the four blurred moments. */
inline Ssim ssim_terms(fv x, fv y, fv square, fv product, fv covered, float2 shift)
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

/* One work-group a tile and channel. Out: shift (tiles, 2), the maps r, v, w, each (3, H, W), and
 * block sums (tiles, 2) of |x - y| and 1 - S. */
GROUP_SIZED __kernel void loss_forward(__global const float *image, __global const uchar *target,
                                       const int width, const int height, __global float *shifts,
                                       __global float *r_map, __global float *v_map,
                                       __global float *w_map, __global float *sums)
{
    SPACE float stage[4 * STAGE_SIZE];
    SPACE float blurred[4 * BLURRED_SIZE];
    SPACE float4 scratch[ITEMS];
    const Tile tile = make_tile(width, height);
    const float2 shift = stage_images(tile, image, target, stage, scratch);
    const bool flat = stage_products(tile, shift, stage, scratch);
    if (!flat)
        blur_rows(stage, blurred, 4);

    const int columns = TILE_COLUMNS / VEC;
    fv l1 = (fv)(0.0f), ssim = (fv)(0.0f);
    for (int unit = ITEM; unit < TILE_ROWS * columns; unit += ITEMS) {
        const int row = unit / columns, column = unit % columns * VEC;
        const int px = tile.x + column, py = tile.y + row;
        if (!(py < height && px < width))
            continue;
        const fv covered = coverage(py, height) * column_coverage(px, width);
        SPACE const float *top = blurred + row * TILE_COLUMNS + column;
        fv moments[4] = {(fv)(0.0f), (fv)(0.0f), (fv)(0.0f), (fv)(0.0f)};
        for (int plane = 0; plane < 4 && !flat; ++plane)
            moments[plane] = blur(top + plane * BLURRED_SIZE, TILE_COLUMNS);
        const Ssim s = ssim_terms(moments[0], moments[1], moments[2], moments[3], covered, shift);
        store_pixels(tile, s.r, r_map, px, py);
        store_pixels(tile, s.v, v_map, px, py);
        store_pixels(tile, s.w, w_map, px, py);
        const fv in_image = image_mask(tile, px, py);
        const fv error = load_pixels(tile, image, px, py) - load_levels(tile, target, px, py);
        l1 += fabs(error);
        ssim += s.loss * in_image;
    }
    const float4 sum = group_sum((float4)(lane_sum(l1), lane_sum(ssim), 0.0f, 0.0f), scratch);
    if (ITEM == 0) {
        const size_t index = tile_index((int)get_group_id(0), (int)get_group_id(1));
        vstore2(shift, index, shifts);
        vstore2(sum.xy, index, sums);
    }
}

/* Shifts of the tiles around this one, relative to its own, by staged column (c_x) and row band:
 * [0] c_x, [1] c_y - c_x, each (3, STRIDE). */
inline void stage_shifts(__global const float *shifts, SPACE float *offsets)
{
    const int tile_x = (int)get_group_id(0), tile_y = (int)get_group_id(1);
    const float2 own = vload2(tile_index(tile_x, tile_y), shifts);
    for (int unit = ITEM; unit < 3 * STRIDE; unit += ITEMS) {
        const int band = unit / STRIDE, column = unit % STRIDE;
        const int x = tile_x + (column < RADIUS ? -1 : column < RADIUS + TILE_COLUMNS ? 0 : 1);
        const int y = tile_y + band - 1;
        const bool exists =
            x >= 0 && x < (int)get_num_groups(0) && y >= 0 && y < (int)get_num_groups(1);
        const float2 other = exists ? vload2(tile_index(x, y), shifts) : own;
        offsets[unit] = other.x - own.x;
        offsets[3 * STRIDE + unit] = (other.y - other.x) - (own.y - own.x);
    }
    SYNC();
}

/* Whether image and target are at the tile's shift in all of its own pixels. */
inline bool is_flat(Tile tile, __global const float *image, __global const uchar *target,
                    float2 shift, SPACE float4 *scratch)
{
    const int columns = TILE_COLUMNS / VEC;
    fv sizes = (fv)(0.0f);
    for (int unit = ITEM; unit < TILE_ROWS * columns; unit += ITEMS) {
        const int px = tile.x + unit % columns * VEC, py = tile.y + unit / columns;
        const fv x = load_pixels(tile, image, px, py), y = load_levels(tile, target, px, py);
        sizes += (fabs(x - shift.x) + fabs(y - shift.y)) * image_mask(tile, px, py);
    }
    return all_zero(sizes, scratch);
}

/* Stage r, v, w with a rim of RADIUS; r is brought to the shift of this tile. Returns whether it is
 * zero everywhere. */
inline bool stage_maps(Tile tile, __global const float *r_map, __global const float *v_map,
                       __global const float *w_map, SPACE const float *offsets, SPACE float *stage,
                       SPACE float4 *scratch)
{
    const int columns = STRIDE / VEC;
    fv sizes = (fv)(0.0f);
    for (int unit = ITEM; unit < STAGE_ROWS * columns; unit += ITEMS) {
        const int row = unit / columns, column = unit % columns * VEC;
        const int px = tile.x + column - RADIUS, py = tile.y + row - RADIUS;
        const int band = row < RADIUS ? 0 : row < RADIUS + TILE_ROWS ? 1 : 2;
        const fv v = load_pixels(tile, v_map, px, py), w = load_pixels(tile, w_map, px, py);
        const fv offset = LOAD_V(0, offsets + band * STRIDE + column);
        const fv gap_offset = LOAD_V(0, offsets + (3 + band) * STRIDE + column);
        const fv r = load_pixels(tile, r_map, px, py) - fma(v, gap_offset, w * offset);
        STORE_V(r, 0, stage + row * STRIDE + column);
        STORE_V(v, 0, stage + STAGE_SIZE + row * STRIDE + column);
        STORE_V(w, 0, stage + 2 * STAGE_SIZE + row * STRIDE + column);
        sizes += fabs(r);
    }
    SYNC();
    return all_zero(sizes, scratch);
}

/* d_image = l1_scale sign(x - y) + ssim_scale dS/dx; sign(0) is 0. */
GROUP_SIZED __kernel void loss_backward(__global const float *image, __global const uchar *target,
                                        const int width, const int height,
                                        __global const float *shifts, __global const float *r_map,
                                        __global const float *v_map, __global const float *w_map,
                                        const float l1_scale, const float ssim_scale,
                                        __global float *d_image)
{
    SPACE float stage[3 * STAGE_SIZE];
    SPACE float blurred[3 * BLURRED_SIZE];
    SPACE float offsets[6 * STRIDE];
    SPACE float4 scratch[ITEMS];
    const Tile tile = make_tile(width, height);
    const float2 shift = vload2(tile_index((int)get_group_id(0), (int)get_group_id(1)), shifts);
    const bool flat = is_flat(tile, image, target, shift, scratch);
    stage_shifts(shifts, offsets);
    const bool quiet = stage_maps(tile, r_map, v_map, w_map, offsets, stage, scratch);
    if (!(flat && quiet))
        blur_rows(stage, blurred, flat ? 1 : 3);

    const int columns = TILE_COLUMNS / VEC;
    for (int unit = ITEM; unit < TILE_ROWS * columns; unit += ITEMS) {
        const int row = unit / columns, column = unit % columns * VEC;
        const int px = tile.x + column, py = tile.y + row;
        if (!(py < height && px < width))
            continue;
        const fv x = load_pixels(tile, image, px, py), y = load_levels(tile, target, px, py);
        SPACE const float *top = blurred + row * TILE_COLUMNS + column;
        fv d_ssim = (fv)(0.0f);
        if (!(flat && quiet))
            d_ssim = blur(top, TILE_COLUMNS);
        if (!flat) {
            const fv v = blur(top + BLURRED_SIZE, TILE_COLUMNS);
            const fv w = blur(top + 2 * BLURRED_SIZE, TILE_COLUMNS);
            d_ssim = fma((y - x) - (shift.y - shift.x), v, fma(x - shift.x, w, d_ssim));
        }
        const fv sign = x > y ? (fv)(l1_scale) : x < y ? (fv)(-l1_scale) : (fv)(0.0f);
        store_pixels(tile, fma((fv)(ssim_scale), d_ssim, sign), d_image, px, py);
    }
}

#define VOLUME_BLOCK 256

/* Block sums of the product of the three scales; d_scale += weight * d(product) / *total. What
 * follows Gaussian number *total has scales of zero and adds nothing. */
GROUP_SIZED __kernel void loss_volume(__global const float *scale, const int count,
                                      const float weight, __global const long *total,
                                      __global float *d_scale, __global float *sums)
{
    SPACE float4 scratch[ITEMS];
    const float share = weight / (float)max(*total, 1L);
    fv sum = (fv)(0.0f);
    for (int unit = ITEM * VEC; unit < VOLUME_BLOCK; unit += ITEMS * VEC) {
        const size_t first = get_group_id(0) * VOLUME_BLOCK + (size_t)unit;
        if (first >= (size_t)count)
            continue;
        const size_t used = min((size_t)VEC, (size_t)count - first);
        fv s[3], d[3];
        load_rows3(scale, first, used, s);
        load_rows3(d_scale, first, used, d);
        sum += s[0] * s[1] * s[2];
        for (int i = 0; i < 3; ++i)
            d[i] = fma((fv)(share), s[(i + 1) % 3] * s[(i + 2) % 3], d[i]);
        store_rows3(d, d_scale, first, used);
    }
    const float4 block = group_sum((float4)(lane_sum(sum), 0.0f, 0.0f, 0.0f), scratch);
    if (ITEM == 0)
        sums[get_group_id(0)] = block.x;
}
