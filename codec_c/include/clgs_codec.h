/* The C part of the clgs codec: arrays to bytes and back, in the streams that FORMAT.md defines.
 *
 * What all functions share
 *
 * - Nothing is allocated, no state is kept between calls, no file or environment variable is read.
 *   Calls from several threads are safe as long as each has its own output and workspace.
 * - The caller owns all memory. `_workspace` gives the bytes of scratch memory that a call needs:
 *   aligned as malloc aligns, not initialised, of no use afterwards, and good for the next call.
 *   `_bound` gives an output size that always suffices. Both return 0 if the shape is out of range;
 *   then the call that they are for refuses the shape, too.
 * - Inputs, output and workspace must not overlap.
 * - `_encode` returns the number of bytes written, at least 1, or 0 if an argument is out of range
 *   or `capacity` is too small. The same input gives the same bytes on every machine: all
 *   arithmetic is on integers.
 * - `_decode` takes any bytes. It reads only [data, data + size), writes only its output and
 *   workspace, and ends: its time is bounded by the shape that the caller asks for, not by what the
 *   bytes claim. It returns CLGS_OK only if the stream ends exactly at `size`; otherwise one of the
 *   errors below, and the output holds anything. No stream carries a checksum: damage that spells
 *   another valid stream decodes to other numbers, so check clgs_crc32c of the bytes first.
 * - Numbers are in native byte order in memory and little-endian in streams.
 */
#ifndef CLGS_CODEC_H
#define CLGS_CODEC_H

#include <stddef.h>
#include <stdint.h>

typedef enum clgs_error {
    CLGS_OK = 0,
    CLGS_ERROR_ARGUMENT = -1,  /* a count, a shape or a model is out of range */
    CLGS_ERROR_TRUNCATED = -2, /* the stream ends before the last symbol */
    CLGS_ERROR_TRAILING = -3,  /* bytes follow the last symbol */
    CLGS_ERROR_CORRUPT = -4    /* the stream holds what no encoder writes */
} clgs_error;

#define CLGS_MAX_POINTS ((size_t)1 << 27) /* points of an octree, rows of a matrix, words */
#define CLGS_MAX_CHANNELS ((size_t)256)   /* channels of a matrix */
#define CLGS_MAX_LAYERS ((size_t)64)      /* layers of weights */
#define CLGS_MAX_ROWS ((uint32_t)1 << 20) /* of a layer */
#define CLGS_MAX_COLUMNS 1024             /* of a layer */
#define CLGS_MAX_DEPTH 21                 /* octree levels: 3 * 21 bits fit a Morton code */
#define CLGS_NEAR 4                       /* near rows of a row of attributes */

/* An English phrase for an error code, such as "the stream ends before its last symbol".
 *
 * Never NULL; an unknown code has the phrase of CLGS_ERROR_CORRUPT. The string is static. */
const char *clgs_error_text(clgs_error error);

/* ---- Checksums ---- */

/* CRC-32C (Castagnoli, reflected, as in iSCSI) of `size` bytes; "123456789" gives 0xE3069283.
 *
 * Uses the processor's instruction for it if there is one. */
uint32_t clgs_crc32c(const uint8_t *data, size_t size);

/* The same value, from tables alone: what other processors run, callable on all for tests. */
uint32_t clgs_crc32c_portable(const uint8_t *data, size_t size);

/* XXH64 with seed 0 of `size` bytes; "abc" gives 0x44BC2CF5AD770999. */
uint64_t clgs_xxh64(const uint8_t *data, size_t size);

/* ---- Positions: an octree ---- */

/* Morton codes of points relative to `origin`.
 *
 * position: (count, 3) x, y, z; any count, any order.
 * code: `count` words; bit 3b+2 is bit b of x - origin, bit 3b+1 of y, bit 3b of z.
 * Returns CLGS_ERROR_ARGUMENT if a coordinate is outside of origin + [0, 2^21); the codes before
 * that point are written. */
clgs_error clgs_morton_encode(const int32_t *position, size_t count, const int32_t origin[3],
                              uint64_t *code);

/* 17 + 8 * count bytes, or 0 if there are more than CLGS_MAX_POINTS points. */
size_t clgs_octree_bound(size_t count);

