#include "gaussians.h"

#include <string.h>

#include "memory.h"

#define LEAST_QUATERNION 1e-35f
#define GREATEST_QUATERNION 1e37f
#define DIGIT 16 /* bits that one pass of the sort takes */

problem gaussians_open(size_t capacity, gaussians *result)
{
    *result = (gaussians){.capacity = capacity};
    result->record = memory_take(4 * RECORD * capacity + 4);
    result->mean = memory_take(12 * capacity + 4);
    uint32_t **own[] = {&result->order, &result->spare, &result->key, &result->spare_key};
    for (int i = 0; i < 4; i++)
        *own[i] = memory_take(4 * capacity + 4);
    return result->record && result->mean && result->spare_key ? NULL : NO_MEMORY;
}

static float magnitude(float x)
{
    return x < 0 ? -x : x;
}

void direction_to(const float from[3], const float to[3], float direction[3])
{
    float largest = 0, square = 0;
    for (int i = 0; i < 3; i++) {
        direction[i] = to[i] - from[i];
        largest = magnitude(direction[i]) > largest ? magnitude(direction[i]) : largest;
    }
    if (largest == 0)
        return;
    for (int i = 0; i < 3; i++) {
        direction[i] /= largest; /* no square overflows */
        square += direction[i] * direction[i];
    }
    for (int i = 0; i < 3; i++)
        direction[i] /= __builtin_sqrtf(square);
}

/* The bits of a half float: rounded to nearest, without subnormal numbers, at most 65504. */
static uint32_t half_bits(float value)
{
    uint32_t bits, sign;
    value = value > 65504.0f ? 65504.0f : value < -65504.0f ? -65504.0f : value;
    memcpy(&bits, &value, sizeof bits);
    sign = bits >> 16 & 0x8000u;
    bits &= 0x7FFFFFFFu;
    if (!(bits >= 0x38800000u && bits < 0x7F800000u)) /* too small, or not a number */
        return sign;
    return sign | (bits - 0x38000000u + 0xFFFu + (bits >> 13 & 1)) >> 13;
}

/* The quaternion's rotation matrix; 0 if it has no direction. */
static int rotation_matrix(const float quaternion[4], float matrix[3][3])
{
    float q[4], largest = 0, square = 0;
    for (int i = 0; i < 4; i++)
        largest = magnitude(quaternion[i]) > largest ? magnitude(quaternion[i]) : largest;
    if (!(largest > LEAST_QUATERNION && largest < GREATEST_QUATERNION))
        return 0;
    for (int i = 0; i < 4; i++) {
        q[i] = quaternion[i] / largest;
        square += q[i] * q[i];
    }
    const float twice = 2 / square, w = q[0], x = q[1], y = q[2], z = q[3];
    const float rows[3][3] = {
        {1 - twice * (y * y + z * z), twice * (x * y - w * z), twice * (x * z + w * y)},
        {twice * (x * y + w * z), 1 - twice * (x * x + z * z), twice * (y * z - w * x)},
        {twice * (x * z - w * y), twice * (y * z + w * x), 1 - twice * (x * x + y * y)},
    };
    memcpy(matrix, rows, sizeof rows);
    return 1;
}

void gaussians_add(gaussians *all, const gaussian *one)
{
    float axes[3][3], words[10];
    if (all->count >= all->capacity || !rotation_matrix(one->rotation, axes))
        return;
    memcpy(words, one->mean, sizeof one->mean);
    words[3] = one->opacity;
    for (int row = 0, at = 4; row < 3; row++)
        for (int column = row; column < 3; column++, at++) {
            words[at] = 0;
            for (int k = 0; k < 3; k++)
                words[at] += axes[row][k] * axes[column][k] * one->scale[k] * one->scale[k];
        }
    uint32_t *record = all->record + RECORD * all->count++;
    memcpy(record, words, sizeof words);
    record[10] = half_bits(one->color[0]) | half_bits(one->color[1]) << 16;
    memcpy(record + 11, one->color + 2, 4);
}

void gaussians_finish(gaussians *all)
{
    for (size_t i = 0; i < all->count; i++)
        memcpy(all->mean + 3 * i, all->record + RECORD * i, 12);
    all->sorted = all->count;
}

/* Sort `count` keys, and the numbers that go with them, by one digit. */
static void sort_digit(const uint32_t *key, const uint32_t *number, uint32_t *to_key, uint32_t *to,
                       size_t count, int shift)
{
    static uint32_t start[1 << DIGIT];
    memset(start, 0, sizeof start);
    for (size_t i = 0; i < count; i++)
        start[key[i] >> shift & 0xFFFF]++;
    for (uint32_t digit = 0, sum = 0; digit < 1 << DIGIT; digit++) {
        uint32_t here = start[digit];
        start[digit] = sum;
        sum += here;
    }
    for (size_t i = 0; i < count; i++) {
        uint32_t at = start[key[i] >> shift & 0xFFFF]++;
        to_key[at] = key[i];
        to[at] = number[i];
    }
}

size_t gaussians_sort(gaussians *all, const float row[4], float near)
{
    size_t count = 0;
    for (size_t i = 0; i < all->sorted; i++) {
        const float *mean = all->mean + 3 * i;
        float depth = row[0] * mean[0] + row[1] * mean[1] + row[2] * mean[2] + row[3];
        if (!(depth > near))
            continue;
        memcpy(all->key + count, &depth, 4);
        all->key[count] = ~all->key[count]; /* positive floats are ordered as their bits */
        all->order[count++] = (uint32_t)i;
    }
    sort_digit(all->key, all->order, all->spare_key, all->spare, count, 0);
    sort_digit(all->spare_key, all->spare, all->key, all->order, count, DIGIT);
    return count;
}
