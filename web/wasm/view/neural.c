#include "neural.h"

#include "memory.h"

problem neural_open(const anchors *from, neural *result)
{
    result->from = from;
    result->net = memory_take(sizeof *result->net);
    result->base = memory_take(4 * BASE * from->list.anchors + 4);
    result->size = memory_take(4 * SCALINGS * from->list.anchors + 4);
    return result->net && result->base && result->size ? NULL : NO_MEMORY;
}

void neural_weights(neural *n)
{
    network_make(n->from->weight, n->net);
}

void neural_prepare(neural *n, size_t first, size_t count)
{
    const v4 limit = all4(LOG_SCALE_LIMIT);
    for (size_t a = first; a < first + count; a++) {
        float log_scale[8] = {0};
        network_base(n->net, n->from->array[2].value + FEATURES * a, n->base + BASE * a);
        memcpy(log_scale, n->from->array[3].value + SCALINGS * a, 4 * SCALINGS);
        for (int i = 0; i < 8; i += 4)
            store4(log_scale + i, exp4(min4(max4(load4(log_scale + i), -limit), limit)));
        memcpy(n->size + SCALINGS * a, log_scale, 4 * SCALINGS);
    }
}

static void add_offset(const neural *n, size_t anchor, size_t j, const float *hidden, float opacity,
                       gaussians *to)
{
    const float *position = n->from->array[0].value + 3 * anchor;
    const float *offset = n->from->array[1].value + 3 * (OFFSETS * anchor + j);
    const float *size = n->size + SCALINGS * anchor;
    float color[4], shape[SHAPE];
    gaussian one = {.opacity = opacity};
    network_offset(n->net, hidden, j, color, shape);
    for (int i = 0; i < 3; i++) {
        one.mean[i] = position[i] + offset[i] * size[i];
        one.scale[i] = size[3 + i] * shape[i];
        one.color[i] = color[i];
    }
    memcpy(one.rotation, shape + 3, sizeof one.rotation);
    gaussians_add(to, &one);
}

void neural_add(const neural *n, size_t first, size_t count, const float centre[3], float alpha_cut,
                gaussians *to)
{
    for (size_t a = first; a < first + count; a++) {
        float direction[3], hidden[BASE], opacity[OPACITIES];
        direction_to(centre, n->from->array[0].value + 3 * a, direction);
        network_hidden(n->net, n->base + BASE * a, direction, hidden);
        network_opacity(n->net, hidden, opacity);
        for (int i = 0; i < OPACITIES; i += 4)
            store4(opacity + i, tanh4(load4(opacity + i)));
        for (size_t j = 0; j < OFFSETS; j++)
            if (opacity[j] >= alpha_cut)
                add_offset(n, a, j, hidden, opacity[j], to);
    }
}
