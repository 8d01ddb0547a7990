/* The share of a work-item where each takes a run of neighbouring items. */
#ifndef CLGS_CHUNK_H
#define CLGS_CHUNK_H

typedef struct {
    int begin, end;
} Chunk;

/* Items of this work-item, of count shared by all. */
inline Chunk own_chunk(const int count)
{
    const int chunks = (int)get_global_size(0), length = (count + chunks - 1) / chunks;
    const int begin = min((int)get_global_id(0) * length, count);
    const Chunk c = {begin, min(begin + length, count)};
    return c;
}

#endif
