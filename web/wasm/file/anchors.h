/* A scene of anchors, decoded layer by layer, in steps so that a page can show how far it is. */
#ifndef CLGS_WEB_ANCHORS_H
#define CLGS_WEB_ANCHORS_H

#include "attributes.h"
#include "directory.h"

enum { OFFSETS = 10, FEATURES = 50, SCALINGS = 6, WEIGHTS = 13710 };

/* The integers of all anchors, then floats in the same memory; rows in the file's order. */
typedef union numbers {
    int32_t *integer;
    float *value;
} numbers;

typedef struct anchors {
    const container *file;
    directory list;
    attributes model[CODED]; /* the first, of positions, is not used */
    numbers array[CODED];    /* (A, 3), (A, 30), (A, 50), (A, 6) */
    float *weight;
    int32_t *near;             /* of the present chunk */
    size_t layer, chunk, part; /* the next ones; of details, chunks go on behind the last */
    size_t chunk_mark;
    size_t rows;                  /* of the layers that are decoded */
    uint8_t *taken;               /* whether a chunk was, by anchors_take */
    int read;                     /* whether the weights are */
    uint64_t expected_hash, hash; /* of the last layer that was decoded */
} anchors;

/* Columns of the arrays. */
extern const size_t COLUMNS_OF[CODED];

/* Begin with a file that holds a scene. */
problem anchors_open(const container *file, anchors *result);

/* How many layers can be decoded, with these bytes of BODY. */
size_t anchors_layers(const anchors *a, size_t bytes);

/* How many calls of anchors_step decode the first `layers` layers. */
size_t anchors_left(const anchors *a, size_t layers);

/* One step: first the weights, then a part of a chunk, or hash and floats of a layer.
 *
 * Details change the floats chunk by chunk. */
problem anchors_step(anchors *a);

/* Decode a chunk of a file in layers, whose bytes are there, though others before may be missing:
 * verified by its CRCs, at once as floats. Once this has begun, all chunks come by it. */
problem anchors_take(anchors *a, size_t chunk);

#endif
