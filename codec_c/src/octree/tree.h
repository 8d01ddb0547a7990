/* The levels of an octree as one stream of decisions. Nodes with one child cost few bits, and a
 * subtree with a single point is stored whole. */
#ifndef CLGS_OCTREE_TREE_H
#define CLGS_OCTREE_TREE_H

#include "clgs_codec.h"

/* Bytes of memory that `count` points need. */
size_t clgs_tree_size(size_t count);

/* Payload of ascending Morton codes below 8^depth; returns its bytes, or 0 beyond `capacity`. */
size_t clgs_tree_encode(const uint64_t *code, size_t count, uint32_t depth, uint8_t *out,
                        size_t capacity, uint8_t *memory);

clgs_error clgs_tree_decode(const uint8_t *data, size_t size, uint64_t *code, size_t count,
                            uint32_t depth, uint8_t *memory);

#endif
