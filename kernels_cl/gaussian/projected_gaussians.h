/* VEC projected Gaussians: Gaussians on the screen, as whitened factors and boxes of visible alpha.
 */
#ifndef CLGS_PROJECTED_GAUSSIANS_H
#define CLGS_PROJECTED_GAUSSIANS_H

#include "common/camera.h"
#include "common/own_function.h"
#include "common/real.h"
#include "common/rows.h"
#include "gaussian/projection.h"

#ifndef ALPHA_CUT
#define ALPHA_CUT 0.00392156886f
#endif

/* Gaussians with smaller boxes are left out, pixels. */
#ifndef MIN_EXTENT
#define MIN_EXTENT 0.0f
#endif

#define FINITE_LIMIT 1e30f

/* One per lane; a culled one has extent 0 and zeros elsewhere. factor: r1, l, r2 of project.cl. */
typedef struct {
    fv centre[2];
    fv factor[3];
    fv depth;
    fv extent[2];
} ProjectedGaussians;

/* The whitened factor. */
static inline void whiten(const Projection *p, fv factor[3])
{
    factor[0] = 1.0f / sqrt(p->cov_xx) * p->on_unit;
    factor[1] = p->cov_xy / p->cov_xx;
    factor[2] = sqrt(p->cov_xx / p->det) * p->on_unit;
}

/* Half-widths of the box outside of which alpha < ALPHA_CUT, pixels. */
static inline void half_widths(const Projection *p, const fv opacity, fv extent[2])
{
    const fv reach = sqrt(2.0f * log_v(opacity / ALPHA_CUT)) * p->unit;
    extent[0] = reach * sqrt(p->cov_xx);
    extent[1] = reach * sqrt(p->cov_yy);
}

/* Whether the box around `centre`, which has to be finite, overlaps the image. */
static inline iv overlaps_image(const fv centre[2], const fv extent[2],
                                __global const float *camera)
{
    iv overlaps = (fabs(centre[0]) < (fv)(FINITE_LIMIT)) & (fabs(centre[1]) < (fv)(FINITE_LIMIT));
    for (int axis = 0; axis < 2; ++axis)
        overlaps = overlaps & (centre[axis] + extent[axis] > (fv)(0.0f)) &
                   (centre[axis] - extent[axis] < (fv)(camera[CAMERA_WIDTH + axis]));
    return overlaps;
}

/* Close enough to a unit quaternion to be one; NaN is not. */
static inline iv is_rotation(const fv q[4])
{
    const fv square = fma(q[0], q[0], fma(q[3], q[3], fma(q[2], q[2], q[1] * q[1])));
    return (square > (fv)(0.99f)) & (square < (fv)(1.01f));
}

static inline iv is_whitening(const fv factor[3])
{
    const fv limit = (fv)(FINITE_LIMIT);
    return (factor[0] > (fv)(0.0f)) & (factor[0] < limit) & (fabs(factor[1]) < limit) &
           (factor[2] > (fv)(0.0f)) & (factor[2] < limit);
}

/* Sets lanes of `count` columns to zero, except those to keep. */
static inline void blank(const iv keep, const int count, fv *columns)
{
    for (int k = 0; k < count; ++k)
        columns[k] = keep ? columns[k] : (fv)(0.0f);
}

/* Projected Gaussians of rotation `quaternion` and opacity `opaque`. */
static inline OWN_FUNCTION ProjectedGaussians project_gaussians(const Projection *p,
                                                                const fv quaternion[4],
                                                                const fv opaque,
                                                                __global const float *camera)
{
    ProjectedGaussians g;
    g.depth = p->z;
    for (int axis = 0; axis < 2; ++axis)
        g.centre[axis] = p->slope[axis] * camera[CAMERA_FX + axis] + camera[CAMERA_CX + axis];
    whiten(p, g.factor);
    half_widths(p, opaque, g.extent);
    const iv drawn = (p->z > (fv)(camera[CAMERA_NEAR])) & (p->z < (fv)(FINITE_LIMIT)) &
                     (opaque >= (fv)(ALPHA_CUT)) & (opaque < (fv)(FINITE_LIMIT)) &
                     is_rotation(quaternion) & is_whitening(g.factor) &
                     ((g.extent[0] >= (fv)(MIN_EXTENT)) | (g.extent[1] >= (fv)(MIN_EXTENT))) &
                     overlaps_image(g.centre, g.extent, camera);
    blank(drawn, 2, g.centre);
    blank(drawn, 3, g.factor);
    blank(drawn, 1, &g.depth);
    blank(drawn, 2, g.extent);
    return g;
}

/* Arrays of all projected Gaussians. */
typedef struct {
    __global float *mean2d;
    __global float *whitening;
    __global float *depth;
    __global float *extent;
} ProjectedArrays;

/* Writes the first `used` lanes to number `first` and on. */
static inline void store_projected(const ProjectedGaussians *g, const ProjectedArrays *out,
                                   const size_t first, const size_t used)
{
    store_rows2(g->centre, out->mean2d, first, used);
    store_rows3(g->factor, out->whitening, first, used);
    store_rows1(&g->depth, out->depth, first, used);
    store_rows2(g->extent, out->extent, first, used);
}

#endif
