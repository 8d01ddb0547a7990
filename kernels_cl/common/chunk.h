/* The share of a work-item if every work-item takes a run of neighbouring items. */
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

#endif
