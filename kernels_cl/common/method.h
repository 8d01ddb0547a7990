/* Constants of the method that several rooms use. clgs/constants.py has their meaning and passes
 * them as build options; these defaults let a program build alone. */
#ifndef CLGS_METHOD_H
#define CLGS_METHOD_H

#ifndef K_OFFSETS
#define K_OFFSETS 10
#endif
#ifndef FEATURE_DIM
#define FEATURE_DIM 50
#endif
#define OUTPUT_ROWS (11 * K_OFFSETS) /* outputs of the MLPs */
#ifndef LOG_SCALE_LIMIT
#define LOG_SCALE_LIMIT 20.0f
#endif
#ifndef BLUR
#define BLUR 0.3f
#endif
#ifndef PIXEL_VARIANCE
#define PIXEL_VARIANCE 0.0833333333f
#endif

#endif
