/* How the screen of a picture blurs Gaussians that may have been learned at other sizes. */
#ifndef CLGS_SCREEN_H
#define CLGS_SCREEN_H

#include "common/camera.h"
#include "common/lane_math.h"
#include "common/method.h"
#include "common/real.h"

/* Variance along each axis of the blur that Gaussians have, and of that by which they give their
 * light, square pixels. */
typedef struct {
    fv blur;
    fv learned;
} Blurs;

static inline fv distance3(const fv p[3], const float x, const float y, const float z)
{
    const fv d[3] = {p[0] - x, p[1] - y, p[2] - z};
    return sqrt(dot3(d, d));
}

/* How many times larger a Gaussian is on the screen than in the photos. Distances that photos had
 * count as theirs. screen: clgs/ops/project.py names its numbers. */
static inline fv enlargement(const float8 screen, const fv mean[3], __global const float *camera)
{
    __global const float *centre = camera + CAMERA_CENTRE;
    const fv inside = distance3(mean, screen.s0, screen.s1, screen.s2);
    const fv away = distance3(mean, centre[0], centre[1], centre[2]);
    const fv within = screen.s3 - inside, without = inside - screen.s4;
    const fv nearest = within > without ? within : without, farthest = screen.s4 + inside;
    const fv bound = away < nearest ? nearest : farthest; /* no quotient where none is needed */
    const iv among = (away >= nearest) & (away <= farthest);
    return among ? (fv)(screen.s5) : screen.s5 * bound / away;
}

/* Enlarged, Gaussians have the blur of the photos, so that they do not fall apart. Reduced, a pixel
 * of the screen takes the mean of more than a pixel of the photos. */
static inline Blurs blurs_of(const float8 screen, const fv mean[3], __global const float *camera)
{
    Blurs b = {(fv)(screen.s7), (fv)(screen.s6)};
    if (screen.s5 == 0.0f)
        return b;
    const fv size = enlargement(screen, mean, camera), square = size * size;
    const fv rest = 1.0f - square;
    b.learned *= square;
    b.blur = b.blur * square + (rest > (fv)(0.0f) ? rest * PIXEL_VARIANCE : (fv)(0.0f));
    return b;
}

#endif
