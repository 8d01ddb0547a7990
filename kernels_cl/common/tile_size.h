/* Tiles of the rasteriser: squares of TILE_SIZE pixels, row-major. */
#ifndef CLGS_TILE_SIZE_H
#define CLGS_TILE_SIZE_H

#include "common/form.h"

#ifndef TILE_SIZE
#define TILE_SIZE 16
#endif
#define TILE_PIXELS (TILE_SIZE * TILE_SIZE)
#define TILE_GROUP GROUP_OF(TILE_PIXELS)

/* Tiles that cover `pixels` pixels along one axis. */
static inline int tiles_across(const int pixels)
{
    return (pixels + TILE_SIZE - 1) / TILE_SIZE;
}

#endif
