/* Octree payload of mode 1, which older files hold: eight decisions a node. */
#ifndef CLGS_OCTREE_OCCUPANCY_H
#define CLGS_OCTREE_OCCUPANCY_H

#include "clgs_codec.h"

/* Bytes of memory that `count` points need. */
size_t clgs_occupancy_size(size_t count);

/* The ascending Morton codes below 8^depth of a payload. */
clgs_error clgs_occupancy_decode(const uint8_t *data, size_t size, uint64_t *code, size_t count,
                                 uint32_t depth, uint8_t *memory);

#endif