/* About 280 bytes per point and one mebibyte, or 0 if there are more than CLGS_MAX_POINTS points
 * or the size does not fit size_t. Encoder and decoder need the same. */
size_t clgs_octree_workspace(size_t count);

/* The octree of points.
 *
 * position: (count, 3), at least 1 point, each in origin + [0, 2^21) on every axis; Morton codes
 *     relative to `origin` must ascend, so no point repeats.
 * capacity: at least clgs_octree_bound(count).
 * Returns the bytes written, or 0 if one of these does not hold. */
size_t clgs_octree_encode(const int32_t *position, size_t count, const int32_t origin[3],
                          uint8_t *out, size_t capacity, void *workspace);

/* The points of an octree, in ascending Morton order relative to the origin in the stream.
 *
 * position: room for (count, 3); `count` is what the encoder was given, which the stream does not
 *     hold. A point costs at least 1/22,711 byte: bound `count` by `size` before you allocate.
 * Damaged input: an error, or `count` other points, unique and in order, within int32. Returns
 * CLGS_ERROR_ARGUMENT if `count` is 0 or above CLGS_MAX_POINTS. */
clgs_error clgs_octree_decode(const uint8_t *data, size_t size, int32_t *position, size_t count,
                              void *workspace);

/* ---- Small matrices: run-length, with contexts ---- */

/* 1 + 4 * rows * channels bytes, or 0 if the shape is out of range: up to CLGS_MAX_POINTS rows, 1
 * to CLGS_MAX_CHANNELS channels. */
size_t clgs_runlength_bound(size_t rows, size_t channels);

/* About 43 kilobytes per channel and 20, or 0 unless there are 1 to CLGS_MAX_CHANNELS. */
size_t clgs_runlength_workspace(size_t channels);

/* A matrix of any int32 as runs of equal rows and coded rows; chunks are listed in it.
 *
 * value: (rows, channels), row-major; no rows are allowed.
 * capacity: at least clgs_runlength_bound(rows, channels).
 * Returns the bytes written, or 0 if the shape is out of range or `capacity` is too small. */
size_t clgs_runlength_encode(const int32_t *value, size_t rows, size_t channels, uint8_t *out,
                             size_t capacity, void *workspace);

/* The matrix of such a stream, to (rows, channels) of `value`; the shape is the encoder's.
 *
 * A run costs next to nothing: `size` does not bound `rows`. Damaged input: an error, or other
 * numbers. Returns CLGS_ERROR_ARGUMENT if the shape is out of range. */
clgs_error clgs_runlength_decode(const uint8_t *data, size_t size, int32_t *value, size_t rows,
                                 size_t channels, void *workspace);

/* ---- The same, plain: the coder of the paper, for comparison ---- */

/* As clgs_runlength_bound. There is no workspace: some kilobytes of stack suffice. */
size_t clgs_paper_bound(size_t rows, size_t channels);

/* As clgs_runlength_encode. */
size_t clgs_paper_encode(const int32_t *value, size_t rows, size_t channels, uint8_t *out,
                         size_t capacity);

/* As clgs_runlength_decode. */
clgs_error clgs_paper_decode(const uint8_t *data, size_t size, int32_t *value, size_t rows,
                             size_t channels);

/* ---- Attributes: matrices in chunks of rows that share a model ----
 *
 * A model says for every channel how its values are predicted, and with which tables they are
 * coded. It is memory of the caller, `_model_size` bytes, aligned for int32_t, zero at first, laid
 * out as clgs_channel in src/attributes/model.h. An encoder fills in its predictions, lets
 * `_count` and `_choose` make the tables, and stores it with `_header_write`; a decoder gets it
 * from `_header_read`. Every function checks a model before it follows it: one that is out of
 * range is refused, regardless of its bytes. */

/* 8,484 bytes per channel, or 0 unless there are 1 to CLGS_MAX_CHANNELS. */
size_t clgs_attributes_model_size(size_t channels);

/* Bytes that `_header_write` never exceeds, about 108 kilobytes per channel; mostly it takes
 * some hundred bytes. 0 unless there are 1 to CLGS_MAX_CHANNELS channels. */
size_t clgs_attributes_header_bound(size_t channels);

/* About 44 kilobytes, for `_header_write` and `_header_read`. */
size_t clgs_attributes_header_workspace(void);

