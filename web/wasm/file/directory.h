/* Which bytes belong to which anchors: META's counts, CHNK, LAYR and DETL (codec_c/FORMAT.md, parts
 * 3 and 5). */
#ifndef CLGS_WEB_DIRECTORY_H
#define CLGS_WEB_DIRECTORY_H

#include "details.h"

#define CODED 4 /* sections in chunks, from ANCH on */

typedef struct chunk {
    size_t first, rows;
    int32_t corner[3]; /* of the octree cell that holds the chunk, and its depth */
    uint32_t depth;
    int64_t bounds[6]; /* least and greatest position, inclusive */
    span part[CODED];
    uint32_t crc[2]; /* of the part in ANCH, and of the others as one string of bytes */
} chunk;

/* Where a layer ends: the first chunk, row and byte of BODY that are not in it or those before. One
 * of details goes through all chunks once more, so `chunks` is twice their number; it adds no rows.
 */
typedef struct layer {
    size_t chunks, rows, bytes;
    uint64_t hash; /* of its integers and the weights; not used of details */
} layer;

typedef struct directory {
    size_t anchors, chunks, layers; /* the layer of details counts, too */
    chunk *chunk;
    layer *layer;       /* one of all chunks and no bytes, unless the file has layers */
    span header[CODED]; /* what all chunks of a section share */
    details details;
} directory;

/* Read META's counts and CHNK, and verify what they say of the other sections.
 *
 * The chunks lie in memory that is taken; those of a BODY that is cut may lie beyond its end. CRCs
 * of single chunks are not looked at here: those of whole sections and the hashes of layers cover
 * them. Nor are corners and order, which the hashes cover. */
problem directory_read(const container *file, directory *result);

#endif
