/* The three MLPs of a scene, laid out for four outputs at a time.
 *
 * Of the hidden layers' inputs only the direction changes with the camera: what the 50 features
 * give is computed once per anchor (its base), a tenth of the work remains. */
#ifndef CLGS_WEB_NETWORK_H
#define CLGS_WEB_NETWORK_H

#include <stddef.h>

#include "anchors.h"
#include "vectors.h"

enum {
    HIDDEN = 50,
    ROOM = 52, /* HIDDEN, padded to whole vectors */
    HEADS = 3, /* opacity, color, covariance */
    BASE = HEADS * ROOM,
    OPACITIES = 12, /* OFFSETS, padded */
    SHAPE = 8       /* three scale logits, four of the quaternion, padded */
};

typedef struct network {
    float feature[FEATURES][BASE];
    float direction[3][BASE];
    float bias[BASE];
    float opacity[HIDDEN][OPACITIES], opacity_bias[OPACITIES];
    float color[OFFSETS][HIDDEN][4], color_bias[OFFSETS][4];
    float shape[OFFSETS][HIDDEN][SHAPE], shape_bias[OFFSETS][SHAPE];
} network;

/* Lay out the weights of a scene, (13710,). */
void network_make(const float *weight, network *result);

/* The base (BASE,) of an anchor with this feature (FEATURES,). */
void network_base(const network *net, const float *feature, float *base);

/* Hidden activations (BASE,) of an anchor seen along a unit `direction`. */
void network_hidden(const network *net, const float *base, const float direction[3], float *hidden);

/* Opacities (OPACITIES,) before tanh. */
void network_opacity(const network *net, const float *hidden, float *opacity);

/* Of one offset: color, and scale factors and quaternion as the network gives them. */
void network_offset(const network *net, const float *hidden, size_t offset, float color[4],
                    float shape[SHAPE]);

#endif
