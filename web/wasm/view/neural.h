/* Neural Gaussians of a scene for one place of the camera. */
#ifndef CLGS_WEB_NEURAL_H
#define CLGS_WEB_NEURAL_H

#include "anchors.h"
#include "gaussians.h"
#include "network.h"

typedef struct neural {
    const anchors *from;
    network *net;
    float *base; /* (A, BASE) */
    float *size; /* (A, SCALINGS), the exponentials of the scalings */
} neural;

/* Room for what anchors_* decodes. */
problem neural_open(const anchors *from, neural *result);

/* Lay out the weights, once the anchors are decoded. */
void neural_weights(neural *n);

/* Make ready `count` anchors from `first` on: their bases and sizes. Once more after their features
 * and scalings have changed; until then they are drawn as they were. */
void neural_prepare(neural *n, size_t first, size_t count);

/* Add the Gaussians of these anchors whose opacity is at least `alpha_cut`. */
void neural_add(const neural *n, size_t first, size_t count, const float centre[3], float alpha_cut,
                gaussians *to);

#endif
