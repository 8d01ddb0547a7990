/* Arithmetic shared by all kernels: the lane vectors fv and iv (VEC lanes of float and int), and
 * elementary functions of them built from explicitly rounded operations only, so that devices
 * agree. */
#ifndef CLGS_REAL_H
#define CLGS_REAL_H

#pragma OPENCL FP_CONTRACT OFF

#ifndef VEC
#define VEC 16
#endif

#define CLGS_CAT_(a, b) a##b
#define CLGS_CAT(a, b) CLGS_CAT_(a, b)

#if VEC == 1
typedef float fv;
typedef int iv;
#define AS_FV as_float
#define AS_IV as_int
#define TO_FV convert_float
#define TO_IV convert_int
#define LOAD_V(offset, pointer) ((pointer)[offset])
#define STORE_V(value, offset, pointer) ((pointer)[offset] = (value))
#else
typedef CLGS_CAT(float, VEC) fv;
typedef CLGS_CAT(int, VEC) iv;
#define AS_FV CLGS_CAT(as_float, VEC)
#define AS_IV CLGS_CAT(as_int, VEC)
#define TO_FV CLGS_CAT(convert_float, VEC)
#define TO_IV CLGS_CAT(convert_int, VEC)
/* offset counts vectors, not floats */
#define LOAD_V(offset, pointer) CLGS_CAT(vload, VEC)((offset), (pointer))
#define STORE_V(value, offset, pointer) CLGS_CAT(vstore, VEC)((value), (offset), (pointer))
#endif

/* Adding 1.5 * 2^23 rounds to the nearest integer (half to even) and leaves it in the low bits. */
#define ROUND_MAGIC 12582912.0f
#define LOG2_E 1.44269504f
#define LN2_HIGH 0.693145752f
#define LN2_LOW 1.42860677e-06f

/* e^x, relative error 1e-7; x is clamped to [-87, 88]. A NaN stays NaN. */
static inline fv exp_v(fv x)
{
    fv bounded = x < (fv)(-87.0f) ? (fv)(-87.0f) : x;
    bounded = bounded > (fv)(88.0f) ? (fv)(88.0f) : bounded;
    const fv shifted = fma(bounded, (fv)(LOG2_E), (fv)(ROUND_MAGIC));
    const fv n = shifted - (fv)(ROUND_MAGIC);
    const fv r = fma(n, (fv)(-LN2_LOW), fma(n, (fv)(-LN2_HIGH), bounded));
    fv p = fma(r, (fv)(1.38358132e-03f), (fv)(8.37563537e-03f));
    p = fma(p, r, (fv)(4.16682884e-02f));
    p = fma(p, r, (fv)(1.66664109e-01f));
    p = fma(p, r, (fv)(4.99999911e-01f));
    p = fma(p * r, r, r) + 1.0f;
    return x == x ? AS_FV(AS_IV(p) + (AS_IV(shifted) << 23)) : x;
}

/* Natural logarithm of a positive normal number, absolute error 1e-7 * max(1, |log x|). A NaN stays
 * NaN; callers guard against any other x, infinity included. */
static inline fv log_v(fv x)
{
    /* split into mantissa in [sqrt(1/2), sqrt(2)) and exponent */
    const iv bits = AS_IV(x) - (iv)(0x3f3504f3);
    const fv exponent = TO_FV(bits >> 23);
    const fv m = AS_FV((bits & (iv)(0x007fffff)) + (iv)(0x3f3504f3));
    const fv s = (m - 1.0f) / (m + 1.0f);
    const fv z = s * s;
    fv p = fma(z, (fv)(0.117949948f), (fv)(0.142684594f));
    p = fma(p, z, (fv)(0.200001702f));
    p = fma(p, z, (fv)(0.333333313f));
    const fv tail = fma(exponent, (fv)(LN2_LOW), 2.0f * s * z * p);
    return x == x ? fma(exponent, (fv)(LN2_HIGH), 2.0f * s + tail) : x;
}

static inline fv tanh_v(fv x)
{
    const fv z = x * x;
    fv p = fma(z, (fv)(-5.66078862e-03f), (fv)(2.06020065e-02f));
    p = fma(p, z, (fv)(-5.37292287e-02f));
    p = fma(p, z, (fv)(1.33313283e-01f));
    p = fma(p, z, (fv)(-3.33332777e-01f));
    const fv near_zero = fma(p * z, x, x);
    const fv far = 1.0f - 2.0f / (exp_v(2.0f * fabs(x)) + 1.0f);
    return fabs(x) < (fv)(0.625f) ? near_zero : copysign(far, x);
}

static inline fv sigmoid_v(fv x)
{
    return 1.0f / (1.0f + exp_v(-x));
}

#endif
