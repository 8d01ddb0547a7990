/* The packed camera of clgs/scene/camera.py: world to camera, OpenCV convention. */
#ifndef CLGS_CAMERA_H
#define CLGS_CAMERA_H

/* Offsets into the packed floats. */
#define CAMERA_ROTATION 0    /* 9, row-major */
#define CAMERA_TRANSLATION 9 /* 3 */
#define CAMERA_FX 12
#define CAMERA_FY 13
#define CAMERA_CX 14
#define CAMERA_CY 15
#define CAMERA_WIDTH 16
#define CAMERA_HEIGHT 17
#define CAMERA_NEAR 18
#define CAMERA_SLOPE_LIMITS 19 /* x_min, x_max, y_min, y_max */
#define CAMERA_CENTRE 23       /* 3 */

#endif
