#include "octree/model.h"

/* What a child gains by a point whose cell lies the square root of the index away, in cells:
 * 12 exp(-index / 2.88). */
static const uint8_t GAIN[15] = {12, 8, 6, 4, 3, 2, 1, 1, 1, 1, 0, 0, 0, 0, 0};

/* Smallest numbers of bits seen of the classes of trust. */
static const uint8_t TRUST[CLGS_TRUST] = {0, 1, 3, 8, 20, 60};

/* First probabilities, in 1/256, fitted to clouds of several kinds: has a node one child only, by
 * the logarithm of its density; is a child there, by half the logarithm of its own density (the
 * last row stands for more) and the number of children before it. */
static const uint8_t ONLY[CLGS_LOG_STEPS] = {
    119, 248, 248, 248, 248, 247, 247, 247, 247, 244, 244, 242, 241, 241, 240,
    239, 239, 238, 237, 237, 234, 227, 221, 214, 205, 194, 184, 173, 159, 135,
    107, 84,  65,  51,  41,  30,  19,  11,  6,   5,   5,   5,   5,   5,
};
static const uint8_t CHILD[15][8] = {
    {80, 73, 6, 22, 79, 115, 137, 160},       {77, 66, 7, 20, 66, 121, 137, 160},
    {77, 66, 7, 20, 66, 121, 137, 160},       {74, 65, 10, 22, 65, 121, 137, 160},
    {73, 67, 12, 22, 53, 118, 137, 160},      {72, 70, 15, 26, 51, 124, 137, 160},
    {73, 72, 22, 36, 57, 128, 150, 177},      {76, 76, 28, 47, 60, 127, 152, 194},
    {82, 83, 42, 64, 67, 128, 154, 205},      {95, 95, 65, 88, 85, 130, 157, 215},
    {113, 122, 97, 121, 116, 147, 170, 221},  {148, 153, 130, 150, 158, 175, 196, 224},
    {176, 172, 161, 179, 185, 208, 217, 230}, {195, 203, 207, 207, 220, 222, 226, 230},
    {218, 228, 230, 230, 230, 230, 230, 230},
};
#define ALONE 248  /* no other node around: does it hold one point only? */
#define BALANCE 13 /* distance from 128 of an only child in the half that is denser by a step */
#define BALANCE_MOST 26
#define CONFIDENCE 20 /* bits that a first probability counts for */

static uint32_t gain(uint32_t d, uint32_t child, uint32_t own)
{
    int32_t x = 2 * ((int32_t)(d / 9) - 1) + (int32_t)(child >> 2) - (int32_t)(own >> 2);
    int32_t y =
        2 * ((int32_t)(d / 3 % 3) - 1) + (int32_t)(child >> 1 & 1) - (int32_t)(own >> 1 & 1);
    int32_t z = 2 * ((int32_t)(d % 3) - 1) + (int32_t)(child & 1) - (int32_t)(own & 1);
    int32_t square = x * x + y * y + z * z;
    return square < 15 ? GAIN[square] : 0;
}

/* Where the outer cells of a child lie in its word, by the axes (x 4, y 2, z 1) they lie beyond. */
static const uint8_t PLACE[8] = {0, 8, 10, 2, 12, 4, 6, 0};

/* State `value` of the outer cell that lies in direction d, for the children in `mask`. */
static void add_cells(clgs_seen *seen, uint32_t d, uint32_t mask, uint64_t value)
{
    uint32_t axes = (d / 9 != 1 ? 4u : 0) | (d / 3 % 3 != 1 ? 2u : 0) | (d % 3 != 1 ? 1u : 0);
    uint32_t side = (d / 9 == 2 ? 4u : 0) | (d / 3 % 3 == 2 ? 2u : 0) | (d % 3 == 2 ? 1u : 0);
    for (uint32_t own = 0; own < 8; own++)
        if ((own & axes) == side && mask >> (own ^ axes) & 1)
            seen->cells[own / 4] += value << (16 * (own % 4) + PLACE[axes]);
}

