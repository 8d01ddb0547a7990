/* One level of an octree: the decisions of every node, in both directions. */
#include "octree/model.h"

#define LIMIT 250
#define WEIGHT_SHIFT 13
#define WEIGHT_MOST (4 * CLGS_WEIGHT_ONE)

/* The states of a child lie far apart: fetch them while others are coded. */
#if defined(__GNUC__)
#define PREFETCH(x) __builtin_prefetch(x)
#else
#define PREFETCH(x) ((void)0)
#endif

typedef struct surroundings {
    clgs_seen seen;
    uint32_t count; /* nodes around */
    uint32_t total; /* sum of the densities */
} surroundings;

typedef struct neighbour {
    uint32_t child; /* its first */
    uint32_t occupancy;
} neighbour;

/* Bits of masks are cells of the 4 x 4 x 4 children's cells in and around a node. */
typedef struct neighbourhood {
    uint64_t cells; /* those of children */
    uint64_t known; /* ... that are coded */
    neighbour node[CLGS_DIRECTIONS];
} neighbourhood;

typedef struct site {
    clgs_octree_model *model;
    clgs_wide *coder;
    uint32_t height;      /* levels to the leaves */
    uint32_t class;       /* ... in classes */
    uint32_t parent;      /* class of nodes around the parent */
    uint32_t family;      /* mirrored occupancy of the parent */
    uint32_t children;    /* of the parent */
    uint32_t known;       /* mask of the family: a root has none */
    neighbourhood circle; /* around the parent */
    surroundings around;
} site;

/* Code one bit with `inputs` states; they, their weights and the curve learn from it. */
CLGS_INLINE uint32_t mix(const site *at, uint32_t *const *state, uint32_t inputs, int32_t *weights,
                         uint16_t *curve, uint32_t bit, int decoding)
{
    clgs_octree_model *model = at->model;
    const clgs_tables *tables = &model->tables;
    uint32_t trust = model->trust[*state[0] & 255] * (uint32_t)CLGS_TRUST;
    trust += model->trust[*state[1] & 255];
    int32_t odds[3], *weight = weights + inputs * trust, sum = 0;
    for (uint32_t i = 0; i < inputs; i++) {
        odds[i] = tables->stretch[*state[i] >> 20];
        sum += weight[i] * odds[i];
    }
    sum = clgs_clamp(sum >> 16, -CLGS_ODDS_LIMIT, CLGS_ODDS_LIMIT - 1) + CLGS_ODDS_LIMIT;
    uint32_t place = (uint32_t)sum, part = place % CLGS_CURVE_STEP;
    int32_t mixed = tables->squash[place];
    uint16_t *knot = curve + place / CLGS_CURVE_STEP;
    uint32_t learned = (knot[0] * (CLGS_CURVE_STEP - part) + knot[1] * part) / CLGS_CURVE_STEP;
    int32_t p = (mixed + 3 * (int32_t)learned) >> 2;
    p = clgs_clamp(p, CLGS_MIN_PROBABILITY, 65536 - CLGS_MIN_PROBABILITY);
    bit = clgs_wide_code(at->coder, bit, (uint32_t)p, decoding);
    int32_t error = (int32_t)(bit << 16) - mixed;
    for (uint32_t i = 0; i < inputs; i++) {
        int32_t moved = weight[i] + ((odds[i] * error) >> WEIGHT_SHIFT);
        weight[i] = clgs_clamp(moved, -WEIGHT_MOST, WEIGHT_MOST);
        clgs_state_update(state[i], bit, LIMIT, tables->rate);
    }
    knot += part >= CLGS_CURVE_STEP / 2;
    *knot = (uint16_t)(bit ? *knot + ((65535 - *knot) >> 6) : *knot - (*knot >> 6));
    return bit;
}

static uint32_t density_of(const surroundings *around, uint32_t first, uint32_t count)
{
    uint32_t sum = 0;
    for (uint32_t child = first; child < first + count; child++)
        sum += (uint32_t)(around->seen.density >> 8 * child & 255);
    return sum;
}

static uint32_t cells_of(const surroundings *around, uint32_t child)
{
    return (uint32_t)(around->seen.cells[child >> 2] >> 16 * (child & 3) & 0x3FFF);
}

/* The nodes around `parent`, and their children that may touch its own. */
static void circle_begin(neighbourhood *circle, const clgs_levels *levels, size_t parent)
{
    const clgs_touch *touch = &levels->touch;
    const clgs_level *above = &levels->above;
    circle->node[CLGS_SELF] = (neighbour){above->child[parent], above->occupancy[parent]};
    circle->cells = clgs_touch_cells(touch, CLGS_SELF, above->occupancy[parent]);
    circle->known = 0;
    for (uint32_t k = above->first[parent]; k < above->first[parent + 1]; k++) {
        uint32_t d = above->list[k] & 31, node = above->list[k] >> 5;
        uint32_t occupancy = above->occupancy[node];
        uint64_t cells = clgs_touch_cells(touch, d, occupancy);
        circle->node[d] = (neighbour){above->child[node], occupancy};
        circle->cells |= cells;
        circle->known |= node < parent ? cells : 0;
    }
}

