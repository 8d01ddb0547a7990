/* Real spherical harmonics up to degree 3, with the signs of 3DGS's files. */
#ifndef CLGS_WEB_HARMONICS_H
#define CLGS_WEB_HARMONICS_H

/* The 16 values along a unit direction; the constants are the functions' norms. */
static inline void harmonics(const float direction[3], float basis[16])
{
    const float x = direction[0], y = direction[1], z = direction[2];
    const float xx = x * x, yy = y * y, zz = z * z;
    basis[0] = 0.282094792f;
    basis[1] = -0.488602512f * y;
    basis[2] = 0.488602512f * z;
    basis[3] = -0.488602512f * x;
    basis[4] = 1.09254843f * x * y;
    basis[5] = -1.09254843f * y * z;
    basis[6] = 0.315391565f * (2 * zz - xx - yy);
    basis[7] = -1.09254843f * x * z;
    basis[8] = 0.546274215f * (xx - yy);
    basis[9] = -0.590043590f * y * (3 * xx - yy);
    basis[10] = 2.89061144f * x * y * z;
    basis[11] = -0.457045799f * y * (4 * zz - xx - yy);
    basis[12] = 0.373176333f * z * (2 * zz - 3 * xx - 3 * yy);
    basis[13] = -0.457045799f * x * (4 * zz - xx - yy);
    basis[14] = 1.44530572f * z * (xx - yy);
    basis[15] = -0.590043590f * x * (xx - 3 * yy);
}

#endif