/* Write the model as bytes.
 *
 * model: in range; classes of cells that cannot occur become 0, as a reader will have them.
 * capacity: any; clgs_attributes_header_bound(channels) always suffices.
 * Returns the bytes written, or 0 if the model is out of range or `capacity` is too small. */
size_t clgs_attributes_header_write(void *model, size_t channels, uint8_t *out, size_t capacity,
                                    void *workspace);

/* Read a model of `channels` channels, which the bytes do not tell.
 *
 * Damaged input: an error, and a model that must not be used; or another model, which is in range.
 * Returns CLGS_ERROR_ARGUMENT unless there are 1 to CLGS_MAX_CHANNELS channels. */
clgs_error clgs_attributes_header_read(const uint8_t *data, size_t size, void *model,
                                       size_t channels, void *workspace);

/* Which channels of a model are known: a decoder must have their values before it begins.
 *
 * model: as clgs_attributes_header_read fills it.
 * Returns 0 if no channel is known; 1 if those of an even number are, and no others, as details
 * have it (codec_c/FORMAT.md, 5.4); -1 if others are, which no file has. */
int clgs_attributes_known(const void *model, size_t channels);

/* About 3.5 bytes per row, or 0 if there are more than CLGS_MAX_POINTS. */
size_t clgs_near_workspace(size_t rows);

/* The near rows of each row: the CLGS_NEAR earlier rows at the least distance from it, nearest
 * first, of equal distances the later rows.
 *
 * position: (rows, 3), in any order; in Morton order it takes least time. A row is compared with
 *     those before it in blocks, seldom with many.
 * near: (rows, CLGS_NEAR); -1 where there are fewer earlier rows.
 * Returns CLGS_ERROR_ARGUMENT if there are more than CLGS_MAX_POINTS rows, or positions span 2^21
 * or more on an axis. */
clgs_error clgs_near(const int32_t *position, size_t rows, int32_t *near, void *workspace);

/* 58 bytes and 6 per value, 62 instead of 6 in the channels that the model mixes; or 0 unless there
 * are 1 to CLGS_MAX_CHANNELS channels, and at least 1 and at most 2^28 values.
 * Here alone the model is not checked: `channels` of it must be there. */
size_t clgs_attributes_bound(const void *model, size_t rows, size_t channels);

/* About 14 bytes per value, 27 per row, and 1.6 megabytes; 0 as clgs_attributes_bound. For
 * `_encode`, `_decode`, `_count` and `_measure`. */
size_t clgs_attributes_workspace(size_t rows, size_t channels);

/* One chunk of a matrix of any int32.
 *
 * value: (rows, channels), row-major, at least one row; known channels, too.
 * near: as clgs_near fills it; any earlier rows do. NULL: the rows just before each row.
 * capacity: at least clgs_attributes_bound(model, rows, channels).
 * Returns the bytes written, at least 1; 0 if shape or model are out of range, a near row is not
 * an earlier one, `capacity` is too small, or a table gives no frequency to a symbol that occurs;
 * and 0 if all channels are known. */
size_t clgs_attributes_encode(const void *model, const int32_t *value, const int32_t *near,
                              size_t rows, size_t channels, uint8_t *out, size_t capacity,
                              void *workspace);

/* The rows of a chunk, to (rows, channels) of `value`; shape and near rows are the encoder's.
 *
 * value: if the model has known channels, their values are read from it, and all others must be 0.
 * A chunk of constant channels takes a byte: `size` does not bound `rows`. Damaged input: an error,
 * or other numbers. Returns CLGS_ERROR_ARGUMENT if shape, model or near rows are out of range. */
clgs_error clgs_attributes_decode(const void *model, const uint8_t *data, size_t size,
                                  int32_t *value, const int32_t *near, size_t rows, size_t channels,
                                  void *workspace);

/* Count the symbols of a chunk, by the cell that chooses their table.
 *
 * model: in range; its tables are not used.
 * count: (channels, 64 cells, 256 symbols); the chunk's symbols are added. The caller sets it to
 *     zero before the first chunk, and counts fewer than 2^32 rows.
 * Returns CLGS_ERROR_ARGUMENT if shape, model or near rows are out of range. */
clgs_error clgs_attributes_count(const void *model, const int32_t *value, const int32_t *near,
                                 size_t rows, size_t channels, uint32_t *count, void *workspace);

