/* A footprint packed into 4 words. The first has its first row and first column, 16 bits each; the
 * next two have a byte for each of up to BOX_ROWS rows: the columns before the row's first tile in
 * the low half, the number of its tiles in the high half. A larger box has no bytes: its tiles are
 * found again wherever they are needed, by tiles/large_footprint.h. */
#ifndef CLGS_BOX_H
#define CLGS_BOX_H

#define BOX_ROWS 8
#define BOX_COLUMNS 15

static inline ulong bytes_of(const int4 box)
{
    return (ulong)(uint)box.y | (ulong)(uint)box.z << 32;
}

static inline int top_of(const int4 box)
{
    return box.x >> 16;
}

static inline int left_of(const int4 box)
{
    return box.x & 0xffff;
}

#endif
