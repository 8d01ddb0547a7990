/* Project 3-D Gaussians to the screen: EWA splatting in whitened form.
 *
 * The blurred 2-D covariance is never inverted. Its Cholesky factor is carried instead:
 *     y1 = dx * r1,  y2 = (dy - l * dx) * r2,  power = (y1^2 + y2^2) / 2
 * and the determinant is a sum of positive terms (Cauchy-Binet): both stay accurate for needles
 * that are 1e5 times longer than wide, where the conic form loses all digits.
 */
#include "include/real.h"
#include "include/camera.h"
#include "include/vector3.h"

#ifndef BLUR
#define BLUR 0.3f
#endif
#ifndef ALPHA_CUT
#define ALPHA_CUT 0.00392156886f
#endif

#define FINITE_LIMIT 1e30f

typedef struct {
    float3 point;   /* camera space */
    float2 slope;   /* x/z, y/z */
    float2 clamped; /* the same, inside the slope limits of the camera */
    float3 axis_x;  /* rows of (camera rotation)(Gaussian rotation) */
    float3 axis_y;
    float3 axis_z;
    float3 scale;
    float2 focal_on_z; /* fx/z, fy/z */
    float3 a;          /* rows of the 2x3 factor J W R S, divided by unit */
    float3 b;
    float3 minor; /* its 2x2 minors (columns yz, zx, xy), divided by unit^2 */
    float unit;   /* largest entry of a and b, at least 1: keeps squares finite */
    float cov_xx; /* blurred covariance, divided by unit^2 */
    float cov_xy;
    float cov_yy;
    float det;  /* divided by unit^4 */
    float blur; /* BLUR / unit^2 */
} Splat;

inline float3 row3(__global const float *camera, int row)
{
    return (float3)(camera[CAMERA_ROTATION + 3 * row], camera[CAMERA_ROTATION + 3 * row + 1],
                    camera[CAMERA_ROTATION + 3 * row + 2]);
}

/* Rows of the rotation matrix of a unit quaternion q = (w, x, y, z) stored as (x, y, z, w). */
inline void quaternion_rows(float4 q, float3 *r0, float3 *r1, float3 *r2)
{
    *r0 = (float3)(1.0f - 2.0f * fma(q.y, q.y, q.z * q.z), 2.0f * fma(q.x, q.y, -q.w * q.z),
                   2.0f * fma(q.x, q.z, q.w * q.y));
    *r1 = (float3)(2.0f * fma(q.x, q.y, q.w * q.z), 1.0f - 2.0f * fma(q.x, q.x, q.z * q.z),
                   2.0f * fma(q.y, q.z, -q.w * q.x));
    *r2 = (float3)(2.0f * fma(q.x, q.z, -q.w * q.y), 2.0f * fma(q.y, q.z, q.w * q.x),
                   1.0f - 2.0f * fma(q.x, q.x, q.y * q.y));
}

inline float4 load_quaternion(__global const float *rotation, size_t i)
{
    return (float4)(rotation[4 * i + 1], rotation[4 * i + 2], rotation[4 * i + 3], rotation[4 * i]);
}

inline void place(Splat *s, float3 mean, __global const float *camera)
{
    s->point = (float3)(dot3(row3(camera, 0), mean) + camera[CAMERA_TRANSLATION],
                        dot3(row3(camera, 1), mean) + camera[CAMERA_TRANSLATION + 1],
                        dot3(row3(camera, 2), mean) + camera[CAMERA_TRANSLATION + 2]);
    s->slope = s->point.xy / s->point.z;
    __global const float *limits = camera + CAMERA_SLOPE_LIMITS;
    s->clamped = (float2)(s->slope.x < limits[0] ? limits[0] : s->slope.x,
                          s->slope.y < limits[2] ? limits[2] : s->slope.y);
    s->clamped = (float2)(s->clamped.x > limits[1] ? limits[1] : s->clamped.x,
                          s->clamped.y > limits[3] ? limits[3] : s->clamped.y);
    s->focal_on_z = (float2)(camera[CAMERA_FX], camera[CAMERA_FY]) / s->point.z;
}

inline void orient(Splat *s, float4 quaternion, __global const float *camera)
{
    float3 r0, r1, r2;
    quaternion_rows(quaternion, &r0, &r1, &r2);
    const float3 w0 = row3(camera, 0), w1 = row3(camera, 1), w2 = row3(camera, 2);
    s->axis_x = w0.x * r0 + w0.y * r1 + w0.z * r2;
    s->axis_y = w1.x * r0 + w1.y * r1 + w1.z * r2;
    s->axis_z = w2.x * r0 + w2.y * r1 + w2.z * r2;
}

