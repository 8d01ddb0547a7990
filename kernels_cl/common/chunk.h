/* Chunks: runs of neighbouring items, one per work-item or work-group. */
#ifndef CLGS_CHUNK_H
#define CLGS_CHUNK_H

/* Items begin to end - 1. */
typedef struct {
    int begin, end;
} Chunk;

/* Chunk of this work-item, of `count` items that all work-items share. */
static inline Chunk own_chunk(const int count)
{
    const int chunks = (int)get_global_size(0), length = (count + chunks - 1) / chunks;
    const int begin = min((int)get_global_id(0) * length, count);
    const Chunk c = {begin, min(begin + length, count)};
    return c;
}

/* End of a chunk of given length that starts at `first`, among `count` items. */
static inline int chunk_end(const int first, const int length, const int count)
{
    return count - first < length ? count : first + length;
}

#endif
