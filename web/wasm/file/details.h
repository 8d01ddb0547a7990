/* What the last layer of a file may add to all anchors: DETL (codec_c/FORMAT.md, part 5.4). */
#ifndef CLGS_WEB_DETAILS_H
#define CLGS_WEB_DETAILS_H

#include "attributes.h"

#define DETAILED 3 /* sections that have details, from OFFS on */

typedef struct details {
    uint32_t step;       /* attributes of chunks are multiplied by it; 1 without details */
    const uint8_t *list; /* DETL */
    span header[DETAILED];
    span *part; /* (chunks, DETAILED), in BODY, where it may not have come yet */
    attributes model[DETAILED];
} details;

/* Read DETL, if the file has it, whose `chunks` chunks end at byte `begin` of BODY. */
problem details_read(const container *file, size_t chunks, size_t begin, details *result);

/* Read the headers, once all of BODY is there; `columns`: of OFFS, FEAT and SCAL. */
problem details_open(details *d, const size_t columns[DETAILED]);

/* Verify the CRC of a chunk's details. */
problem details_verify(const details *d, size_t chunk);

/* Add to the attributes of a chunk, (rows, columns), in section OFFS + `part`: what the chunk has
 * becomes what the scene has. `near` as of clgs_attributes_decode. */
problem details_add(const details *d, size_t chunk, size_t part, const int32_t *near, size_t rows,
                    int32_t *value);

#endif
