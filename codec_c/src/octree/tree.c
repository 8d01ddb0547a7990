/* Walks an octree from the root down, level by level, and codes the occupancy of every node. The
 * encoder and the decoder take the same steps. */
#include "octree/tree.h"

#include <string.h>

#include "common/bytes.h"
#include "octree/model.h"

typedef struct octree {
    clgs_octree_model *model;
    clgs_levels levels;
    clgs_wide coder;
    uint64_t *points;               /* points of nodes coded whole, level by level */
    size_t run[CLGS_MAX_DEPTH + 1]; /* number of points before each level; ascending between */
    uint32_t runs;
} octree;

size_t clgs_tree_size(size_t count)
{
    return clgs_align(sizeof(clgs_octree_model)) + clgs_align(8 * count) + clgs_levels_size(count);
}

static void octree_begin(octree *tree, size_t count, uint8_t *memory)
{
    tree->model = (void *)memory;
    memory += clgs_align(sizeof(clgs_octree_model));
    tree->points = (void *)memory;
    memory += clgs_align(8 * count);
    tree->run[0] = tree->runs = 0;
    clgs_octree_model_begin(tree->model);
    clgs_levels_begin(&tree->levels, count, memory);
}

/* Write the codes of the last level, whose nodes are points, to `now`; returns their number. */
static size_t find_leaves(clgs_levels *levels)
{
    const clgs_level *above = &levels->above;
    uint64_t *code = levels->now.code;
    for (size_t i = 0; i < above->count; i++)
        for (uint32_t left = above->occupancy[i]; left; left &= left - 1)
            *code++ = above->code[i] << 3 | clgs_lowest(left);
    return (size_t)(code - levels->now.code);
}

/* Code all levels; the points are those in `points` and the leaves. */
static clgs_error code_levels(octree *tree, size_t count, uint32_t depth, const uint64_t *target)
{
    uint64_t *end = tree->points;
    for (uint32_t height = depth; height > 0; height--) {
        end = clgs_octree_code_level(tree->model, &tree->levels, &tree->coder, height, target, end);
        if (tree->coder.failed)
            return CLGS_ERROR_TRUNCATED;
        tree->run[++tree->runs] = (size_t)(end - tree->points);
        tree->levels.capacity = count - tree->run[tree->runs];
        if (!clgs_levels_descend(&tree->levels))
            return CLGS_ERROR_CORRUPT;
    }
    return find_leaves(&tree->levels) == tree->levels.capacity ? CLGS_OK : CLGS_ERROR_CORRUPT;
}

size_t clgs_tree_encode(const uint64_t *code, size_t count, uint32_t depth, uint8_t *out,
                        size_t capacity, uint8_t *memory)
{
    octree tree;
    octree_begin(&tree, count, memory);
    clgs_wide_begin_encode(&tree.coder, out, capacity);
    clgs_error error = code_levels(&tree, count, depth, code);
    clgs_wide_end_encode(&tree.coder);
    return error || tree.coder.failed ? 0 : (size_t)(tree.coder.out - out);
}

static void merge(const uint64_t *a, const uint64_t *a_end, const uint64_t *b,
                  const uint64_t *b_end, uint64_t *out)
{
    while (a < a_end && b < b_end)
        *out++ = *a < *b ? *a++ : *b++;
    if (a < a_end)
        memcpy(out, a, (size_t)(a_end - a) * sizeof *out);
    if (b < b_end)
        memcpy(out, b, (size_t)(b_end - b) * sizeof *out);
}

/* All points in ascending order: the levels' points, few first, then the leaves. */
static void collect(const octree *tree, size_t count, uint64_t *code)
{
    const uint64_t *leaf = tree->levels.now.code;
    uint64_t *sorted = tree->levels.above.code, *spare = code;
    size_t before = 0;
    for (uint32_t i = 0; i < tree->runs; i++) {
        const uint64_t *run = tree->points + tree->run[i], *end = tree->points + tree->run[i + 1];
        if (run == end)
            continue;
        merge(sorted, sorted + before, run, end, spare);
        before = tree->run[i + 1];
        uint64_t *other = sorted;
        sorted = spare;
        spare = other;
    }
    if (sorted == code) {
        memcpy(spare, sorted, before * sizeof sorted[0]);
        sorted = spare;
    }
    merge(sorted, sorted + before, leaf, leaf + (count - before), code);
}

clgs_error clgs_tree_decode(const uint8_t *data, size_t size, uint64_t *code, size_t count,
                            uint32_t depth, uint8_t *memory)
{
    octree tree;
    octree_begin(&tree, count, memory);
    clgs_wide_begin_decode(&tree.coder, data, size);
    clgs_error error = code_levels(&tree, count, depth, NULL);
    if (error)
        return error;
    collect(&tree, count, code);
    return clgs_wide_end_decode(&tree.coder);
}
