/* Points from world space to camera space. */
#ifndef CLGS_CAMERA_SPACE_H
#define CLGS_CAMERA_SPACE_H

#include "common/camera.h"
#include "common/real.h"

/* Coordinate `row` (x, y or z) of VEC points in camera space. */
static inline fv camera_coordinate(__global const float *camera, const int row, const fv point[3])
{
    __global const float *r = camera + CAMERA_ROTATION + 3 * row;
    const fv turned = fma((fv)(r[2]), point[2], fma((fv)(r[1]), point[1], (fv)(r[0]) * point[0]));
    return turned + (fv)(camera[CAMERA_TRANSLATION + row]);
}

#endif
