/* Four floats at a time. */
#ifndef CLGS_WEB_VECTORS_H
#define CLGS_WEB_VECTORS_H

#include <stdint.h>
#include <string.h>

typedef float v4 __attribute__((vector_size(16)));
typedef int32_t i4 __attribute__((vector_size(16)));

static inline v4 all4(float x)
{
    return (v4){x, x, x, x};
}

static inline v4 load4(const float *at)
{
    v4 value;
    memcpy(&value, at, sizeof value);
    return value;
}

static inline void store4(float *at, v4 value)
{
    memcpy(at, &value, sizeof value);
}

/* `yes` where a lane of the mask is set, else `no`. */
static inline v4 select4(i4 mask, v4 yes, v4 no)
{
    return (v4)((mask & (i4)yes) | (~mask & (i4)no));
}

static inline v4 max4(v4 a, v4 b)
{
    return select4(a > b, a, b);
}

static inline v4 min4(v4 a, v4 b)
{
    return select4(a < b, a, b);
}

/* e^x: 2^n times a Taylor series on |r| <= ln(2) / 2, within 2e-7 of the value. */
static inline v4 exp4(v4 x)
{
    const v4 bias = all4(12582912.0f); /* 1.5 2^23: what is added to it is rounded to an integer */
    x = min4(max4(x, all4(-87.0f)), all4(88.0f));
    v4 shifted = x * all4(1.44269504f) + bias, n = shifted - bias;
    v4 r = x - n * all4(0.693145752f) - n * all4(1.42860677e-6f); /* ln(2) in two parts */
    v4 sum = all4(1.0f / 5040);
    sum = sum * r + all4(1.0f / 720);
    sum = sum * r + all4(1.0f / 120);
    sum = sum * r + all4(1.0f / 24);
    sum = sum * r + all4(1.0f / 6);
    sum = sum * r + all4(0.5f);
    sum = sum * r + all4(1.0f);
    sum = sum * r + all4(1.0f);
    i4 power = ((i4)shifted - (i4)bias + 127) << 23;
    return sum * (v4)power;
}

static inline v4 sigmoid4(v4 x)
{
    return all4(1.0f) / (all4(1.0f) + exp4(-x));
}

static inline v4 tanh4(v4 x)
{
    return all4(1.0f) - all4(2.0f) / (all4(1.0f) + exp4(x + x));
}

#endif
