/* Adam on parameters that live on the device. No fma and no reordering: NumPy in float32 gives the
 * same bits if the device rounds division and square root correctly.
 *
 * adam_step, adam_step_rows, adam_average: a work-item per vector of VEC elements.
 * adam_check: a work-item per ELEMENTS_PER_ITEM elements.
 * adam_mark: a work-item per row of WIDTH elements.
 * Work-group: any; no local memory. Every part and every array begins with a work-group.
 */
#include "common/form.h"
#include "common/lanes.h"
#include "common/parts.h"
#include "common/real.h"

/* Smaller moments become zero: they would decay into subnormals, which take ten times as long.
 * A first moment below its limit moves a parameter by less than 1e-15 of the step; the limit of the
 * second one is lower, because an epsilon of 1e-15 is added to its root. */
#ifndef MIN_FIRST_MOMENT
#define MIN_FIRST_MOMENT 1e-30f
#define MIN_SECOND_MOMENT 1e-36f
#endif

/* Elements per row, for the kernels that go by rows. */
#ifndef WIDTH
#define WIDTH 6
#endif

/* The bit of the stop flag that says that a gradient was infinite or NaN. */
#ifndef NOT_FINITE
#define NOT_FINITE 1
#endif

/* What changes from step to step; correction = 1/sqrt(1 - beta2^t). */
typedef struct {
    float4 betas;
    float correction;
    float epsilon;
    float step;
} Factors;

/* A vector of parameters and of their moments. */
typedef struct {
    fv parameter;
    fv first;
    fv second;
} State;

static inline State load_state(__global const float *parameter, __global const float *first,
                               __global const float *second, const size_t vector,
                               const size_t total)
{
    State s;
    s.parameter = load_lanes(parameter, vector, total);
    s.first = load_lanes(first, vector, total);
    s.second = load_lanes(second, vector, total);
    return s;
}

static inline void store_state(const State *s, __global float *parameter, __global float *first,
                               __global float *second, const size_t vector, const size_t total)
{
    store_lanes(s->parameter, vector, parameter, total);
    store_lanes(s->first, vector, first, total);
    store_lanes(s->second, vector, second, total);
}

/* One step of Adam. */
static inline void update(State *s, const fv gradient, const Factors by)
{
    const fv m = s->first * by.betas.x + gradient * by.betas.y;
    const fv v = s->second * by.betas.z + gradient * gradient * by.betas.w;
    s->first = fabs(m) < (fv)(MIN_FIRST_MOMENT) ? (fv)(0.0f) : m;
    s->second = v < (fv)(MIN_SECOND_MOMENT) ? (fv)(0.0f) : v;
    const fv root = sqrt(s->second) * by.correction + by.epsilon;
    s->parameter = s->parameter - s->first / root * by.step;
}

/* A tensor, or a part of one: its arrays, and elements `start` to `start + total - 1`. */
#define PART(n)                                                                                    \
    __global float *parameter##n, __global const float *gradient##n, __global float *first##n,     \
        __global float *second##n

