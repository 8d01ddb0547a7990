/* The sections of a .clgs file (codec_c/FORMAT.md, part 2). */
#ifndef CLGS_WEB_CONTAINER_H
#define CLGS_WEB_CONTAINER_H

#include <stddef.h>
#include <stdint.h>

/* Functions that can fail return what is wrong, an English phrase, or NULL. */
typedef const char *problem;

#define NO_MEMORY "the scene does not fit this browser's memory"

typedef struct span {
    const uint8_t *data;
    size_t size;
} span;

#define CUT "the file is cut or damaged; copy it again"

/* Sections of a scene, those that a scene in layers has last, and those of a file of splats. */
enum { META, CHNK, ANCH, OFFS, FEAT, SCAL, MLPS, LAYR, DETL, BODY };
enum { SPLT, SPOS, SMUL, SATR };

#define SECTIONS 10

typedef struct container {
    int splats;  /* whether it holds splats in place of a scene */
    int layers;  /* whether it has LAYR and BODY */
    int details; /* whether it has DETL between them */
    span section[SECTIONS];
    span photos;             /* PHOT, empty if there is none */
    size_t begin, body_size; /* where BODY begins, and its bytes when all have come */
} container;

/* How many bytes the file has, by its table, and how many come before a BODY that may be cut; both
 * 0 if more of the beginning is needed to tell. */
problem container_size(span file, uint64_t *size, uint64_t *front);

/* Find the sections of `file`; all checksums are verified, but that of a BODY that is cut. */
problem container_read(span file, container *result);

/* The IEEE number at `at`. */
double load_double(const uint8_t *at);

#endif
