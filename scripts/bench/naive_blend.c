/* Blending as one would write it first: every pixel walks the list of its tile. For comparison. */
#include <math.h>
#include <string.h>

#define TILE 16
#define ALPHA_CUT (1.0f / 255.0f)
#define ALPHA_MAX 0.99f
#define STOP 1e-4f
#define ROW 9

typedef struct {
    int width, height;
    const int *tile_range, *gaussian;
    const float *mean2d, *whitening, *color, *opacity, *background;
} Scene;

typedef struct {
    float dx, dy, y1, y2, falloff, alpha;
} Hit;

static inline Hit hit_of(const Scene *s, int g, float x, float y)
{
    const float *w = s->whitening + 3 * g;
    Hit h;
    h.dx = x - s->mean2d[2 * g];
    h.dy = y - s->mean2d[2 * g + 1];
    h.y1 = h.dx * w[0];
    h.y2 = (h.dy - w[1] * h.dx) * w[2];
    h.falloff = expf(-0.5f * (h.y1 * h.y1 + h.y2 * h.y2));
    h.alpha = fminf(ALPHA_MAX, s->opacity[g] * h.falloff);
    return h;
}

static void forward_pixel(const Scene *s, int tile, int x, int y, float *image,
                          float *transmittance, int *last)
{
    const size_t at = (size_t)y * s->width + x, plane = (size_t)s->width * s->height;
    const int first = s->tile_range[tile], end = s->tile_range[tile + 1];
    float t = 1.0f, red = 0.0f, green = 0.0f, blue = 0.0f;
    last[at] = 0;
    for (int k = first; k < end; ++k) {
        const int g = s->gaussian[k];
        const Hit h = hit_of(s, g, x + 0.5f, y + 0.5f);
        if (h.alpha < ALPHA_CUT)
            continue;
        const float after = t * (1.0f - h.alpha);
        if (after < STOP)
            break;
        const float weight = h.alpha * t;
        red += weight * s->color[3 * g];
        green += weight * s->color[3 * g + 1];
        blue += weight * s->color[3 * g + 2];
        t = after;
        last[at] = k - first + 1;
    }
    image[at] = red + t * s->background[0];
    image[at + plane] = green + t * s->background[1];
    image[at + 2 * plane] = blue + t * s->background[2];
    transmittance[at] = t;
}

void naive_forward(const Scene *s, float *image, float *transmittance, int *last)
{
    const int columns = (s->width + TILE - 1) / TILE, rows = (s->height + TILE - 1) / TILE;
#pragma omp parallel for schedule(dynamic, 1)
    for (int tile = 0; tile < columns * rows; ++tile) {
        const int x0 = tile % columns * TILE, y0 = tile / columns * TILE;
        for (int y = y0; y < y0 + TILE && y < s->height; ++y)
            for (int x = x0; x < x0 + TILE && x < s->width; ++x)
                forward_pixel(s, tile, x, y, image, transmittance, last);
    }
}

static void backward_pixel(const Scene *s, int tile, int x, int y, float t, int last,
                           const float *d_image, float *sums)
{
    const size_t at = (size_t)y * s->width + x, plane = (size_t)s->width * s->height;
    const float d[3] = {d_image[at], d_image[at + plane], d_image[at + 2 * plane]};
    const int first = s->tile_range[tile];
    float behind = d[0] * s->background[0] + d[1] * s->background[1] + d[2] * s->background[2];
    for (int k = first + last - 1; k >= first; --k) {
        const int g = s->gaussian[k];
        const Hit h = hit_of(s, g, x + 0.5f, y + 0.5f);
        if (h.alpha < ALPHA_CUT)
            continue;
        const float *c = s->color + 3 * g, *w = s->whitening + 3 * g;
        float *row = sums + ROW * (size_t)(k - first);
        t = t / (1.0f - h.alpha);
        const float weight = h.alpha * t;
        const float shade = c[0] * d[0] + c[1] * d[1] + c[2] * d[2];
        const float d_alpha = t * (shade - behind);
        behind = behind + h.alpha * (shade - behind);
        row[5] += weight * d[0];
        row[6] += weight * d[1];
        row[7] += weight * d[2];
        if (h.alpha >= ALPHA_MAX)
            continue;
        const float v = h.alpha * d_alpha;
        row[0] += v * (h.y1 * w[0] - h.y2 * w[1] * w[2]);
        row[1] += v * h.y2 * w[2];
        row[2] -= v * h.y1 * h.dx;
        row[3] += v * h.y2 * h.dx * w[2];
        row[4] -= v * h.y2 * (h.dy - w[1] * h.dx);
        row[8] += h.falloff * d_alpha;
    }
}

/* rows: (entries, ROW), entry k at its place in the list; place: the entries of every Gaussian,
 * from place_range[g] on; gradients: (N, ROW). */
void naive_backward(const Scene *s, const float *transmittance, const int *last,
                    const float *d_image, const int *place, const int *place_range, int count,
                    float *rows, float *gradients)
{
    const int columns = (s->width + TILE - 1) / TILE, tile_rows = (s->height + TILE - 1) / TILE;
#pragma omp parallel for schedule(dynamic, 1)
    for (int tile = 0; tile < columns * tile_rows; ++tile) {
        const int x0 = tile % columns * TILE, y0 = tile / columns * TILE;
        const int first = s->tile_range[tile], end = s->tile_range[tile + 1];
        float *sums = rows + ROW * (size_t)first;
        memset(sums, 0, sizeof(float) * ROW * (size_t)(end - first));
        for (int y = y0; y < y0 + TILE && y < s->height; ++y)
            for (int x = x0; x < x0 + TILE && x < s->width; ++x) {
                const size_t at = (size_t)y * s->width + x;
                backward_pixel(s, tile, x, y, transmittance[at], last[at], d_image, sums);
            }
    }
#pragma omp parallel for schedule(static)
    for (int g = 0; g < count; ++g)
        for (int j = 0; j < ROW; ++j) {
            float sum = 0.0f;
            for (int i = place_range[g]; i < place_range[g + 1]; ++i)
                sum += rows[ROW * (size_t)place[i] + j];
            gradients[ROW * (size_t)g + j] = sum;
        }
}
