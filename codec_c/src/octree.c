#include <string.h>

#include "bytes.h"
#include "model.h"
#include "morton.h"
#include "octree_nodes.h"

#define MODE_RAW 0
#define MODE_CODED 1
#define HEADER 14 /* mode, depth, origin */

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
    uint64_t *target; /* encoder: Morton codes of the points */
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
static void look_around(const clgs_nodes *nodes, size_t i, uint32_t around[CLGS_DIRECTIONS])
{
    const uint32_t *row = nodes->neighbour + i * CLGS_DIRECTIONS;
    memset(around, 0, CLGS_DIRECTIONS * sizeof around[0]);
    for (uint32_t left = nodes->present[i] & ~(1u << CLGS_SELF), d = 0; left; d++, left >>= 1)
        if (left & 1)
            around[d] = row[d] < i ? 0x200u | nodes->occupancy[row[d]] : 0x100u;
}

/* The states of the seven outer cells of a child, two bits each: 0 no node, 1 not yet coded, 2
 * and 3: its child that touches ours is empty, is full. */
static uint32_t outer_cells(const clgs_nodes *nodes, const uint32_t around[CLGS_DIRECTIONS],
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

/* Code the occupancy of node i; `height` is the class of its levels to the leaves. */
static uint32_t code_node(octree *tree, size_t i, uint32_t height, uint32_t occupancy)
{
    model *m = tree->model;
    uint32_t around[CLGS_DIRECTIONS], cells[8], prefix = 1, full = 0;
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
        uint32_t bit = clgs_mix_code(&mix, occupancy >> octant & 1);
        full += bit;
        prefix = prefix << 1 | bit;
    }
    return reverse8(prefix & 255);
}

/* Encoder: occupancy of every node of the level whose children have `shift` bits below them. */
static void find_occupancy(octree *tree, size_t count, uint32_t shift)
{
    clgs_nodes *nodes = &tree->nodes;
    memset(nodes->occupancy, 0, nodes->count);
    for (size_t i = 0, node = 0; i < count; i++) {
        uint64_t child = tree->target[i] >> shift;
        node += nodes->code[node] != child >> 3;
        nodes->occupancy[node] |= (uint8_t)(1u << (child & 7));
    }
}

