/* Ordinary splats (codec_c/FORMAT.md, part 11), decoded in steps, and their Gaussians. */
#ifndef CLGS_WEB_SPLATS_H
#define CLGS_WEB_SPLATS_H

#include "arrays.h"
#include "gaussians.h"

/* Where the numbers of a splat are found; the properties' names are those of 3DGS's files. */
enum { COLOR, OPACITY = 3, SIZE, ROTATION = 7, NEEDED = 11, REST = NEEDED, MAX_REST = 45 };

typedef struct splats {
    const container *file;
    size_t count, voxels, properties;
    float *position; /* (count, 3) */
    union {
        int32_t *integer;
        float *value;
    } all;                          /* (count, properties), integers and then floats */
    size_t column[REST + MAX_REST]; /* of f_dc, opacity, scale, rot, f_rest */
    size_t antialiased;             /* the column that says so, SIZE_MAX without one */
    double origin[3];               /* positions are relative to it: 0, or their middle if far */
    float near;                     /* the near plane */
    int keeps_light;                /* whether opacities are meant for antialiased drawing */
    size_t rest;                    /* coefficients of each color beyond the first: 0, 3, 8 or 15 */
    rows attribute;
    size_t step, row;
    uint64_t expected_hash, hash;
} splats;

/* Begin with a file that holds splats; `*steps`: how many calls of splats_step there will be. */
problem splats_open(const container *file, splats *result, size_t *steps);

/* One step: positions, then a chunk of the other properties, then hash and floats. */
problem splats_step(splats *s);

/* Add `count` splats from `first` on, seen from `centre`, of opacity `alpha_cut` or more. */
void splats_add(const splats *s, size_t first, size_t count, const float centre[3], float alpha_cut,
                gaussians *to);

#endif
