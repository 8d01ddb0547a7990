#include "splats.h"

#include <string.h>

#include "clgs_codec.h"
#include "common/bytes.h"
#include "harmonics.h"
#include "memory.h"
#include "vectors.h"

#define WRONG "the file's splats are damaged; copy the file again"
#define HEAD 20
#define NONE SIZE_MAX
#define SAMPLE 2048 /* splats that tell where all lie, and how large they are */

/* As clgs/data/splats/gaussians.py decides. */
#define NEAR_PLANE 0.2
#define LEAST_SPREAD 2.0
#define GREATEST_SPREAD 40.0
#define FINE 0x1p14 /* a position may be off by 2^-10 of a splat, and float has 24 bits */

static const char *const NAMES[NEEDED] = {"f_dc_0",  "f_dc_1",  "f_dc_2",  "opacity",
                                          "scale_0", "scale_1", "scale_2", "rot_0",
                                          "rot_1",   "rot_2",   "rot_3"};

static int is_name(const uint8_t *at, size_t length, const char *name)
{
    for (size_t i = 0; i < length; i++)
        if (at[i] != (uint8_t)name[i] || name[i] == 0)
            return 0;
    return name[length] == 0;
}

/* The number after "f_rest_", NONE for other names. */
static size_t rest_number(const uint8_t *at, size_t length)
{
    size_t number = 0;
    if (length < 8 || length > 9 || !is_name(at, 7, "f_rest_"))
        return NONE;
    for (size_t i = 7; i < length; i++) {
        if (at[i] < '0' || at[i] > '9')
            return NONE;
        number = 10 * number + at[i] - '0';
    }
    return number < MAX_REST ? number : NONE;
}

/* Note where property `p` of this name is needed. */
static void note_name(splats *s, size_t p, const uint8_t *at, size_t length)
{
    for (size_t i = 0; i < NEEDED; i++)
        if (is_name(at, length, NAMES[i]))
            s->column[i] = p;
    if (is_name(at, length, "antialiased"))
        s->antialiased = p;
    size_t rest = rest_number(at, length);
    if (rest != NONE)
        s->column[REST + rest] = p;
}

/* The properties' names; the steps are read when they are needed. */
static problem read_names(splats *s)
{
    span head = s->file->section[SPLT];
    size_t at = HEAD, known = 0;
    s->antialiased = NONE;
    for (size_t i = 0; i < REST + MAX_REST; i++)
        s->column[i] = NONE;
    for (size_t p = 0; p < s->properties; p++) {
        size_t length = at + 9 <= head.size ? head.data[at + 8] : NONE;
        if (length == NONE || length > head.size - at - 9)
            return WRONG;
        note_name(s, p, head.data + at + 9, length);
        at += 9 + length;
    }
    for (size_t i = 0; i < NEEDED; i++)
        if (s->column[i] == NONE)
            return "the splats lack colors, opacities, scales or rotations; pack a 3DGS file";
    while (known < MAX_REST && s->column[REST + known] != NONE)
        known++;
    s->rest = known >= 45 ? 15 : known >= 24 ? 8 : known >= 9 ? 3 : 0;
    return at == head.size ? NULL : WRONG;
}

problem splats_open(const container *file, splats *result, size_t *steps)
{
    *result = (splats){.file = file};
    span head = file->section[SPLT];
    if (head.size < HEAD)
        return WRONG;
    result->count = clgs_load32(head.data);
    result->voxels = clgs_load32(head.data + 4);
    result->properties = clgs_load32(head.data + 8) & 0xFFFF;
    result->expected_hash = clgs_load64(head.data + 12);
    if (result->properties < 4 || result->properties > CLGS_MAX_CHANNELS + 3 ||
        result->voxels > result->count ||
        result->count > ((uint64_t)1 << 30) / (result->properties - 3))
        return WRONG;
    problem wrong = read_names(result);
    if (!wrong)
        wrong = rows_open(file->section[SATR], result->count, result->properties - 3,
                          &result->attribute);
    if (wrong)
        return wrong;
    result->position = memory_take(12 * result->count + 4);
    result->all.integer = memory_take(4 * result->properties * result->count + 4);
    *steps = result->attribute.chunks + 2;
    return result->position && result->all.integer ? NULL : NO_MEMORY;
}

/* The positions of all splats: those of the voxels, as often as these hold splats. */
static problem read_positions(splats *s)
{
    size_t mark = memory_mark(), row = 0;
    int32_t *position = memory_take(12 * s->voxels + 4), *more = memory_take(4 * s->voxels + 4);
    rows multiple;
    if (!position || !more)
        return NO_MEMORY;
    problem wrong = positions_read(s->file->section[SPOS], s->voxels, position);
    if (!wrong)
        wrong = rows_open(s->file->section[SMUL], s->voxels, 1, &multiple);
    for (size_t at = 0; !wrong && at < s->voxels;) {
        size_t count = rows_next(&multiple);
        wrong = rows_read(&multiple, more + at);
        at += count;
    }
    for (size_t v = 0; !wrong && v < s->voxels; v++) {
        if (more[v] < 0 || (size_t)more[v] >= s->count - row)
            return WRONG;
        for (int32_t i = 0; i <= more[v]; i++, row++)
            memcpy(s->all.integer + s->properties * row, position + 3 * v, 12);
    }
    memory_release(mark);
    return wrong ? wrong : row == s->count ? NULL : WRONG;
}

static problem read_rows(splats *s)
{
    size_t mark = memory_mark(), count = rows_next(&s->attribute), width = s->properties - 3;
    int32_t *chunk = memory_take(4 * width * count);
    if (!chunk)
        return NO_MEMORY;
    problem wrong = rows_read(&s->attribute, chunk);
    for (size_t i = 0; i < count; i++, s->row++)
        memcpy(s->all.integer + s->properties * s->row + 3, chunk + width * i, 4 * width);
    memory_release(mark);
    return wrong;
}

