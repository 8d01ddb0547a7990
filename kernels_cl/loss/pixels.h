/* Tiles of planar images: guarded loads and stores of lanes along x. A work-group owns TILE_ROWS x
 * TILE_COLUMNS pixels of one channel (group ids: tile x, tile y, channel). */
#ifndef CLGS_PIXELS_H
#define CLGS_PIXELS_H

#include "common/real.h"

#define TILE_COLUMNS 16
#ifndef TILE_ROWS
#define TILE_ROWS 16
#endif

typedef struct {
    int x; /* first pixel of the tile */
    int y;
    int width; /* of the image */
    int height;
    size_t plane; /* offset of this channel */
} Tile;

inline Tile make_tile(int width, int height)
{
    Tile tile;
    tile.x = (int)get_group_id(0) * TILE_COLUMNS;
    tile.y = (int)get_group_id(1) * TILE_ROWS;
    tile.width = width;
    tile.height = height;
    tile.plane = get_group_id(2) * (size_t)width * (size_t)height;
    return tile;
}

/* Number of a tile of this channel among the tiles of all channels. */
inline size_t tile_index(int tile_x, int tile_y)
{
    return (get_group_id(2) * get_num_groups(1) + (size_t)tile_y) * get_num_groups(0) +
           (size_t)tile_x;
}

inline bool inside(Tile tile, int x, int y)
{
    return x >= 0 && x < tile.width && y >= 0 && y < tile.height;
}

/* Lanes from pixel (x, y) on, zero outside of the image. */
inline fv load_pixels(Tile tile, __global const float *image, int x, int y)
{
    __global const float *row = image + tile.plane + (size_t)y * (size_t)tile.width;
    if (y >= 0 && y < tile.height && x >= 0 && x + VEC <= tile.width)
        return LOAD_V(0, row + x);
    float lanes[VEC];
    for (int lane = 0; lane < VEC; ++lane)
        lanes[lane] = inside(tile, x + lane, y) ? row[x + lane] : 0.0f;
    return LOAD_V(0, lanes);
}

/* The same of 8-bit pixels, as level / 255 correctly rounded. */
inline fv load_levels(Tile tile, __global const uchar *target, int x, int y)
{
    __global const uchar *row = target + tile.plane + (size_t)y * (size_t)tile.width;
    fv level;
    if (y >= 0 && y < tile.height && x >= 0 && x + VEC <= tile.width) {
        level = TO_FV(LOAD_V(0, row + x));
    } else {
        float lanes[VEC];
        for (int lane = 0; lane < VEC; ++lane)
            lanes[lane] = inside(tile, x + lane, y) ? (float)row[x + lane] : 0.0f;
        level = LOAD_V(0, lanes);
    }
    const fv quotient = level * (1.0f / 255.0f);
    const fv rest = fma(quotient, (fv)(-255.0f), level);
    return fma(rest, (fv)(1.0f / 255.0f), quotient);
}

inline void store_pixels(Tile tile, fv value, __global float *image, int x, int y)
{
    __global float *row = image + tile.plane + (size_t)y * (size_t)tile.width;
    if (x + VEC <= tile.width) {
        STORE_V(value, 0, row + x);
        return;
    }
    float lanes[VEC];
    STORE_V(value, 0, lanes);
    for (int lane = 0; lane < VEC && x + lane < tile.width; ++lane)
        row[x + lane] = lanes[lane];
}

/* 1 for lanes whose pixel lies in the image, else 0. */
inline fv image_mask(Tile tile, int x, int y)
{
    if (y >= 0 && y < tile.height && x >= 0 && x + VEC <= tile.width)
        return (fv)(1.0f);
    float lanes[VEC];
    for (int lane = 0; lane < VEC; ++lane)
        lanes[lane] = inside(tile, x + lane, y) ? 1.0f : 0.0f;
    return LOAD_V(0, lanes);
}

#endif
