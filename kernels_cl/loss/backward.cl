/* Gradient of L1 and SSIM by the image, from the maps of forward.cl, which has the equations.
 *
 * A work-group owns a patch of PATCH_ROWS x PATCH_COLUMNS pixels of one channel: on a CPU
 * one work-item, VEC pixels at a time, with the patch and its rim in private memory; on a GPU ITEMS
 * work-items, with both in local memory. Launch size: (patches across * work-items of a group,
 * patches down, 3). */
#include "common/real.h"
#include "loss/group.h"
#include "loss/patch.h"
#include "loss/window.h"

/* Shifts of the patches around this one, relative to its own, by staged column (c_x) and row band:
 * [0] c_x, [1] c_y - c_x, each (3, STRIDE). */
static inline void stage_shifts(__global const float *shifts, SPACE float *offsets)
{
    const int patch_x = (int)get_group_id(0), patch_y = (int)get_group_id(1);
    const float2 own = vload2(patch_index(patch_x, patch_y), shifts);
    for (int unit = ITEM; unit < 3 * STRIDE; unit += ITEMS) {
        const int band = unit / STRIDE, column = unit % STRIDE;
        const int x = patch_x + (column < RADIUS ? -1 : column < RADIUS + PATCH_COLUMNS ? 0 : 1);
        const int y = patch_y + band - 1;
        const bool exists =
            x >= 0 && x < (int)get_num_groups(0) && y >= 0 && y < (int)get_num_groups(1);
        const float2 other = exists ? vload2(patch_index(x, y), shifts) : own;
        offsets[unit] = other.x - own.x;
        offsets[3 * STRIDE + unit] = (other.y - other.x) - (own.y - own.x);
    }
    SYNC();
}

/* Whether image and target are at the patch's shift in all of its own pixels. */
static inline bool is_flat(Patch patch, __global const float *image, __global const uchar *target,
                           float2 shift, SPACE float4 *scratch)
{
    const int columns = PATCH_COLUMNS / VEC;
    fv sizes = (fv)(0.0f);
    for (int unit = ITEM; unit < PATCH_ROWS * columns; unit += ITEMS) {
        const int px = patch.x + unit % columns * VEC, py = patch.y + unit / columns;
        const fv x = load_pixels(patch, image, px, py), y = load_levels(patch, target, px, py);
        sizes += (fabs(x - shift.x) + fabs(y - shift.y)) * image_mask(patch, px, py);
    }
    return all_zero(sizes, scratch);
}

/* Stage r, v, w with a rim of RADIUS; r is brought to the shift of this patch. Returns whether it
 * is zero everywhere. */
static inline bool stage_maps(Patch patch, __global const float *r_map, __global const float *v_map,
                              __global const float *w_map, SPACE const float *offsets,
                              SPACE float *stage, SPACE float4 *scratch)
{
    const int columns = STRIDE / VEC;
    fv sizes = (fv)(0.0f);
    for (int unit = ITEM; unit < STAGE_ROWS * columns; unit += ITEMS) {
        const int row = unit / columns, column = unit % columns * VEC;
        const int px = patch.x + column - RADIUS, py = patch.y + row - RADIUS;
        const int band = row < RADIUS ? 0 : row < RADIUS + PATCH_ROWS ? 1 : 2;
        const fv v = load_pixels(patch, v_map, px, py), w = load_pixels(patch, w_map, px, py);
        const fv offset = LOAD_V(0, offsets + band * STRIDE + column);
        const fv gap_offset = LOAD_V(0, offsets + (3 + band) * STRIDE + column);
        const fv r = load_pixels(patch, r_map, px, py) - fma(v, gap_offset, w * offset);
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
    SPACE float blurred[3 * BLURRED_SIZE] __attribute__((aligned(16)));
    SPACE float offsets[6 * STRIDE];
    SPACE float4 *scratch = (SPACE float4 *)blurred; /* until something is blurred */
    const Patch patch = make_patch(width, height);
    const float2 shift = vload2(patch_index((int)get_group_id(0), (int)get_group_id(1)), shifts);
    const bool flat = is_flat(patch, image, target, shift, scratch);
    stage_shifts(shifts, offsets);
    const bool quiet = stage_maps(patch, r_map, v_map, w_map, offsets, stage, scratch);
    if (!(flat && quiet))
        blur_rows(stage, blurred, flat ? 1 : 3);

    const int columns = PATCH_COLUMNS / VEC;
    for (int unit = ITEM; unit < PATCH_ROWS * columns; unit += ITEMS) {
        const int row = unit / columns, column = unit % columns * VEC;
        const int px = patch.x + column, py = patch.y + row;
        if (!(py < height && px < width))
            continue;
        const fv x = load_pixels(patch, image, px, py), y = load_levels(patch, target, px, py);
        SPACE const float *top = blurred + row * PATCH_COLUMNS + column;
        fv d_ssim = (fv)(0.0f);
        if (!(flat && quiet))
            d_ssim = blur(top, PATCH_COLUMNS);
        if (!flat) {
            const fv v = blur(top + BLURRED_SIZE, PATCH_COLUMNS);
            const fv w = blur(top + 2 * BLURRED_SIZE, PATCH_COLUMNS);
            d_ssim = fma((y - x) - (shift.y - shift.x), v, fma(x - shift.x, w, d_ssim));
        }
        const fv sign = x > y ? (fv)(l1_scale) : x < y ? (fv)(-l1_scale) : (fv)(0.0f);
        store_pixels(patch, fma((fv)(ssim_scale), d_ssim, sign), d_image, px, py);
    }
}
