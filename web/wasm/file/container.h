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

/* Sections of a scene, and of a file of splats. */
enum { META, CHNK, ANCH, OFFS, FEAT, SCAL, MLPS };
enum { SPLT, SPOS, SMUL, SATR };

#define SECTIONS 7

typedef struct container {
    int splats; /* whether it holds splats in place of a scene */
    span section[SECTIONS];
} container;

/* Find the sections of `file`; all checksums are verified. */
problem container_read(span file, container *result);

/* The IEEE number at `at`. */
double load_double(const uint8_t *at);

#endif
