/* Real spherical harmonics up to degree 3, in the order and with the signs of 3DGS. */
#ifndef CLGS_HARMONICS_H
#define CLGS_HARMONICS_H

#include "common/own_function.h"
#include "common/real.h"

/* Coefficients of a color channel: 1, 4, 9 or 16 for degree 0 to 3. */
#ifndef COEFFICIENTS
#define COEFFICIENTS 16
#endif
#define MAX_COEFFICIENTS 16

#define SH_0 0.282094792f
#define SH_1 0.488602512f
#define SH_2_XY 1.09254843f
#define SH_2_ZZ 0.315391565f
#define SH_2_XX 0.546274215f
#define SH_3_XXY 0.590043590f
#define SH_3_XYZ 2.89061144f
#define SH_3_XZZ 0.457045799f
#define SH_3_ZZZ 0.373176333f
#define SH_3_XXZ 1.44530572f

/* The functions in VEC unit directions. */
static inline OWN_FUNCTION void harmonics(const fv direction[3], fv basis[MAX_COEFFICIENTS])
{
    const fv x = direction[0], y = direction[1], z = direction[2];
    const fv xx = x * x, yy = y * y, zz = z * z;
    basis[0] = (fv)(SH_0);
    basis[1] = -SH_1 * y;
    basis[2] = SH_1 * z;
    basis[3] = -SH_1 * x;
    basis[4] = SH_2_XY * x * y;
    basis[5] = -SH_2_XY * y * z;
    basis[6] = SH_2_ZZ * (2.0f * zz - xx - yy);
    basis[7] = -SH_2_XY * x * z;
    basis[8] = SH_2_XX * (xx - yy);
    basis[9] = -SH_3_XXY * y * (3.0f * xx - yy);
    basis[10] = SH_3_XYZ * x * y * z;
    basis[11] = -SH_3_XZZ * y * (4.0f * zz - xx - yy);
    basis[12] = SH_3_ZZZ * z * (2.0f * zz - 3.0f * xx - 3.0f * yy);
    basis[13] = -SH_3_XZZ * x * (4.0f * zz - xx - yy);
    basis[14] = SH_3_XXZ * z * (xx - yy);
    basis[15] = -SH_3_XXY * x * (xx - 3.0f * yy);
}

/* d = sum over the functions of weight times their derivative by x, y and z, as polynomials. */
static inline OWN_FUNCTION void harmonics_backward(const fv direction[3],
                                                   const fv weight[MAX_COEFFICIENTS], fv d[3])
{
    const fv x = direction[0], y = direction[1], z = direction[2];
    const fv xx = x * x, yy = y * y, zz = z * z, xy = x * y, xz = x * z, yz = y * z;
    d[0] = -SH_1 * weight[3];
    d[1] = -SH_1 * weight[1];
    d[2] = SH_1 * weight[2];

    d[0] += SH_2_XY * (y * weight[4] - z * weight[7]);
    d[1] += SH_2_XY * (x * weight[4] - z * weight[5]);
    d[2] -= SH_2_XY * (y * weight[5] + x * weight[7]);
    d[0] += 2.0f * x * (SH_2_XX * weight[8] - SH_2_ZZ * weight[6]);
    d[1] -= 2.0f * y * (SH_2_XX * weight[8] + SH_2_ZZ * weight[6]);
    d[2] += 4.0f * SH_2_ZZ * z * weight[6];

    d[0] -= SH_3_XXY * (6.0f * xy * weight[9] + 3.0f * (xx - yy) * weight[15]);
    d[1] -= SH_3_XXY * (3.0f * (xx - yy) * weight[9] - 6.0f * xy * weight[15]);
    d[0] += SH_3_XYZ * yz * weight[10];
    d[1] += SH_3_XYZ * xz * weight[10];
    d[2] += SH_3_XYZ * xy * weight[10];
    d[0] -= SH_3_XZZ * ((4.0f * zz - 3.0f * xx - yy) * weight[13] - 2.0f * xy * weight[11]);
    d[1] -= SH_3_XZZ * ((4.0f * zz - xx - 3.0f * yy) * weight[11] - 2.0f * xy * weight[13]);
    d[2] -= SH_3_XZZ * 8.0f * (yz * weight[11] + xz * weight[13]);
    d[0] -= SH_3_ZZZ * 6.0f * xz * weight[12];
    d[1] -= SH_3_ZZZ * 6.0f * yz * weight[12];
    d[2] += SH_3_ZZZ * 3.0f * (2.0f * zz - xx - yy) * weight[12];
    d[0] += SH_3_XXZ * 2.0f * xz * weight[14];
    d[1] -= SH_3_XXZ * 2.0f * yz * weight[14];
    d[2] += SH_3_XXZ * (xx - yy) * weight[14];
}

#endif
