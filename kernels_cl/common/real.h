/* Arithmetic shared by all kernels: the lane vector and elementary functions built from
 * explicitly rounded operations only, so that devices agree. Names end in _v for lane vectors
 * (fv, iv: VEC lanes) and in _s for scalars. */
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

/* e^x, relative error 1e-7; x is clamped to [-87, 88]. A NaN stays one, as above. */
#define DEFINE_EXP(name, F, I, AS_F, AS_I)                                                         \
    inline F name(F x)                                                                             \
    {                                                                                              \
        F bounded = x < (F)(-87.0f) ? (F)(-87.0f) : x;                                             \
        bounded = bounded > (F)(88.0f) ? (F)(88.0f) : bounded;                                     \
        const F shifted = fma(bounded, (F)(LOG2_E), (F)(ROUND_MAGIC));                             \
        const F n = shifted - (F)(ROUND_MAGIC);                                                    \
        const F r = fma(n, (F)(-LN2_LOW), fma(n, (F)(-LN2_HIGH), bounded));                        \
        F p = fma(r, (F)(1.38358132e-03f), (F)(8.37563537e-03f));                                  \
        p = fma(p, r, (F)(4.16682884e-02f));                                                       \
        p = fma(p, r, (F)(1.66664109e-01f));                                                       \
        p = fma(p, r, (F)(4.99999911e-01f));                                                       \
        p = fma(p * r, r, r) + 1.0f;                                                               \
        return x == x ? AS_F(AS_I(p) + (AS_I(shifted) << 23)) : x;                                 \
    }

/* Natural logarithm of a positive normal number, absolute error 1e-7 * max(1, |log x|). A NaN stays
 * one; for other x, infinity included, callers guard. */
#define DEFINE_LOG(name, F, I, AS_F, AS_I, TO_F)                                                   \
    inline F name(F x)                                                                             \
    {                                                                                              \
        /* split into mantissa in [sqrt(1/2), sqrt(2)) and exponent */                             \
        const I bits = AS_I(x) - (I)(0x3f3504f3);                                                  \
        const F exponent = TO_F(bits >> 23);                                                       \
        const F m = AS_F((bits & (I)(0x007fffff)) + (I)(0x3f3504f3));                              \
        const F s = (m - 1.0f) / (m + 1.0f);                                                       \
        const F z = s * s;                                                                         \
        F p = fma(z, (F)(0.117949948f), (F)(0.142684594f));                                        \
        p = fma(p, z, (F)(0.200001702f));                                                          \
        p = fma(p, z, (F)(0.333333313f));                                                          \
        const F tail = fma(exponent, (F)(LN2_LOW), 2.0f * s * z * p);                              \
        return x == x ? fma(exponent, (F)(LN2_HIGH), 2.0f * s + tail) : x;                         \
    }

#define DEFINE_TANH(name, exp_name, F, I)                                                          \
    inline F name(F x)                                                                             \
    {                                                                                              \
        const F z = x * x;                                                                         \
        F p = fma(z, (F)(-5.66078862e-03f), (F)(2.06020065e-02f));                                 \
        p = fma(p, z, (F)(-5.37292287e-02f));                                                      \
        p = fma(p, z, (F)(1.33313283e-01f));                                                       \
        p = fma(p, z, (F)(-3.33332777e-01f));                                                      \
        const F near_zero = fma(p * z, x, x);                                                      \
        const F far = 1.0f - 2.0f / (exp_name(2.0f * fabs(x)) + 1.0f);                             \
        return fabs(x) < (F)(0.625f) ? near_zero : copysign(far, x);                               \
    }

#define DEFINE_SIGMOID(name, exp_name, F, I)                                                       \
    inline F name(F x)                                                                             \
    {                                                                                              \
        return 1.0f / (1.0f + exp_name(-x));                                                       \
    }

DEFINE_EXP(exp_v, fv, iv, AS_FV, AS_IV)
DEFINE_TANH(tanh_v, exp_v, fv, iv)
DEFINE_SIGMOID(sigmoid_v, exp_v, fv, iv)
DEFINE_LOG(log_v, fv, iv, AS_FV, AS_IV, TO_FV)
DEFINE_EXP(exp_s, float, int, as_float, as_int)
DEFINE_LOG(log_s, float, int, as_float, as_int, convert_float)
DEFINE_TANH(tanh_s, exp_s, float, int)
DEFINE_SIGMOID(sigmoid_s, exp_s, float, int)

#endif
