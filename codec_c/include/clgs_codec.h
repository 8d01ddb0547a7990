/* The C part of the clgs codec: four pure functions a part, as FORMAT.md defines their bytes.
 *
 * No function allocates, keeps state between calls or reads the environment: the caller owns the
 * output and one workspace, whose size `_workspace` gives. `_bound` gives an output size that
 * always suffices. `_encode` returns the bytes written, or 0 where an argument is out of range or
 * a buffer too small. `_decode` returns CLGS_OK or a negative clgs_error; it reads nothing outside
 * [data, data + size), writes nothing outside its output and workspace, and accepts only a stream
 * that ends exactly at `size`. All arithmetic is on integers, so all machines make the same bytes.
 */
#ifndef CLGS_CODEC_H
#define CLGS_CODEC_H

#include <stddef.h>
#include <stdint.h>

typedef enum clgs_error {
    CLGS_OK = 0,
    CLGS_ERROR_ARGUMENT = -1,  /* a count or buffer size is out of range */
    CLGS_ERROR_TRUNCATED = -2, /* the stream ends before the last symbol */
    CLGS_ERROR_TRAILING = -3,  /* bytes follow the last symbol */
    CLGS_ERROR_CORRUPT = -4    /* the stream holds what no encoder writes */
} clgs_error;

#define CLGS_MAX_POINTS ((size_t)1 << 27) /* points of an octree, rows of attributes */
#define CLGS_MAX_CHANNELS ((size_t)256)   /* attribute channels of one stream */
#define CLGS_MAX_LAYERS ((size_t)64)      /* layers of weights */
#define CLGS_MAX_ROWS ((uint32_t)1 << 20) /* of a layer */
#define CLGS_MAX_COLUMNS 1024             /* of a layer */
#define CLGS_MAX_DEPTH 21                 /* octree levels: 3 * 21 bits fit a Morton code */

/* One English phrase for an error code; never NULL. */
const char *clgs_error_text(clgs_error error);

/* CRC-32C (Castagnoli, reflected, as in iSCSI) of `size` bytes; "123456789" gives 0xE3069283. */
uint32_t clgs_crc32c(const uint8_t *data, size_t size);

/* The same without the processor's instruction for it. */
uint32_t clgs_crc32c_portable(const uint8_t *data, size_t size);

/* XXH64 of `size` bytes with seed 0; "abc" gives 0x44BC2CF5AD770999. */
uint64_t clgs_xxh64(const uint8_t *data, size_t size);

/* Morton codes of `count` points (x, y, z) relative to `origin`: bit 3b+2 is bit b of x, 3b+1 of
 * y, 3b of z. Returns CLGS_ERROR_ARGUMENT where a coordinate is outside origin + [0, 2^21). */
clgs_error clgs_morton_encode(const int32_t *position, size_t count, const int32_t origin[3],
                              uint64_t *code);

/* Octree: `count` unique points (x, y, z), int32, in ascending Morton order relative to `origin`,
 * in origin + [0, 2^21) on each axis. */
size_t clgs_octree_bound(size_t count);
size_t clgs_octree_workspace(size_t count);
size_t clgs_octree_encode(const int32_t *position, size_t count, const int32_t origin[3],
                          uint8_t *out, size_t capacity, void *workspace);
clgs_error clgs_octree_decode(const uint8_t *data, size_t size, int32_t *position, size_t count,
                              void *workspace);

/* Run-length: a (rows, channels) matrix of int32, any values, row-major. */
size_t clgs_runlength_bound(size_t rows, size_t channels);
size_t clgs_runlength_workspace(size_t channels);
size_t clgs_runlength_encode(const int32_t *value, size_t rows, size_t channels, uint8_t *out,
                             size_t capacity, void *workspace);
clgs_error clgs_runlength_decode(const uint8_t *data, size_t size, int32_t *value, size_t rows,
                                 size_t channels, void *workspace);

