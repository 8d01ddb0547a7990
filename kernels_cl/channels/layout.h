/* Pictures of any number of channels: what Gaussians have per channel, and what their entries of
 * tile lists leave in the backward pass.
 *
 * A launch takes CHANNELS colors of the `pitch` that a Gaussian has, from number `first` on; images
 * are (height, width, channels). */
#ifndef CLGS_CHANNELS_LAYOUT_H
#define CLGS_CHANNELS_LAYOUT_H

#ifndef CHANNELS
#define CHANNELS 3
#endif
#ifndef WITH_DEPTH
#define WITH_DEPTH 0 /* whether the depth is one more channel, after the colors */
#endif
#ifndef WITH_ABSOLUTE
#define WITH_ABSOLUTE 0 /* whether absolute gradients by centres are summed, too */
#endif
#define ALL_CHANNELS (CHANNELS + WITH_DEPTH)

/* Moments of an entry: the sums of v y1, v y2, v y1^2, v y1 y2, v y2^2 and v over the pixels of the
 * tile, with v = alpha dL/d(alpha); |dL/d(centre)| by x and y; w dL/d(channel), w = alpha T. */
#define MOMENT_ALPHA 5
#define MOMENT_ABSOLUTE 6
#define MOMENT_CHANNEL (MOMENT_ABSOLUTE + 2 * WITH_ABSOLUTE)
#define MOMENTS (MOMENT_CHANNEL + ALL_CHANNELS)
#define MOMENT_PITCH ((MOMENTS + 7) / 8 * 8)

/* What a launch blends: colors (Gaussians, pitch) and depths (Gaussians). */
typedef struct {
    __global const float *color, *depth;
    int first, pitch;
} Palette;

static inline void load_channels(const Palette *p, const int gaussian, float value[ALL_CHANNELS])
{
    __global const float *own = p->color + (size_t)p->pitch * (size_t)gaussian + (size_t)p->first;
#pragma unroll
    for (int c = 0; c < CHANNELS; ++c)
        value[c] = own[c];
#if WITH_DEPTH
    value[CHANNELS] = p->depth[gaussian];
#endif
}

#endif