/* The work-groups after those of other parts belong to part n, if it has elements. */
#define CHOOSE_PART(n)                                                                             \
    if (group >= first_group) {                                                                    \
        part_group = first_group;                                                                  \
        parameter = parameter##n + starts.s##n;                                                    \
        gradient = gradient##n + starts.s##n;                                                      \
        first = first##n + starts.s##n;                                                            \
        second = second##n + starts.s##n;                                                          \
        total = sizes.s##n;                                                                        \
        by.correction = corrections.s##n;                                                          \
        by.step = steps.s##n;                                                                      \
    }                                                                                              \
    first_group += groups_of(vectors_in(sizes.s##n));

/* Updates `sizes` elements from `starts` on of up to six parts. Nothing happens unless *stop is 0.
 */
PARTS_GROUP __kernel void adam_step(PART(0), PART(1), PART(2), PART(3), PART(4), PART(5),
                                    const uint8 starts, const uint8 sizes, const float4 betas,
                                    const float8 corrections, const float epsilon,
                                    const float8 steps, __global const int *stop)
{
    if (*stop != 0)
        return;
    const size_t group = get_group_id(0);
    uint first_group = 0, part_group = 0;
    Factors by = {betas, 0.0f, epsilon, 0.0f};
    __global float *parameter = parameter0, *first = first0, *second = second0;
    __global const float *gradient = gradient0;
    uint total = 0;
    CHOOSE_PART(0)
    CHOOSE_PART(1)
    CHOOSE_PART(2)
    CHOOSE_PART(3)
    CHOOSE_PART(4)
    CHOOSE_PART(5)
    const size_t vector = item_of_part(part_group);
    if (vector >= vectors_in(total))
        return;
    State s = load_state(parameter, first, second, vector, total);
    update(&s, load_lanes(gradient, vector, total), by);
    store_state(&s, parameter, first, second, vector, total);
}

/* Lanes of the vector from `element` to `last` that lie in marked rows of WIDTH elements. */
static inline iv marked_lanes(__global const int *marks, const uint element, const uint last)
{
    int numbers[VEC];
    for (int lane = 0; lane < VEC; ++lane)
        numbers[lane] = lane;
    const iv lane = LOAD_V(0, numbers);
    iv marked = (iv)(0);
    for (uint row = element / WIDTH; row <= last / WIDTH; ++row) {
        const int begin = (int)(row * WIDTH - element);
        if (marks[row] != 0)
            marked |= (lane >= (iv)(begin)) & (lane < (iv)(begin + WIDTH));
    }
    return marked;
}

/* As adam_step, but only for marked rows; the others keep parameters and moments. */
__kernel void adam_step_rows(__global float *parameter, __global const float *gradient,
                             __global float *first, __global float *second, const uint total,
                             const float4 betas, const float correction, const float epsilon,
                             const float step, __global const int *stop, __global const int *marks)
{
    const size_t vector = get_global_id(0);
    if (vector >= vectors_in(total) || *stop != 0)
        return;
    const uint element = (uint)vector * VEC, last = min(element + VEC, total) - 1;
    int any_marked = 0;
    for (uint row = element / WIDTH; row <= last / WIDTH; ++row)
        any_marked |= marks[row];
    if (any_marked == 0)
        return;
    const iv marked = marked_lanes(marks, element, last);
    const Factors by = {betas, correction, epsilon, step};
    const State old = load_state(parameter, first, second, vector, total);
    State s = old;
    update(&s, load_lanes(gradient, vector, total), by);
    s.parameter = marked ? s.parameter : old.parameter;
    s.first = marked ? s.first : old.first;
    s.second = marked ? s.second : old.second;
    store_state(&s, parameter, first, second, vector, total);
}

/* Moves a running mean to the parameters by a share of the way. Nothing happens unless *stop is 0.
 */
__kernel void adam_average(__global float *mean, __global const float *parameter, const uint total,
                           const float share, __global const int *stop)
{
    const size_t vector = get_global_id(0);
    if (vector >= vectors_in(total) || *stop != 0)
        return;
    const fv old = load_lanes(mean, vector, total);
    const fv way = load_lanes(parameter, vector, total) - old;
    store_lanes(old + way * share, vector, mean, total);
}

#ifndef ELEMENTS_PER_ITEM
#define ELEMENTS_PER_ITEM 256
#endif
#define SIGN_OFF 0x7fffffff
#define INFINITE 0x7f800000

/* The largest size, as the bits of a float, of the elements of an item: neighbouring ones on a CPU,
 * each of a group's work-items one in turn on a GPU. */
static inline int largest_of(__global const float *values, const size_t item, const uint total)
{
#if USE_LOCAL
    const size_t lane = item % PARTS_GROUP_SIZE, step = PARTS_GROUP_SIZE;
#else
    const size_t lane = 0, step = 1;
#endif
    const size_t first = (item - lane) * ELEMENTS_PER_ITEM;
    const size_t end = min(first + step * ELEMENTS_PER_ITEM, (size_t)total);
    int largest = 0;
    for (size_t i = first + lane; i < end; i += step) {
        const int size = as_int(values[i]) & SIGN_OFF;
        largest = size > largest ? size : largest;
    }
    return largest;
}

/* The work-groups after those of other arrays belong to array n, if it has elements. */
#define CHOOSE_ARRAY(n)                                                                            \
    if (group >= first_group) {                                                                    \
        array_group = first_group;                                                                 \
        values = values##n;                                                                        \
        total = sizes.s##n;                                                                        \
    }                                                                                              \
    first_group += groups_of((sizes.s##n + ELEMENTS_PER_ITEM - 1) / ELEMENTS_PER_ITEM);

/* Sets a bit of *stop if an element of up to five arrays is infinite or NaN. */
PARTS_GROUP __kernel void adam_check(__global const float *values0, __global const float *values1,
                                     __global const float *values2, __global const float *values3,
                                     __global const float *values4, const uint8 sizes,
                                     __global int *stop)
{
    const size_t group = get_group_id(0);
    uint first_group = 0, array_group = 0;
    __global const float *values = values0;
    uint total = 0;
    CHOOSE_ARRAY(0)
    CHOOSE_ARRAY(1)
    CHOOSE_ARRAY(2)
    CHOOSE_ARRAY(3)
    CHOOSE_ARRAY(4)
    const size_t item = item_of_part(array_group);
    if (largest_of(values, item, total) >= INFINITE)
        atomic_or(stop, NOT_FINITE);
}

/* As adam_check, and marks[row] = 1 if an element of the row is not zero, else 0. */
__kernel void adam_mark(__global const float *values, const uint rows, __global int *stop,
                        __global int *marks)
{
    const size_t row = get_global_id(0);
    if (row >= rows)
        return;
    int largest = 0;
    for (size_t i = 0; i < WIDTH; ++i) {
        const int size = as_int(values[row * WIDTH + i]) & SIGN_OFF;
        largest = size > largest ? size : largest;
    }
    marks[row] = largest != 0;
    if (largest >= INFINITE)
        atomic_or(stop, NOT_FINITE);
}
