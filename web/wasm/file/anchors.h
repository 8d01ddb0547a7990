/* A scene of anchors, decoded in steps so that a page can show how far it is. */
#ifndef CLGS_WEB_ANCHORS_H
#define CLGS_WEB_ANCHORS_H

#include "attributes.h"
#include "directory.h"

enum { OFFSETS = 10, FEATURES = 50, SCALINGS = 6, WEIGHTS = 13710 };

/* The integers of all anchors, then floats in the same memory; rows in Morton order. */
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
    int32_t *near; /* of the present chunk */
    size_t chunk, part, chunk_mark;
    int read;
    uint64_t expected_hash, hash;
} anchors;

/* Columns of the arrays. */
extern const size_t COLUMNS_OF[CODED];

/* Begin with a file that holds a scene; `*steps`: how many calls of anchors_step there will be. */
problem anchors_open(const container *file, anchors *result, size_t *steps);

/* One step: a part of a chunk; after all chunks the weights, then hash and floats. */
problem anchors_step(anchors *a);

#endif