/* Paper: such a matrix by the plain run-length coder, for comparison; it needs no workspace. */
size_t clgs_paper_bound(size_t rows, size_t channels);
size_t clgs_paper_encode(const int32_t *value, size_t rows, size_t channels, uint8_t *out,
                         size_t capacity);
clgs_error clgs_paper_decode(const uint8_t *data, size_t size, int32_t *value, size_t rows,
                             size_t channels);

/* Planes: `count` 32-bit words (IEEE floats as bits), coded byte by byte from the top. */
size_t clgs_planes_bound(size_t count);
size_t clgs_planes_workspace(void);
size_t clgs_planes_encode(const uint32_t *word, size_t count, uint8_t *out, size_t capacity,
                          void *workspace);
clgs_error clgs_planes_decode(const uint8_t *data, size_t size, uint32_t *word, size_t count,
                              void *workspace);

/* Attributes: (rows, channels) matrices of int32, any values, row-major, cut into chunks of rows
 * that share a model. A model is `_model_size` bytes of the caller, zero at first; every function
 * checks it. `_header_write` puts it into bytes, `_header_read` gets it back. `_encode` and
 * `_decode` are for one chunk of at least one row. */
size_t clgs_attributes_model_size(size_t channels);
size_t clgs_attributes_header_workspace(void);
size_t clgs_attributes_header_write(void *model, size_t channels, uint8_t *out, size_t capacity,
                                    void *workspace);
clgs_error clgs_attributes_header_read(const uint8_t *data, size_t size, void *model,
                                       size_t channels, void *workspace);
size_t clgs_attributes_bound(const void *model, size_t rows, size_t channels);
size_t clgs_attributes_workspace(size_t rows, size_t channels);
size_t clgs_attributes_encode(const void *model, const int32_t *value, size_t rows, size_t channels,
                              uint8_t *out, size_t capacity, void *workspace);
clgs_error clgs_attributes_decode(const void *model, const uint8_t *data, size_t size,
                                  int32_t *value, size_t rows, size_t channels, void *workspace);

/* The encoder's choice of tables: add a chunk's symbols to `count`, (channels, 64 cells, 256
 * symbols); then turn counts into classes and tables of the model, and `cost`, (channels), in
 * 2^-16 bits. `scale` is 256 times what the counted rows stand for. */
clgs_error clgs_attributes_count(const void *model, const int32_t *value, size_t rows,
                                 size_t channels, uint32_t *count, void *workspace);
/* Add to `bytes`, (channels), what a chunk takes in each channel that the model mixes; `out` is
 * scratch memory of `_measure_bound` bytes. */
size_t clgs_attributes_measure_bound(size_t rows);
clgs_error clgs_attributes_measure(const void *model, const int32_t *value, size_t rows,
                                   size_t channels, uint64_t *bytes, uint8_t *out, void *workspace);
size_t clgs_attributes_choose_workspace(void);
clgs_error clgs_attributes_choose(void *model, size_t channels, const uint32_t *count,
                                  uint32_t scale, uint64_t *cost, void *workspace);

/* Weights: layers of 32-bit words (IEEE floats as bits), each a (rows, columns) matrix, row-major,
 * one after another. Multiples of a power of two, one for each layer, are coded as integers where
 * that is shorter, all others as planes are. */
typedef struct clgs_layer {
    uint32_t rows, columns;
} clgs_layer;

size_t clgs_weights_bound(const clgs_layer *layer, size_t layers);
size_t clgs_weights_workspace(const clgs_layer *layer, size_t layers);
size_t clgs_weights_encode(const uint32_t *word, const clgs_layer *layer, size_t layers,
                           uint8_t *out, size_t capacity, void *workspace);
clgs_error clgs_weights_decode(const uint8_t *data, size_t size, uint32_t *word,
                               const clgs_layer *layer, size_t layers, void *workspace);

#endif
