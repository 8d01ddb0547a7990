/* The rows nearest to each row of a chunk, among those before it.
 *
 * Rows are visited from the last one down, and a block of them is skipped if no point of its box
 * is near enough: blocks of 8 rows, blocks of 8 blocks and so on. In Morton order few are visited.
 */
#include <string.h>

#include "clgs_codec.h"

#define WIDTH 8 /* rows or blocks per block */
#define MAX_LAYERS 10
#define MAX_EXTENT ((int64_t)1 << CLGS_MAX_DEPTH)

typedef struct box {
    int32_t low[3], high[3];
} box;

/* Blocks that are full, by layer. */
typedef struct tree {
    const int32_t *position;
    box *layer[MAX_LAYERS];
    size_t layers;
} tree;

/* The nearest rows so far, and their squared distances, ascending. */
typedef struct nearest {
    const int32_t *point;
    int32_t row[CLGS_NEAR];
    int64_t distance[CLGS_NEAR];
} nearest;

size_t clgs_near_workspace(size_t rows)
{
    return rows <= CLGS_MAX_POINTS ? sizeof(box) * (rows / (WIDTH - 1) + 1) : 0;
}

static void join(box *all, const int32_t *low, const int32_t *high)
{
    for (int axis = 0; axis < 3; axis++) {
        all->low[axis] = low[axis] < all->low[axis] ? low[axis] : all->low[axis];
        all->high[axis] = high[axis] > all->high[axis] ? high[axis] : all->high[axis];
    }
}

static const box EMPTY = {{INT32_MAX, INT32_MAX, INT32_MAX}, {INT32_MIN, INT32_MIN, INT32_MIN}};

static void build(tree *t, size_t rows, box *next)
{
    for (size_t count = rows / WIDTH; count > 0; count /= WIDTH) {
        t->layer[t->layers] = next;
        for (size_t i = 0; i < count * WIDTH; i++) {
            const int32_t *point = t->position + 3 * i;
            const box *part = t->layers > 0 ? t->layer[t->layers - 1] + i : NULL;
            if (i % WIDTH == 0)
                next[i / WIDTH] = EMPTY;
            join(next + i / WIDTH, part ? part->low : point, part ? part->high : point);
        }
        next += count;
        t->layers++;
    }
}

/* Squared distance of a point from a box; 0 inside. */
static int64_t distance_of(const box *b, const int32_t *point)
{
    int64_t sum = 0;
    for (int axis = 0; axis < 3; axis++) {
        int64_t below = (int64_t)b->low[axis] - point[axis];
        int64_t above = (int64_t)point[axis] - b->high[axis];
        int64_t off = below > above ? below : above;
        sum += off > 0 ? off * off : 0;
    }
    return sum;
}

/* Take a row if it is nearer than the last of the nearest; of equal ones the first taken stays. */
static void consider(nearest *n, const int32_t *position, size_t row)
{
    int64_t distance = 0;
    int place = CLGS_NEAR - 1;
    for (int axis = 0; axis < 3; axis++) {
        int64_t off = (int64_t)n->point[axis] - position[3 * row + (size_t)axis];
        distance += off * off;
    }
    if (distance >= n->distance[place])
        return;
    for (; place > 0 && distance < n->distance[place - 1]; place--) {
        n->distance[place] = n->distance[place - 1];
        n->row[place] = n->row[place - 1];
    }
    n->distance[place] = distance;
    n->row[place] = (int32_t)row;
}

/* The rows of a full block, from the last one down. */
static void visit(nearest *n, const tree *t, size_t layer, size_t block)
{
    if (distance_of(t->layer[layer] + block, n->point) >= n->distance[CLGS_NEAR - 1])
        return;
    for (size_t part = (block + 1) * WIDTH; part-- > block * WIDTH;)
        if (layer > 0)
            visit(n, t, layer - 1, part);
        else
            consider(n, t->position, part);
}

/* All rows before `row`: those of its own block, then the blocks before that, layer by layer. */
static void search(nearest *n, const tree *t, size_t row)
{
    size_t at = row;
    for (size_t k = at; k-- > at / WIDTH * WIDTH;)
        consider(n, t->position, k);
    at /= WIDTH;
    for (size_t layer = 0; layer < t->layers; layer++, at /= WIDTH)
        for (size_t k = at; k-- > at / WIDTH * WIDTH;)
            visit(n, t, layer, k);
}

static int fits(const int32_t *position, size_t rows)
{
    box all = EMPTY;
    for (size_t i = 0; i < rows; i++)
        join(&all, position + 3 * i, position + 3 * i);
    for (int axis = 0; axis < 3; axis++)
        if (rows > 0 && (int64_t)all.high[axis] - all.low[axis] >= MAX_EXTENT)
            return 0;
    return 1;
}

clgs_error clgs_near(const int32_t *position, size_t rows, int32_t *near, void *workspace)
{
    tree t = {.position = position, .layers = 0};
    if (rows > CLGS_MAX_POINTS || !fits(position, rows))
        return CLGS_ERROR_ARGUMENT;
    build(&t, rows, workspace);
    for (size_t i = 0; i < rows; i++) {
        nearest n = {.point = position + 3 * i};
        for (int k = 0; k < CLGS_NEAR; k++) {
            n.row[k] = -1;
            n.distance[k] = INT64_MAX;
        }
        search(&n, &t, i);
        memcpy(near + CLGS_NEAR * i, n.row, sizeof n.row);
    }
    return CLGS_OK;
}