static clgs_error code_levels(octree *tree, size_t count, uint32_t depth)
{
    clgs_nodes *nodes = &tree->nodes;
    clgs_nodes_begin(nodes);
    for (uint32_t height = depth; height > 0; height--) {
        if (!tree->coder.decoding)
            find_occupancy(tree, count, 3 * (height - 1));
        for (size_t i = 0; i < nodes->count && !tree->coder.failed; i++) {
            uint32_t occupancy = tree->coder.decoding ? 0 : nodes->occupancy[i];
            nodes->occupancy[i] = (uint8_t)code_node(tree, i, height_class(height), occupancy);
        }
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

size_t clgs_octree_workspace(size_t count)
{
    size_t node = 8 + 8 + 4 + 4 + 4 * CLGS_DIRECTIONS + 1;
    if (count > CLGS_MAX_POINTS)
        return 0;
    return align(sizeof(model)) + node * (count + 1) + 6 * 64;
}

static void *carve(uint8_t **at, size_t size)
{
    void *start = *at;
    *at += align(size);
    return start;
}

static void octree_begin(octree *tree, size_t count, void *workspace)
{
    uint8_t *at = workspace;
    clgs_nodes *nodes = &tree->nodes;
    tree->model = carve(&at, sizeof(model));
    tree->target = carve(&at, 8 * count);
    nodes->capacity = count;
    nodes->code = carve(&at, 8 * count);
    nodes->first_child = carve(&at, 4 * count);
    nodes->present = carve(&at, 4 * count);
    nodes->neighbour = carve(&at, 4 * CLGS_DIRECTIONS * count);
    nodes->occupancy = carve(&at, count);
    model_init(tree->model);
}

size_t clgs_octree_bound(size_t count)
{
    return count > CLGS_MAX_POINTS ? 0 : HEADER + 8 * count;
}

/* Levels below the root that hold every code; codes must ascend. Returns 0 where they do not. */
static int find_depth(const uint64_t *code, size_t count, uint32_t *depth)
{
    uint64_t all = 0;
    for (size_t i = 0; i < count; i++) {
        if (i > 0 && code[i] <= code[i - 1])
            return 0;
        all |= code[i];
    }
    for (*depth = 0; *depth < CLGS_MAX_DEPTH && all >> (3 * *depth);)
        ++*depth;
    return 1;
}

static size_t encode_raw(const octree *tree, size_t count, uint8_t *out)
{
    out[0] = MODE_RAW;
    for (size_t i = 0; i < 2 * count; i++)
        clgs_store32(out + HEADER + 4 * i, (uint32_t)(tree->target[i / 2] >> 32 * (i & 1)));
    return HEADER + 8 * count;
}

size_t clgs_octree_encode(const int32_t *position, size_t count, const int32_t origin[3],
                          uint8_t *out, size_t capacity, void *workspace)
{
    octree tree = {0};
    uint32_t depth;
    if (count == 0 || count > CLGS_MAX_POINTS || capacity < clgs_octree_bound(count))
        return 0;
    octree_begin(&tree, count, workspace);
    if (clgs_morton_encode(position, count, origin, tree.target) != CLGS_OK)
        return 0;
    if (!find_depth(tree.target, count, &depth))
        return 0;
    out[0] = MODE_CODED;
    out[1] = (uint8_t)depth;
    for (int axis = 0; axis < 3; axis++)
        clgs_store32(out + 2 + 4 * axis, (uint32_t)origin[axis]);
    clgs_range_begin_encode(&tree.coder, out + HEADER, 8 * count);
    clgs_error error = code_levels(&tree, count, depth);
    clgs_range_end_encode(&tree.coder);
    if (error != CLGS_OK || tree.coder.failed)
        return encode_raw(&tree, count, out);
    return (size_t)(tree.coder.out - out);
}

static clgs_error decode_raw(octree *tree, const uint8_t *data, size_t size, size_t count)
{
    uint64_t *code = tree->nodes.code;
    if (size != 8 * count)
        return size < 8 * count ? CLGS_ERROR_TRUNCATED : CLGS_ERROR_TRAILING;
    for (size_t i = 0; i < count; i++) {
        code[i] = clgs_load32(data + 8 * i) | (uint64_t)clgs_load32(data + 8 * i + 4) << 32;
        if (code[i] >> 3 * CLGS_MAX_DEPTH || (i > 0 && code[i] <= code[i - 1]))
            return CLGS_ERROR_CORRUPT;
    }
    return CLGS_OK;
}

static clgs_error decode_coded(octree *tree, const uint8_t *data, size_t size, size_t count,
                               uint32_t depth)
{
    clgs_range_begin_decode(&tree->coder, data, size);
    clgs_error error = code_levels(tree, count, depth);
    return error ? error : clgs_range_end_decode(&tree->coder);
}

static clgs_error store_positions(const uint64_t *code, size_t count, const int32_t origin[3],
                                  int32_t *position)
{
    for (size_t i = 0; i < 3 * count; i++) {
        uint32_t axis = (uint32_t)(i % 3);
        int64_t cell = (int64_t)origin[axis] + clgs_gather(code[i / 3] >> (2 - axis));
        if (cell > INT32_MAX)
            return CLGS_ERROR_CORRUPT;
        position[i] = (int32_t)cell;
    }
    return CLGS_OK;
}

clgs_error clgs_octree_decode(const uint8_t *data, size_t size, int32_t *position, size_t count,
                              void *workspace)
{
    octree tree = {0};
    int32_t origin[3];
    clgs_error error;
    if (count == 0 || count > CLGS_MAX_POINTS)
        return CLGS_ERROR_ARGUMENT;
    if (size < HEADER)
        return CLGS_ERROR_TRUNCATED;
    if (data[0] > MODE_CODED || data[1] > CLGS_MAX_DEPTH)
        return CLGS_ERROR_CORRUPT;
    for (int axis = 0; axis < 3; axis++)
        origin[axis] = clgs_signed(clgs_load32(data + 2 + 4 * axis));
    octree_begin(&tree, count, workspace);
    if (data[0] == MODE_RAW)
        error = decode_raw(&tree, data + HEADER, size - HEADER, count);
    else
        error = decode_coded(&tree, data + HEADER, size - HEADER, count, data[1]);
    return error ? error : store_positions(tree.nodes.code, count, origin, position);
}