static double median(double *value, size_t count)
{
    for (size_t gap = count / 2; gap > 0; gap /= 2)
        for (size_t i = gap; i < count; i++) {
            double moved = value[i];
            size_t to = i;
            for (; to >= gap && value[to - gap] > moved; to -= gap)
                value[to] = value[to - gap];
            value[to] = moved;
        }
    return value[count / 2];
}

/* The steps of all properties, to `step`. */
static void read_steps(const splats *s, double *step)
{
    const uint8_t *at = s->file->section[SPLT].data + HEAD;
    for (size_t p = 0; p < s->properties; p++, at += 9 + at[8])
        step[p] = load_double(at);
}

/* Choose origin and near plane by some of the splats, evenly chosen. */
static void place(splats *s, const double *step)
{
    static double value[SAMPLE], middle[3];
    const size_t every = (s->count + SAMPLE - 1) / SAMPLE, count = s->count / every;
    double furthest = 0, *end = value + count;
    for (size_t axis = 0; axis < 3; axis++) {
        for (size_t i = 0; i < count; i++)
            value[i] = s->all.integer[s->properties * every * i + axis] * step[axis];
        middle[axis] = median(value, count);
        double away = middle[axis] < 0 ? -middle[axis] : middle[axis];
        furthest = away > furthest ? away : furthest;
    }
    for (size_t i = 0; i < count; i++) {
        const int32_t *row = s->all.integer + s->properties * every * i;
        value[i] = 0;
        for (size_t axis = 0; axis < 3; axis++) {
            double apart = row[axis] * step[axis] - middle[axis];
            value[i] += apart * apart;
        }
    }
    double spread = __builtin_sqrt(median(value, count));
    double usual = spread < LEAST_SPREAD ? LEAST_SPREAD : spread;
    usual = usual > GREATEST_SPREAD ? GREATEST_SPREAD : usual;
    s->near = (float)(spread > 0 ? NEAR_PLANE * spread / usual : NEAR_PLANE);
    for (double *to = value; to < end; to++) {
        const int32_t *row = s->all.integer + s->properties * every * (size_t)(to - value);
        *to = row[s->column[SIZE]] * step[s->column[SIZE]];
        for (size_t k = 1; k < 3; k++) {
            double size = row[s->column[SIZE + k]] * step[s->column[SIZE + k]];
            *to = size > *to ? size : *to;
        }
    }
    const float log_size = (float)median(value, count);
    float size[4] = {log_size < LOG_SCALE_LIMIT ? log_size : LOG_SCALE_LIMIT};
    store4(size, exp4(load4(size)));
    for (size_t axis = 0; axis < 3; axis++)
        s->origin[axis] = furthest > FINE * size[0] ? middle[axis] : 0;
}

/* Compare the hash, then integers times steps in place. */
static problem finish(splats *s)
{
    static double steps[CLGS_MAX_CHANNELS + 3];
    s->hash = clgs_xxh64((const uint8_t *)s->all.integer, 4 * s->properties * s->count);
    if (s->hash != s->expected_hash)
        return "the decoded integers do not match their hash; copy the file again";
    read_steps(s, steps);
    s->near = (float)NEAR_PLANE;
    if (s->count > 0)
        place(s, steps);
    for (size_t p = 0; p < s->properties; p++) {
        const double origin = p < 3 ? s->origin[p] : 0;
        for (size_t i = 0; i < s->count; i++) {
            int32_t *at = s->all.integer + s->properties * i + p;
            if (p == s->antialiased && *at != 0)
                s->keeps_light = 1;
            float value = (float)(*at * steps[p] - origin);
            memcpy(at, &value, sizeof value);
            if (p < 3)
                s->position[3 * i + p] = value;
        }
    }
    return NULL;
}

problem splats_step(splats *s)
{
    size_t step = s->step++;
    if (step == 0)
        return read_positions(s);
    return step <= s->attribute.chunks ? read_rows(s) : finish(s);
}

static void set_color(const splats *s, const float *row, const float direction[3], float color[3])
{
    float basis[1 + MAX_REST / 3];
    harmonics(direction, basis);
    for (size_t c = 0; c < 3; c++) {
        float sum = 0.5f + basis[0] * row[s->column[COLOR + c]];
        for (size_t k = 0; k < s->rest; k++)
            sum += basis[1 + k] * row[s->column[REST + s->rest * c + k]];
        color[c] = sum > 0 ? sum : 0;
    }
}

void splats_add(const splats *s, size_t first, size_t count, const float centre[3], float alpha_cut,
                gaussians *to)
{
    const v4 limit = all4(LOG_SCALE_LIMIT);
    for (size_t i = first; i < first + count; i++) {
        const float *row = s->all.value + s->properties * i;
        float direction[3], raw[4] = {0, 0, 0, -row[s->column[OPACITY]]};
        gaussian one;
        memcpy(one.mean, row, sizeof one.mean);
        for (size_t k = 0; k < 3; k++)
            raw[k] = row[s->column[SIZE + k]];
        for (size_t k = 0; k < 4; k++)
            one.rotation[k] = row[s->column[ROTATION + k]];
        store4(raw, exp4(min4(max4(load4(raw), -limit), limit)));
        one.opacity = 1 / (1 + raw[3]);
        if (!(one.opacity >= alpha_cut))
            continue;
        memcpy(one.scale, raw, sizeof one.scale);
        direction_to(centre, one.mean, direction);
        set_color(s, row, direction, one.color);
        gaussians_add(to, &one);
    }
}