/* The 2x3 factor, the covariance and its determinant; all divided by powers of unit. */
inline void spread(Splat *s)
{
    const float3 stretch_x = s->focal_on_z.x * s->scale;
    const float3 stretch_y = s->focal_on_z.y * s->scale;
    const float3 a = stretch_x * (s->axis_x - s->clamped.x * s->axis_z);
    const float3 b = stretch_y * (s->axis_y - s->clamped.y * s->axis_z);
    const float3 larger = fmax(fabs(a), fabs(b));
    s->unit = fmax(1.0f, fmax(larger.x, fmax(larger.y, larger.z)));
    s->a = a / s->unit;
    s->b = b / s->unit;
    /* the viewing ray (u, v, 1) in the splat's axes */
    const float3 ray = s->clamped.x * s->axis_x + s->clamped.y * s->axis_y + s->axis_z;
    const float3 p = stretch_x / s->unit, q = stretch_y / s->unit;
    s->minor = (float3)(p.y * q.z, p.z * q.x, p.x * q.y) * ray;
    s->blur = BLUR / s->unit / s->unit;
    const float xx = dot3(s->a, s->a), yy = dot3(s->b, s->b);
    s->cov_xx = xx + s->blur;
    s->cov_xy = dot3(s->a, s->b);
    s->cov_yy = yy + s->blur;
    s->det = fma(s->blur, xx + yy + s->blur, dot3(s->minor, s->minor));
}

inline Splat make_splat(__global const float *mean, __global const float *scale,
                        __global const float *rotation, __global const float *camera, size_t i)
{
    Splat s;
    s.scale = load3(scale, i);
    place(&s, load3(mean, i), camera);
    orient(&s, load_quaternion(rotation, i), camera);
    spread(&s);
    return s;
}

inline float3 whiten(const Splat *s)
{
    const float r1 = 1.0f / sqrt(s->cov_xx) / s->unit;
    const float r2 = sqrt(s->cov_xx / s->det) / s->unit;
    return (float3)(r1, s->cov_xy / s->cov_xx, r2);
}

/* Half-widths of the box outside of which alpha < ALPHA_CUT, pixels. */
inline float2 half_widths(const Splat *s, float opacity)
{
    const float reach = sqrt(2.0f * log_s(opacity / ALPHA_CUT)) * s->unit;
    return reach * (float2)(sqrt(s->cov_xx), sqrt(s->cov_yy));
}

inline bool overlaps_image(float2 centre, float2 extent, __global const float *camera)
{
    return centre.x + extent.x > 0.0f && centre.y + extent.y > 0.0f &&
           centre.x - extent.x < camera[CAMERA_WIDTH] &&
           centre.y - extent.y < camera[CAMERA_HEIGHT];
}

/* Whether (w, x, y, z) is close enough to a unit quaternion to be one; NaN is not. */
inline bool is_rotation(float4 q)
{
    const float square = fma(q.w, q.w, fma(q.z, q.z, fma(q.y, q.y, q.x * q.x)));
    return square > 0.99f && square < 1.01f;
}

/* One work-item a Gaussian. A culled one gets extent 0 and zeros elsewhere. */
__kernel void project_forward(__global const float *mean, __global const float *scale,
                              __global const float *rotation, __global const float *opacity,
                              __global const float *camera, const int count, __global float *mean2d,
                              __global float *whitening, __global float *depth,
                              __global float *extent)
{
    const size_t i = get_global_id(0);
    if (i >= (size_t)count)
        return;
    const Splat s = make_splat(mean, scale, rotation, camera, i);
    const float2 centre = s.slope * (float2)(camera[CAMERA_FX], camera[CAMERA_FY]) +
                          (float2)(camera[CAMERA_CX], camera[CAMERA_CY]);
    const float3 factor = whiten(&s);
    const float2 box = half_widths(&s, opacity[i]);
    const bool drawn =
        s.point.z > camera[CAMERA_NEAR] && s.point.z < FINITE_LIMIT && opacity[i] >= ALPHA_CUT &&
        opacity[i] < FINITE_LIMIT && is_rotation(load_quaternion(rotation, i)) && factor.x > 0.0f &&
        factor.x < FINITE_LIMIT && fabs(factor.y) < FINITE_LIMIT && factor.z > 0.0f &&
        factor.z < FINITE_LIMIT && overlaps_image(centre, box, camera) &&
        fabs(centre.x) < FINITE_LIMIT && fabs(centre.y) < FINITE_LIMIT;
    mean2d[2 * i] = drawn ? centre.x : 0.0f;
    mean2d[2 * i + 1] = drawn ? centre.y : 0.0f;
    store3(drawn ? factor : (float3)(0.0f), whitening, i);
    depth[i] = drawn ? s.point.z : 0.0f;
    extent[2 * i] = drawn ? box.x : 0.0f;
    extent[2 * i + 1] = drawn ? box.y : 0.0f;
}

/* Columns of the whitened factor: (r1 a_k, r2 (b_k - l a_k)). The difference is a sum of minors,
 * which keeps its digits where the two terms almost cancel. */
inline void whitened_columns(const Splat *s, float3 factor, float3 *first, float3 *second)
{
    *first = factor.x * s->unit * s->a;
    const float3 a = s->a, m = s->minor;
    const float3 sum =
        (float3)(fma(a.z, m.y, -a.y * m.z), fma(a.x, m.z, -a.z * m.x), fma(a.y, m.x, -a.x * m.y));
    *second = factor.z * s->unit * (sum + s->blur * s->b) / s->cov_xx;
}

