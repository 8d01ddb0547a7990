/* A record: a projected Gaussian ready to blend, RECORD_SIZE floats. There is one per Gaussian
 * first, then one per entry of the tile lists, in list order, so that the blending reads them as a
 * stream. Floats 0 to 5 are x, y, r1, l, r2 and bias of its ellipse. */
#ifndef CLGS_RECORD_H
#define CLGS_RECORD_H

#ifndef RECORD_SIZE
#define RECORD_SIZE 16
#endif
#define RECORD_COLOR 6   /* red, green, blue */
#define RECORD_ELLIPSE 9 /* of a Gaussian: slope, squared and shrink, see common/ellipses.h */
#define RECORD_UNITS 9   /* of an entry, uint: units of the tile that it may touch */
#define RECORD_ROW 11    /* of an entry, int: the row that its moments go to */
#define RECORD_USED 12

#define COLOR_LIMIT 1e3f /* colours are clamped to +-COLOR_LIMIT */

/* What the blending reads of a record, which lies in any address space. */
typedef struct {
    float x, y;      /* centre, pixels */
    float r1, l, r2; /* whitening factor, r1 and r2 times WHITENING_UNIT */
    float bias;      /* log2(opacity) */
    float red, green, blue;
} Record;

#define READ_RECORD(record, from)                                                                  \
    do {                                                                                           \
        (record).x = (from)[0];                                                                    \
        (record).y = (from)[1];                                                                    \
        (record).r1 = (from)[2];                                                                   \
        (record).l = (from)[3];                                                                    \
        (record).r2 = (from)[4];                                                                   \
        (record).bias = (from)[5];                                                                 \
        (record).red = (from)[RECORD_COLOR];                                                       \
        (record).green = (from)[RECORD_COLOR + 1];                                                 \
        (record).blue = (from)[RECORD_COLOR + 2];                                                  \
    } while (0)

#endif