/* The nodes around child `own` of a node, which is node i: what is known of them, and their list.
 * Those before it are coded. */
CLGS_INLINE void look_around(const clgs_octree_model *model, clgs_levels *levels,
                             const neighbourhood *circle, uint32_t own, size_t i,
                             surroundings *around)
{
    const clgs_touch *touch = &levels->touch;
    const uint8_t *coded = levels->now.occupancy;
    uint32_t *list = levels->now.list + levels->now.first[i], length = 0;
    clgs_seen sum = {0};
    for (uint64_t left = circle->cells & touch->window[own]; left; left &= left - 1) {
        uint32_t cell = clgs_lowest64(left), d = touch->direction[own][cell];
        const neighbour *next = &circle->node[touch->owner[cell]];
        uint32_t node = next->child + touch->count[next->occupancy & touch->before[cell]];
        uint32_t occupancy = circle->known >> cell & 1 ? coded[node] : CLGS_SEEN - 1;
        const clgs_seen *seen = &model->seen[d][occupancy];
        sum.density += seen->density;
        sum.cells[0] += seen->cells[0];
        sum.cells[1] += seen->cells[1];
        list[length++] = node << 5 | d;
    }
    around->seen = sum;
    around->count = length;
    around->total = density_of(around, 0, 8);
}

/* Other children of the parent, in classes: 0, 1, 2-3, more. */
static uint32_t siblings(const site *at)
{
    uint32_t children = at->children;
    return children < 3 ? children - (children > 0) : children < 5 ? 2 : 3;
}

/* Code whether a node without others around holds one point only, and where it is. */
CLGS_INLINE int code_alone(const site *at, uint32_t alone, uint64_t *path, int decoding)
{
    uint32_t *state = &at->model->alone[at->class][at->parent], bits = 3 * at->height;
    int32_t p =
        clgs_clamp((int32_t)(*state >> 16), CLGS_MIN_PROBABILITY, 65536 - CLGS_MIN_PROBABILITY);
    alone = clgs_wide_code(at->coder, alone, (uint32_t)p, decoding);
    clgs_state_update(state, alone, LIMIT, at->model->tables.rate);
    if (!alone)
        return 0;
    uint64_t value = decoding ? 0 : *path;
    *path = 0;
    while (bits > 0) {
        uint32_t step = bits < CLGS_WIDE_PLAIN ? bits : CLGS_WIDE_PLAIN;
        bits -= step;
        uint32_t part = (uint32_t)(value >> bits) & ((1u << step) - 1);
        *path = *path << step | clgs_wide_plain(at->coder, part, step, decoding);
    }
    return 1;
}

CLGS_INLINE uint32_t code_only(const site *at, uint32_t only, int decoding)
{
    clgs_octree_model *model = at->model;
    uint32_t total = model->logarithm[1 + at->around.total];
    uint32_t crowd = clgs_crowd(at->around.count);
    uint32_t *state[2] = {&model->only_density[at->class][at->parent][siblings(at)][total],
                          &model->only_family[at->class][crowd][at->family]};
    return mix(at, state, 2, model->only_weight[0], model->only_curve[at->class], only, decoding);
}

/* Code the place of an only child, a bit an axis: which half of what is left holds it? */
CLGS_INLINE uint32_t code_place(const site *at, uint32_t child, int decoding)
{
    clgs_octree_model *model = at->model;
    uint32_t first = 0, prefix = 1;
    for (uint32_t axis = 0, half = 4; axis < 3; axis++, half /= 2) {
        uint32_t lower = density_of(&at->around, first, half);
        uint32_t upper = density_of(&at->around, first + half, half);
        int32_t balance = model->logarithm[1 + upper] - model->logarithm[1 + lower];
        balance = clgs_clamp(balance, -CLGS_BALANCE, CLGS_BALANCE) + CLGS_BALANCE;
        uint32_t octaves = model->logarithm[1 + lower + upper] / 4;
        uint32_t near = cells_of(&at->around, first) >> 8;
        uint32_t far = cells_of(&at->around, first + 2 * half - 1) >> 8;
        uint32_t *state[2] = {&model->half_density[at->class][axis][balance][octaves],
                              &model->half_faces[prefix][near][far]};
        uint32_t bit = mix(at, state, 2, model->half_weight[0], model->half_curve[at->class][axis],
                           child >> (2 - axis) & 1, decoding);
        first += bit ? half : 0;
        prefix = prefix << 1 | bit;
    }
    return first;
}

