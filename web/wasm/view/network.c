#include "network.h"

#define INPUTS (FEATURES + 3)

/* Set the hidden layer of one head; returns the weights after it. */
static const float *take_hidden(const float *weight, size_t head, network *n)
{
    const float *bias = weight + HIDDEN * INPUTS;
    for (size_t unit = 0; unit < HIDDEN; unit++) {
        const float *row = weight + INPUTS * unit;
        size_t at = ROOM * head + unit;
        for (size_t k = 0; k < FEATURES; k++)
            n->feature[k][at] = row[k];
        for (size_t axis = 0; axis < 3; axis++)
            n->direction[axis][at] = row[FEATURES + axis];
        n->bias[at] = bias[unit];
    }
    return bias + HIDDEN;
}

void network_make(const float *weight, network *n)
{
    memset(n, 0, sizeof *n);
    weight = take_hidden(weight, 0, n);
    for (size_t j = 0; j < OFFSETS; j++)
        for (size_t k = 0; k < HIDDEN; k++)
            n->opacity[k][j] = weight[HIDDEN * j + k];
    memcpy(n->opacity_bias, weight + HIDDEN * OFFSETS, 4 * OFFSETS);
    weight = take_hidden(weight + (HIDDEN + 1) * OFFSETS, 1, n);
    for (size_t j = 0; j < 3 * OFFSETS; j++) {
        for (size_t k = 0; k < HIDDEN; k++)
            n->color[j / 3][k][j % 3] = weight[HIDDEN * j + k];
        n->color_bias[j / 3][j % 3] = weight[3 * HIDDEN * OFFSETS + j];
    }
    weight = take_hidden(weight + 3 * (HIDDEN + 1) * OFFSETS, 2, n);
    for (size_t j = 0; j < 7 * OFFSETS; j++) {
        for (size_t k = 0; k < HIDDEN; k++)
            n->shape[j / 7][k][j % 7] = weight[HIDDEN * j + k];
        n->shape_bias[j / 7][j % 7] = weight[7 * HIDDEN * OFFSETS + j];
    }
}

void network_base(const network *n, const float *feature, float *base)
{
    memcpy(base, n->bias, sizeof n->bias);
    for (size_t k = 0; k < FEATURES; k++)
        for (size_t i = 0; i < BASE && feature[k] != 0; i += 4)
            store4(base + i, load4(base + i) + all4(feature[k]) * load4(n->feature[k] + i));
}

void network_hidden(const network *n, const float *base, const float direction[3], float *hidden)
{
    const v4 x = all4(direction[0]), y = all4(direction[1]), z = all4(direction[2]);
    for (size_t i = 0; i < BASE; i += 4) {
        v4 sum = load4(base + i) + x * load4(n->direction[0] + i) + y * load4(n->direction[1] + i) +
                 z * load4(n->direction[2] + i);
        store4(hidden + i, max4(sum, all4(0.0f)));
    }
}

void network_opacity(const network *n, const float *hidden, float *opacity)
{
    v4 sum[3];
    for (int i = 0; i < 3; i++)
        sum[i] = load4(n->opacity_bias + 4 * i);
    for (size_t k = 0; k < HIDDEN; k++)
        for (int i = 0; i < 3; i++)
            sum[i] += all4(hidden[k]) * load4(n->opacity[k] + 4 * i);
    for (int i = 0; i < 3; i++)
        store4(opacity + 4 * i, sum[i]);
}

void network_offset(const network *n, const float *hidden, size_t offset, float color[4],
                    float shape[SHAPE])
{
    const float *of_color = hidden + ROOM, *of_shape = hidden + 2 * ROOM;
    v4 rgb = load4(n->color_bias[offset]);
    v4 first = load4(n->shape_bias[offset]), second = load4(n->shape_bias[offset] + 4);
    for (size_t k = 0; k < HIDDEN; k++) {
        rgb += all4(of_color[k]) * load4(n->color[offset][k]);
        first += all4(of_shape[k]) * load4(n->shape[offset][k]);
        second += all4(of_shape[k]) * load4(n->shape[offset][k] + 4);
    }
    store4(color, sigmoid4(rgb));
    float quaternion = first[3]; /* the vector's last lane is no scale */
    first = sigmoid4(first);
    first[3] = quaternion;
    store4(shape, first);
    store4(shape + 4, second);
}