/* 8 + 62 * rows bytes: what one mixed channel takes at most. For `rows` up to CLGS_MAX_POINTS. */
size_t clgs_attributes_measure_bound(size_t rows);

/* Add to `bytes`, (channels), what a chunk takes in each channel that the model mixes; the others
 * stay as they are.
 *
 * out: scratch memory of clgs_attributes_measure_bound(rows) bytes.
 * Returns CLGS_ERROR_ARGUMENT if shape, model or near rows are out of range. */
clgs_error clgs_attributes_measure(const void *model, const int32_t *value, const int32_t *near,
                                   size_t rows, size_t channels, uint64_t *bytes, uint8_t *out,
                                   void *workspace);

/* About 64 kilobytes, for clgs_attributes_choose. */
size_t clgs_attributes_choose_workspace(void);

/* Make classes and tables of every channel from the counts of its symbols.
 *
 * model: `class_of`, `classes` and `frequency` are written; known channels have none, and cost
 *     nothing. No other field is read.
 * count: as clgs_attributes_count fills it; in every channel at least one symbol was counted.
 * scale: 256 * (rows of all chunks) / (rows counted).
 * cost: (channels), what the channel will take with these tables, in 2^-16 bits.
 * Returns CLGS_ERROR_ARGUMENT unless there are 1 to CLGS_MAX_CHANNELS channels, all with counts. */
clgs_error clgs_attributes_choose(void *model, size_t channels, const uint32_t *count,
                                  uint32_t scale, uint64_t *cost, void *workspace);

/* ---- Words and weights ---- */

/* 1 + 4 * count bytes, or 0 if there are more than CLGS_MAX_POINTS words. */
size_t clgs_planes_bound(size_t count);

/* About one mebibyte. */
size_t clgs_planes_workspace(void);

/* 32-bit words (IEEE floats as bits), coded byte by byte from the top; no words are allowed.
 *
 * capacity: at least clgs_planes_bound(count).
 * Returns the bytes written, or 0 if there are too many words or `capacity` is too small. */
size_t clgs_planes_encode(const uint32_t *word, size_t count, uint8_t *out, size_t capacity,
                          void *workspace);

/* The `count` words of such a stream; a word costs at least 32/22,711 byte.
 *
 * Damaged input: an error, or other words, among them any float. Returns CLGS_ERROR_ARGUMENT if
 * there are more than CLGS_MAX_POINTS words. */
clgs_error clgs_planes_decode(const uint8_t *data, size_t size, uint32_t *word, size_t count,
                              void *workspace);

/* The shape of one matrix of weights: at most CLGS_MAX_ROWS rows, CLGS_MAX_COLUMNS columns. */
typedef struct clgs_layer {
    uint32_t rows, columns;
} clgs_layer;

/* One byte and 4 per weight, or 0 if there are more than CLGS_MAX_LAYERS layers, one of them has
 * too many rows or columns, or all together more than CLGS_MAX_POINTS weights. */
size_t clgs_weights_bound(const clgs_layer *layer, size_t layers);

/* About one mebibyte and 4 bytes per weight, or 0 as clgs_weights_bound. */
size_t clgs_weights_workspace(const clgs_layer *layer, size_t layers);

/* Weights as 32-bit words (IEEE floats as bits), bit for bit.
 *
 * word: of all layers, one after another, each row-major.
 * capacity: at least clgs_weights_bound(layer, layers).
 * If the weights of every layer are multiples of a power of two of its own, below 2^24 of them and
 * none -0, they are coded as integers if that is shorter; all others as clgs_planes_encode does.
 * Returns the bytes written, or 0 if the layers are out of range or `capacity` is too small. */
size_t clgs_weights_encode(const uint32_t *word, const clgs_layer *layer, size_t layers,
                           uint8_t *out, size_t capacity, void *workspace);

/* The weights of a stream of clgs_weights_encode or clgs_planes_encode; the layers are the
 * encoder's.
 *
 * A layer of zeros costs one byte: `size` does not bound the number of weights. Damaged input: an
 * error, or other words, among them any float. Returns CLGS_ERROR_ARGUMENT if the layers are out of
 * range. */
clgs_error clgs_weights_decode(const uint8_t *data, size_t size, uint32_t *word,
                               const clgs_layer *layer, size_t layers, void *workspace);

#endif
