/* Which bytes belong to which anchors: META's counts and CHNK (codec_c/FORMAT.md, parts 3 and 5).
 */
#ifndef CLGS_WEB_DIRECTORY_H
#define CLGS_WEB_DIRECTORY_H

#include "container.h"

#define CODED 4 /* sections in chunks, from ANCH on */

typedef struct chunk {
    size_t first, rows;
    int32_t corner[3]; /* of the octree cell that holds the chunk, and its depth */
    uint32_t depth;
    span part[CODED];
} chunk;

typedef struct directory {
    size_t anchors, chunks;
    chunk *chunk;
    span header[CODED]; /* what all chunks of a section share */
} directory;

/* Read META's counts and CHNK, and verify what they say of the other sections.
 *
 * The chunks lie in memory that is taken. CRCs of single chunks are not looked at: those of whole
 * sections cover them. Nor are corners and order, which the content hash covers. */
problem directory_read(const container *file, directory *result);

#endif
