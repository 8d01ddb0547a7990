/* Real spherical harmonics up to degree 4, in the order and with the signs of 3DGS. */
#ifndef CLGS_HARMONICS_H
#define CLGS_HARMONICS_H

#include "common/own_function.h"
#include "common/real.h"

/* Coefficients of a color channel: 1, 4, 9, 16 or 25 for degree 0 to 4. */
#ifndef COEFFICIENTS
#define COEFFICIENTS 16
#endif
#define MAX_COEFFICIENTS (COEFFICIENTS > 16 ? 25 : 16)

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
#define SH_4_XXXX 0.625835735f
#define SH_4_XXXZ 1.77013077f
#define SH_4_XXZZ 3.31161144f
#define SH_4_XX 0.473087348f
#define SH_4_XZZZ 4.6833258f
#define SH_4_XZ 2.00713963f
#define SH_4_ZZZZ 3.70249414f
#define SH_4_ZZ 3.17356641f
#define SH_4 0.317356641f

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
#if COEFFICIENTS > 16
    const fv cos2 = xx - yy, sin2 = 2.0f * x * y;
    const fv cos3 = x * (xx - 3.0f * yy), sin3 = y * (3.0f * xx - yy);
    const fv two = SH_4_XXZZ * zz - SH_4_XX, one = z * (SH_4_XZ - SH_4_XZZZ * zz);
    basis[16] = SH_4_XXXX * (x * sin3 + y * cos3);
    basis[17] = -SH_4_XXXZ * z * sin3;
    basis[18] = two * sin2;
    basis[19] = one * y;
    basis[20] = (SH_4_ZZZZ * zz - SH_4_ZZ) * zz + SH_4;
    basis[21] = one * x;
    basis[22] = two * cos2;
    basis[23] = -SH_4_XXXZ * z * cos3;
    basis[24] = SH_4_XXXX * (x * cos3 - y * sin3);
#endif
}

/* d = sum over the functions of weight times their derivative by x, y and z, as polynomials. */
static inline OWN_FUNCTION void harmonics_slopes(const fv direction[3],
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
#if COEFFICIENTS > 16
    const fv cos2 = xx - yy, sin2 = 2.0f * xy;
    const fv cos3 = x * (xx - 3.0f * yy), sin3 = y * (3.0f * xx - yy);
    const fv two = 2.0f * (SH_4_XXZZ * zz - SH_4_XX), one = z * (SH_4_XZ - SH_4_XZZZ * zz);
    d[0] += 4.0f * SH_4_XXXX * (sin3 * weight[16] + cos3 * weight[24]);
    d[1] += 4.0f * SH_4_XXXX * (cos3 * weight[16] - sin3 * weight[24]);
    d[0] -= 3.0f * SH_4_XXXZ * z * (sin2 * weight[17] + cos2 * weight[23]);
    d[1] -= 3.0f * SH_4_XXXZ * z * (cos2 * weight[17] - sin2 * weight[23]);
    d[2] -= SH_4_XXXZ * (sin3 * weight[17] + cos3 * weight[23]);
    d[0] += two * (y * weight[18] + x * weight[22]);
    d[1] += two * (x * weight[18] - y * weight[22]);
    d[2] += 2.0f * SH_4_XXZZ * z * (sin2 * weight[18] + cos2 * weight[22]);
    d[0] += one * weight[21];
    d[1] += one * weight[19];
    d[2] += (SH_4_XZ - 3.0f * SH_4_XZZZ * zz) * (y * weight[19] + x * weight[21]);
    d[2] += (4.0f * SH_4_ZZZZ * zz - 2.0f * SH_4_ZZ) * z * weight[20];
#endif
}

#endif