/* What is seen of nodes in direction d. */
static void seen_begin(clgs_seen *seen, uint32_t d)
{
    clgs_seen *unknown = seen + CLGS_SEEN - 1;
    seen[0] = *unknown = (clgs_seen){0};
    add_cells(unknown, d, 255, 1);
    add_cells(seen, d, 255, 2);
    for (uint32_t child = 0; child < 8; child++) {
        clgs_seen more = {0};
        add_cells(&more, d, 1u << child, 1);
        for (uint32_t own = 0; own < 8; own++)
            more.density |= (uint64_t)gain(d, child, own) << 8 * own;
        for (uint32_t other = 0; other < 1u << child; other++) {
            clgs_seen *sum = seen + (1u << child | other);
            sum->density = seen[other].density + more.density;
            sum->cells[0] = seen[other].cells[0] + more.cells[0];
            sum->cells[1] = seen[other].cells[1] + more.cells[1];
        }
    }
    for (uint32_t own = 0; own < 8; own++)
        unknown->density |= ((seen[255].density >> 8 * own & 255) + 3) / 6 << 8 * own;
}

static void classes_begin(clgs_octree_model *model)
{
    for (uint32_t i = 0, octave = 0; i < 2048; i++) {
        octave += i >> octave > 1;
        model->logarithm[i] = (uint8_t)(4 * octave + (i << 2 >> octave & 3));
    }
    for (uint32_t i = 0, class = 0; i < 256; i++) {
        class += class + 1 < CLGS_TRUST && i >= TRUST[class + 1];
        model->trust[i] = (uint8_t)class;
    }
}

/* Probability in 1/256 that has seen `count` bits. */
static uint32_t state_of(uint32_t probability, uint32_t count)
{
    return probability << 24 | count;
}

static void fill(uint32_t *state, size_t count, uint32_t value)
{
    for (size_t i = 0; i < count; i++)
        state[i] = value;
}

#define FILL(array, value) fill((uint32_t *)(array), sizeof(array) / sizeof(uint32_t), value)

static void states_begin(clgs_octree_model *model)
{
    FILL(model->alone, state_of(ALONE, CONFIDENCE));
    FILL(model->only_family, state_of(128, 1));
    FILL(model->half_faces, state_of(128, 1));
    FILL(model->child_faces, state_of(128, 1));
    FILL(model->child_outer, state_of(128, 1));
    uint32_t *only = (uint32_t *)model->only_density, *child = (uint32_t *)model->child_density;
    for (uint32_t i = 0; i < sizeof(model->only_density) / sizeof(uint32_t); i++)
        only[i] = state_of(ONLY[i % CLGS_LOG_STEPS], CONFIDENCE);
    for (uint32_t i = 0; i < sizeof(model->child_density) / sizeof(uint32_t); i++) {
        uint32_t row = i / 128 % (CLGS_LOG_STEPS / 2);
        child[i] = state_of(CHILD[row < 14 ? row : 14][i % 8], CONFIDENCE);
    }
    for (uint32_t i = 0; i < CLGS_HEIGHTS * 3 * (2 * CLGS_BALANCE + 1); i++) {
        int32_t balance = (int32_t)(i % (2 * CLGS_BALANCE + 1)) - CLGS_BALANCE;
        balance = clgs_clamp(BALANCE * balance, -BALANCE_MOST, BALANCE_MOST);
        fill((uint32_t *)model->half_density + i * (CLGS_LOG_STEPS / 4), CLGS_LOG_STEPS / 4,
             state_of((uint32_t)(128 + balance), CONFIDENCE));
    }
}

#define WEIGHTS(array, inputs)                                                                     \
    clgs_weights_init((int32_t *)(array), sizeof(array) / sizeof(int32_t), inputs)
#define CURVES(array)                                                                              \
    clgs_curves_init((uint16_t *)(array), sizeof(array) / sizeof(uint16_t), &model->tables)

void clgs_octree_model_begin(clgs_octree_model *model)
{
    clgs_tables_init(&model->tables);
    for (uint32_t d = 0; d < CLGS_DIRECTIONS; d++)
        seen_begin(model->seen[d], d);
    classes_begin(model);
    states_begin(model);
    WEIGHTS(model->only_weight, 2);
    WEIGHTS(model->half_weight, 2);
    WEIGHTS(model->child_weight, 3);
    CURVES(model->only_curve);
    CURVES(model->half_curve);
    CURVES(model->child_curve);
}