/* Code which of eight children exist, two at least. */
CLGS_INLINE uint32_t code_children(const site *at, uint32_t occupancy, int decoding)
{
    clgs_octree_model *model = at->model;
    uint32_t prefix = 1, full = 0, coded = 0;
    for (uint32_t child = 1; child < 8; child++) {
        uint32_t cells = cells_of(&at->around, child);
        PREFETCH(model->child_outer[cells]);
        PREFETCH(model->child_faces[cells >> 8] + (1u << child));
    }
    for (uint32_t child = 0; child < 8; child++) {
        uint32_t bit = 1, cells = cells_of(&at->around, child);
        if (full + 8 - child > 2) {
            uint32_t density = (uint32_t)(at->around.seen.density >> 8 * child & 255);
            uint32_t near = model->logarithm[1 + density];
            uint32_t *state[3] = {&model->child_faces[cells >> 8][prefix],
                                  &model->child_outer[cells][full],
                                  &model->child_density[at->class][near][child][full]};
            bit = mix(at, state, 3, model->child_weight[0],
                      model->child_curve[at->class][child][full], occupancy >> child & 1, decoding);
        }
        full += bit;
        coded |= bit << child;
        prefix = prefix << 1 | bit;
    }
    return coded;
}

CLGS_INLINE uint32_t code_node(const site *at, uint32_t occupancy, int decoding)
{
    uint32_t only = 0;
    uint32_t near = cells_of(&at->around, 0), far = cells_of(&at->around, 7);
    PREFETCH(at->model->child_outer[near]);
    PREFETCH(&at->model->half_faces[1][near >> 8][far >> 8]);
    if (at->around.count > 0 || at->height > 1)
        only = code_only(at, (occupancy & (occupancy - 1)) == 0, decoding);
    if (!only)
        return code_children(at, occupancy, decoding);
    if (at->height == 1 && at->around.count <= 3)
        return 1u << clgs_wide_plain(at->coder, decoding ? 0 : clgs_lowest(occupancy), 3, decoding);
    return 1u << code_place(at, decoding ? 0 : clgs_lowest(occupancy), decoding);
}

/* Encoder: the occupancy of node i, and the points of its children from `child` on. */
static uint32_t find_occupancy(clgs_levels *levels, size_t i, uint32_t shift,
                               const uint64_t *target)
{
    size_t child = levels->children;
    uint32_t occupancy = 0, end = levels->now.end[i];
    for (uint32_t k = levels->now.begin[i]; k < end; k++) {
        uint32_t bit = 1u << (target[k] >> shift & 7);
        if (!(occupancy & bit))
            levels->above.begin[child++] = k;
        occupancy |= bit;
        levels->above.end[child - 1] = k + 1;
    }
    return occupancy;
}

/* Code child `own` of node `parent`, the next of its level; returns the new end of `points`. */
CLGS_INLINE uint64_t *code_child(site *at, clgs_levels *levels, size_t parent, uint32_t own,
                                 const uint64_t *target, uint64_t *points, int decoding)
{
    clgs_level *now = &levels->now;
    size_t i = now->count++;
    uint32_t occupancy = 0;
    now->code[i] = levels->above.code[parent] << 3 | own;
    look_around(at->model, levels, &at->circle, own, i, &at->around);
    at->family = levels->touch.mirror[own][levels->above.occupancy[parent]] & at->known;
    now->first[i + 1] = now->first[i] + (at->height > 1 ? at->around.count : 0);
    if (at->around.count == 0 && at->parent > 0) {
        uint64_t path = decoding ? 0 : target[now->begin[i]];
        if (code_alone(at, !decoding && now->end[i] - now->begin[i] == 1, &path, decoding)) {
            *points++ = now->code[i] << 3 * at->height | path;
            now->occupancy[i] = 0;
            return points;
        }
    }
    if (!decoding)
        occupancy = find_occupancy(levels, i, 3 * (at->height - 1), target);
    occupancy = code_node(at, occupancy, decoding);
    now->occupancy[i] = (uint8_t)occupancy;
    now->child[i] = (uint32_t)levels->children;
    levels->children += levels->touch.count[occupancy];
    return points;
}

CLGS_INLINE uint64_t *code_level(site *at, clgs_levels *levels, const uint64_t *target,
                                 uint64_t *points, int decoding)
{
    const clgs_level *above = &levels->above;
    for (size_t parent = 0; parent < above->count && !at->coder->failed; parent++) {
        uint32_t occupancy = above->occupancy[parent];
        at->parent = clgs_crowd(above->first[parent + 1] - above->first[parent]);
        at->children = levels->touch.count[occupancy];
        circle_begin(&at->circle, levels, parent);
        for (uint32_t left = occupancy; left; left &= left - 1) {
            uint32_t own = clgs_lowest(left);
            points = code_child(at, levels, parent, own, target, points, decoding);
            at->circle.known |= clgs_touch_cells(&levels->touch, CLGS_SELF, 1u << own);
        }
    }
    return points;
}

uint64_t *clgs_octree_code_level(clgs_octree_model *model, clgs_levels *levels, clgs_wide *coder,
                                 uint32_t height, const uint64_t *target, uint64_t *points)
{
    uint32_t class = height <= 4 ? height - 1 : height <= 7 ? 4 : 5;
    site at = {.model = model, .coder = coder, .height = height, .class = class};
    at.known = levels->root ? 0 : 255;
    if (target)
        return code_level(&at, levels, target, points, 0);
    return code_level(&at, levels, NULL, points, 1);
}