/* dL/dq for q = (w, x, y, z), from dL/dR given by rows. */
inline float4 quaternion_gradient(float4 q, float3 d0, float3 d1, float3 d2)
{
    const float w = 2.0f * (q.x * (d2.y - d1.z) + q.y * (d0.z - d2.x) + q.z * (d1.x - d0.y));
    const float x = 2.0f * (q.y * (d0.y + d1.x) + q.z * (d0.z + d2.x) + q.w * (d2.y - d1.z) -
                            2.0f * q.x * (d1.y + d2.z));
    const float y = 2.0f * (q.x * (d0.y + d1.x) + q.z * (d1.z + d2.y) + q.w * (d0.z - d2.x) -
                            2.0f * q.y * (d0.x + d2.z));
    const float z = 2.0f * (q.x * (d0.z + d2.x) + q.y * (d1.z + d2.y) + q.w * (d1.x - d0.y) -
                            2.0f * q.z * (d0.x + d1.y));
    return (float4)(w, x, y, z);
}

/* dL/d(camera-space point) from the screen position and from the factor (a, b). */
inline float3 point_gradient(const Splat *s, float2 d_mean2d, float3 d_a, float3 d_b,
                             float d_log_size, __global const float *camera)
{
    const float3 depth_part = s->scale * s->axis_z;
    const float d_clamped_x = -s->focal_on_z.x * dot3(depth_part, d_a);
    const float d_clamped_y = -s->focal_on_z.y * dot3(depth_part, d_b);
    const float d_slope_x =
        fma(d_mean2d.x, camera[CAMERA_FX], s->clamped.x == s->slope.x ? d_clamped_x : 0.0f);
    const float d_slope_y =
        fma(d_mean2d.y, camera[CAMERA_FY], s->clamped.y == s->slope.y ? d_clamped_y : 0.0f);
    return (float3)(d_slope_x, d_slope_y,
                    -(d_log_size + fma(s->slope.x, d_slope_x, s->slope.y * d_slope_y))) /
           s->point.z;
}

/* One work-item a Gaussian; the mirror of project_forward. */
__kernel void project_backward(__global const float *mean, __global const float *scale,
                               __global const float *rotation, __global const float *camera,
                               const int count, __global const float *whitening,
                               __global const float *extent, __global const float *d_mean2d,
                               __global const float *d_whitening, __global float *d_mean,
                               __global float *d_scale, __global float *d_rotation)
{
    const size_t i = get_global_id(0);
    if (i >= (size_t)count)
        return;
    if (!(extent[2 * i] > 0.0f)) {
        store3((float3)(0.0f), d_mean, i);
        store3((float3)(0.0f), d_scale, i);
        vstore4((float4)(0.0f), i, d_rotation);
        return;
    }
    const Splat s = make_splat(mean, scale, rotation, camera, i);
    const float3 factor = load3(whitening, i);
    const float3 d_factor = load3(d_whitening, i);
    /* sums of alpha dL/d(alpha) y y^T over the pixels */
    const float m11 = -d_factor.x * factor.x;
    const float m12 = d_factor.y * factor.x / factor.z;
    const float m22 = -d_factor.z * factor.z;
    float3 first, second;
    whitened_columns(&s, factor, &first, &second);
    const float3 d_first = m11 * first + m12 * second;
    const float3 d_second = m12 * first + m22 * second;
    const float3 d_a = factor.x * d_first - factor.y * factor.z * d_second;
    const float3 d_b = factor.z * d_second;
    const float3 d_log_scale = first * d_first + second * d_second;

    const float3 along_a = s.focal_on_z.x * s.scale * d_a;
    const float3 along_b = s.focal_on_z.y * s.scale * d_b;
    const float3 along_z = -s.clamped.x * along_a - s.clamped.y * along_b;
    const float3 w0 = row3(camera, 0), w1 = row3(camera, 1), w2 = row3(camera, 2);
    const float4 d_quaternion = quaternion_gradient(
        load_quaternion(rotation, i), w0.x * along_a + w1.x * along_b + w2.x * along_z,
        w0.y * along_a + w1.y * along_b + w2.y * along_z,
        w0.z * along_a + w1.z * along_b + w2.z * along_z);
    const float d_log_size = d_log_scale.x + d_log_scale.y + d_log_scale.z;
    const float2 d_centre = (float2)(d_mean2d[2 * i], d_mean2d[2 * i + 1]);
    const float3 d_point = point_gradient(&s, d_centre, d_a, d_b, d_log_size, camera);
    store3(w0 * d_point.x + w1 * d_point.y + w2 * d_point.z, d_mean, i);
    store3(select(d_log_scale / s.scale, (float3)(0.0f), s.scale == 0.0f), d_scale, i);
    vstore4(d_quaternion, i, d_rotation);
}
