#include "octree_occupancy.h"

#include <string.h>

#include "model.h"
#include "octree_nodes.h"

#define HEIGHTS 6
#define INPUTS 2
#define LIMIT 250
#define WEIGHT_SHIFT 15

/* The states of a child lie together where they can: fetch them while others are coded. */
#if defined(__GNUC__)
#define PREFETCH(x) __builtin_prefetch(x)
#else
#define PREFETCH(x) ((void)0)
#endif

typedef struct model {
    clgs_tables tables;
    uint32_t face[HEIGHTS][64][256]; /* by height, three face cells, children coded so far */
    uint32_t outer[16384][8];        /* by seven outer cells, number of full children so far */
    int32_t weight[HEIGHTS][8][INPUTS];
    uint16_t curve[HEIGHTS][256][CLGS_CURVE_KNOTS]; /* by height, children coded so far */
} model;

/* Of the seven outer cells, three share a face with the child, three an edge, one a corner;
 * the child of that cell that touches ours differs from it in these octant bits. */
static const uint8_t MIRROR[7] = {4, 2, 1, 6, 5, 3, 7};

typedef struct octree {
    clgs_range coder;
    clgs_nodes nodes;
    model *model;
} octree;

static void model_init(model *m)
{
    clgs_tables_init(&m->tables);
    clgs_states_init(m->face[0][0], HEIGHTS * 64 * 256);
    clgs_states_init(m->outer[0], 16384 * 8);
    clgs_weights_init(m->weight[0][0], HEIGHTS * 8 * INPUTS, INPUTS);
    clgs_curves_init(m->curve[0][0], HEIGHTS * 256 * CLGS_CURVE_KNOTS, &m->tables);
}

/* Levels from a node to the leaves, 1 and up, in six classes. */
static uint32_t height_class(uint32_t height)
{
    return height <= 4 ? height - 1 : height <= 7 ? 4 : 5;
}

static uint32_t reverse8(uint32_t bits)
{
    bits = (bits & 0x0F) << 4 | bits >> 4;
    bits = (bits & 0x33) << 2 | (bits >> 2 & 0x33);
    return (bits & 0x55) << 1 | (bits >> 1 & 0x55);
}

/* What is known of the 26 cells around a node: 0 no node, 0x100 not yet coded, 0x200 | occupancy */
static void look_around(const clgs_nodes *nodes, size_t i, uint32_t around[CLGS_NEIGHBOURS])
{
    const uint32_t *row = nodes->neighbour + i * CLGS_NEIGHBOURS;
    memset(around, 0, CLGS_NEIGHBOURS * sizeof around[0]);
    for (uint32_t left = nodes->present[i] & ~(1u << CLGS_SELF), d = 0; left; d++, left >>= 1)
        if (left & 1)
            around[d] = row[d] < i ? 0x200u | nodes->occupancy[row[d]] : 0x100u;
}

/* The states of the seven outer cells of a child, two bits each: 0 no node, 1 not yet coded, 2
 * and 3: its child that touches ours is empty, is full. */
static uint32_t outer_cells(const clgs_nodes *nodes, const uint32_t around[CLGS_NEIGHBOURS],
                            uint32_t octant)
{
    uint32_t cells = 0;
    for (uint32_t k = 0; k < 7; k++) {
        uint32_t child = octant ^ MIRROR[k];
        uint32_t cell = around[nodes->direction[octant][MIRROR[k]][child]];
        cells = cells << 2 | (cell < 0x200 ? cell >> 8 : 2 + (cell >> child & 1));
    }
    return cells;
}

/* The occupancy of node i; `height` is the class of its levels to the leaves. */
static uint32_t decode_node(octree *tree, size_t i, uint32_t height)
{
    model *m = tree->model;
    uint32_t around[CLGS_NEIGHBOURS], cells[8], prefix = 1, full = 0;
    clgs_mix mix = {
        .coder = &tree->coder,
        .tables = &m->tables,
        .inputs = INPUTS,
        .limit = {LIMIT, LIMIT},
        .shift = WEIGHT_SHIFT,
    };
    look_around(&tree->nodes, i, around);
    for (uint32_t octant = 0; octant < 8; octant++) {
        cells[octant] = outer_cells(&tree->nodes, around, octant);
        PREFETCH(m->outer[cells[octant]]);
        PREFETCH(m->face[height][cells[octant] >> 8] + (1u << octant));
    }
    for (uint32_t octant = 0; octant < 8; octant++) {
        if (prefix == 128)
            return 128; /* a node has a child: the last of eight is sure */
        mix.state[0] = m->face[height][cells[octant] >> 8] + prefix;
        mix.state[1] = m->outer[cells[octant]] + full;
        mix.weight = m->weight[height][octant];
        mix.curve = m->curve[height][prefix];
        uint32_t bit = clgs_mix_code(&mix, 0);
        full += bit;
        prefix = prefix << 1 | bit;
    }
    return reverse8(prefix & 255);
}

static clgs_error decode_levels(octree *tree, size_t count, uint32_t depth)
{
    clgs_nodes *nodes = &tree->nodes;
    clgs_nodes_begin(nodes);
    for (uint32_t height = depth; height > 0; height--) {
        for (size_t i = 0; i < nodes->count && !tree->coder.failed; i++)
            nodes->occupancy[i] = (uint8_t)decode_node(tree, i, height_class(height));
        if (tree->coder.failed)
            return CLGS_ERROR_TRUNCATED;
        if (!clgs_nodes_descend(nodes, height == 1))
            return CLGS_ERROR_CORRUPT;
    }
    return nodes->count == count ? CLGS_OK : CLGS_ERROR_CORRUPT;
}

static size_t align(size_t size)
{
    return (size + 63) / 64 * 64;
}

size_t clgs_occupancy_size(size_t count)
{
    size_t node = 8 + 4 + 4 + 4 * CLGS_NEIGHBOURS + 1;
    return align(sizeof(model)) + node * count + 5 * 64;
}

static void *carve(uint8_t **at, size_t size)
{
    void *start = *at;
    *at += align(size);
    return start;
}

static void octree_begin(octree *tree, size_t count, uint8_t *at)
{
    clgs_nodes *nodes = &tree->nodes;
    tree->model = carve(&at, sizeof(model));
    nodes->capacity = count;
    nodes->code = carve(&at, 8 * count);
    nodes->first_child = carve(&at, 4 * count);
    nodes->present = carve(&at, 4 * count);
    nodes->neighbour = carve(&at, 4 * CLGS_NEIGHBOURS * count);
    nodes->occupancy = carve(&at, count);
    model_init(tree->model);
}

clgs_error clgs_occupancy_decode(const uint8_t *data, size_t size, uint64_t *code, size_t count,
                                 uint32_t depth, uint8_t *memory)
{
    octree tree = {0};
    octree_begin(&tree, count, memory);
    clgs_range_begin_decode(&tree.coder, data, size);
    clgs_error error = decode_levels(&tree, count, depth);
    if (error)
        return error;
    memcpy(code, tree.nodes.code, count * sizeof code[0]);
    return clgs_range_end_decode(&tree.coder);
}
