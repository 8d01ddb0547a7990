"""The seeded bugs of ``mutation_check.py``: one textual change each."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Mutation:
    """``old`` becomes ``new`` wherever it is in ``file``, which must be ``times`` times.

    stage: whose tests have to notice; what: the bug.
    """

    stage: str
    what: str
    file: str
    old: str
    new: str
    times: int = 1


PROJECT = "kernels_cl/gaussian/project.cl"
PROJECTION = "kernels_cl/gaussian/projection.h"
PROJECTED = "kernels_cl/gaussian/projected_gaussians.h"
ELLIPSES = "kernels_cl/common/ellipses.h"
TOUCH = "kernels_cl/blend/touch.h"
PIXELS = "kernels_cl/blend/pixels.h"
RAYS = "kernels_cl/blend/rays.h"
LOSS = "kernels_cl/loss/forward.cl"

MUTATIONS = (
    Mutation(
        "project",
        "gradient through the clamped slope of the Jacobian",
        PROJECT,
        "p->clamped[axis] == p->slope[axis] ? d_clamped[axis] : (fv)(0.0f)",
        "d_clamped[axis]",
    ),
    Mutation(
        "project",
        "factor 2 of the off-diagonal moment",
        PROJECT,
        "m12 = d_factor[1] * factor[0] / factor[2]",
        "m12 = 2.0f * d_factor[1] * factor[0] / factor[2]",
    ),
    Mutation(
        "project",
        "no blur in the determinant",
        PROJECTION,
        "fma(p->blur, xx + yy + p->blur, dot3(p->minor, p->minor))",
        "dot3(p->minor, p->minor)",
    ),
    Mutation(
        "project",
        "determinant by subtraction",
        PROJECTION,
        "fma(p->blur, xx + yy + p->blur, dot3(p->minor, p->minor))",
        "p->cov_xx * p->cov_yy - p->cov_xy * p->cov_xy",
    ),
    Mutation(
        "project",
        "box of three sigma",
        PROJECTED,
        "sqrt(2.0f * log_v(opacity / ALPHA_CUT))",
        "3.0f",
    ),
    Mutation(
        "project",
        "the near plane itself is drawn",
        PROJECTED,
        "(p->z > (fv)(camera[CAMERA_NEAR]))",
        "(p->z >= (fv)(camera[CAMERA_NEAR]))",
    ),
    Mutation(
        "blend",
        "a cut that NaN passes",
        TOUCH,
        "t.touched = exponent >= c->cut;",
        "t.touched = !(exponent < c->cut);",
    ),
    Mutation(
        "blend",
        "transmittance not divided on the way back",
        RAYS,
        "p->transmittance = p->transmittance / (1.0f - alpha)",
        "p->transmittance = p->transmittance * (1.0f - alpha)",
    ),
    Mutation(
        "blend",
        "suffix with the rounding of a difference of whole sums",
        RAYS,
        "const fv change = color - p->behind",
        "const fv change = color - ((p->behind * p->transmittance + 4.0f) - 4.0f) / "
        "p->transmittance",
    ),
    Mutation(
        "blend",
        "no gradient by way of the background",
        "kernels_cl/blend/backward_cpu.cl",
        "fma(rays->d_red, (fv)(background[0]),",
        "0.0f * fma(rays->d_red, (fv)(background[0]),",
    ),
    Mutation(
        "blend",
        "record that crosses the transmittance stop is blended",
        PIXELS,
        "weight = stops ? (fv)(0.0f) : weight;",
        "",
    ),
    Mutation(
        "blend",
        "backward pass beyond the last contributor",
        RAYS,
        "t->touched & ((iv)(number) <= p->last)",
        "t->touched",
    ),
    Mutation(
        "blend",
        "gradient of a saturated alpha",
        RAYS,
        "t->saturated ? (fv)(0.0f) : weight * change",
        "weight * change",
    ),
    Mutation(
        "sort",
        "keys of 16 bits",
        "kernels_cl/sort/group_digit.h",
        "used ? items->keys[i] : 0u",
        "used ? items->keys[i] & 0xffff0000u : 0u",
    ),
    Mutation(
        "sort",
        "the next digit is counted in chunks of this pass",
        "kernels_cl/sort/group_digit.h",
        "to / next_chunk * DIGITS",
        "to / items->chunk * DIGITS",
    ),
    Mutation(
        "sort",
        "keys of the segment before are not ranked",
        "kernels_cl/sort/group_digit.h",
        "s < segment ? bits : s == segment",
        "s + 1 < segment ? bits : s == segment",
    ),
    Mutation(
        "sort",
        "histograms of later passes are not cleared",
        "kernels_cl/sort/group_digit.h",
        "number == 0 ? counter[item] : 0;",
        "number == 0 ? counter[item] : 1;",
    ),
    Mutation(
        "tiles",
        "sums of parts of 16 bits",
        "kernels_cl/scan/part_sums.h",
        "sum >> 16",
        "0",
    ),
    Mutation(
        "tiles",
        "padding is left out where entries are more than Gaussians",
        "kernels_cl/tiles/lists_gpu.cl",
        "if (rank < capacity && (!fits",
        "if (rank < ordered[0] && (!fits",
    ),
    Mutation(
        "cull",
        "the last group leaves no sum of its part",
        "kernels_cl/scan/part_sums.h",
        "if (item == 0)\n        sums",
        "if (item == 0 && first + GROUP_SIZE < (size_t)count)\n        sums",
    ),
    Mutation(
        "tiles",
        "three sigma in the test of tiles",
        ELLIPSES,
        "e.reach = sqrt(fma(limit, (fv)(1.00001f), (fv)(1e-5f))) + error;",
        "e.reach = (fv)(3.0f * WHITENING_UNIT);",
    ),
    Mutation(
        "tiles",
        "first column of a span on the row of the last one",
        "kernels_cl/tiles/footprints.h",
        "clamp_lanes(-f->tip, top, bottom)",
        "clamp_lanes(f->tip, top, bottom)",
    ),
    Mutation(
        "tiles",
        "tiles of a row where their first spans end",
        "kernels_cl/tiles/lists_cpu.cl",
        "--next[span.x + span.y];",
        "--next[span.x + 1];",
    ),
    Mutation(
        "blend",
        "three sigma in the test of units",
        ELLIPSES,
        "e.squared = e.reach * e.reach * 1.00001f * inverse;",
        "e.squared = 9.0f * WHITENING_UNIT * WHITENING_UNIT * inverse;",
    ),
    Mutation(
        "sort",
        "highest bit of the keys left out",
        "kernels_cl/sort/chosen_cpu.cl",
        "(bits + 1) / 2",
        "bits / 2",
    ),
    Mutation(
        "growth",
        "slots that were seen just often enough ask",
        "kernels_cl/anchors/growth.cl",
        "times > seen && gradient_sum",
        "times >= seen && gradient_sum",
    ),
    Mutation(
        "growth",
        "an anchor whose opacity is not a number stays",
        "kernels_cl/anchors/growth.cl",
        "!(opacity_sum[anchor] >= least * (float)visits[anchor])",
        "opacity_sum[anchor] < least * (float)visits[anchor]",
    ),
    Mutation(
        "growth",
        "keys whose hash is that of another count as taken",
        "clgs/train/density/voxel_grid.py",
        "near[place] == keys",
        "table[_hashes(keys)]",
    ),
    Mutation(
        "scan",
        "total of 32 bits",
        "kernels_cl/scan/offsets_cpu.cl",
        "total[0] = all",
        "total[0] = (int)all",
    ),
    Mutation(
        "scan",
        "total of 32 bits, GPU form",
        "kernels_cl/scan/offsets_gpu.cl",
        "total[0] = all",
        "total[0] = (int)all",
    ),
    Mutation(
        "scan",
        "offsets one item late",
        "kernels_cl/scan/offsets_cpu.cl",
        "offsets[i] = fits ? (int)carry : 0;",
        "offsets[i] = fits ? (int)(carry + counts[i]) : 0;",
    ),
    Mutation(
        "adam",
        "no bias correction",
        "clgs/ops/adam.py",
        "step=learning_rate / (1.0 - BETA1**count)",
        "step=learning_rate",
    ),
    Mutation(
        "loss",
        "variances about zero",
        LOSS,
        "return rint(128.0f * (range.xz - range.yw)) / 256.0f;",
        "return (float2)(0.0f);",
    ),
    Mutation(
        "loss",
        "window not restored at the rim",
        LOSS,
        "const fv missing = 1.0f - covered;",
        "const fv missing = 0.0f * covered;",
    ),
    Mutation(
        "rate",
        "standard deviation taken as the scale of the Laplace law",
        "clgs/ops/rate.py",
        "b = np.sqrt(0.5 * (sums.square",
        "b = np.sqrt(1.0 * (sums.square",
    ),
    Mutation(
        "quantize",
        "halves away from zero",
        "kernels_cl/anchors/quantize.cl",
        "rint(load_lanes(x, vector, total) * q);",
        "round(load_lanes(x, vector, total) * q);",
    ),
    Mutation(
        "neural",
        "gradient of a clamped log scale",
        "kernels_cl/gaussian/neural.cl",
        "return fabs(log_scale) <= LOG_SCALE_LIMIT ? d : 0.0f;",
        "return d;",
    ),
    Mutation(
        "mlp",
        "gradient through an inactive unit",
        "kernels_cl/mlp/block/backward.h",
        "const fv d = active > (fv)(0.0f) ? sum[o][s] : (fv)(0.0f);",
        "const fv d = active >= (fv)(0.0f) ? sum[o][s] : (fv)(0.0f);",
    ),
    Mutation(
        "mlp",
        "weight gradient without the first block of a run",
        "kernels_cl/mlp/backward_cpu.cl",
        "add_run(&vectors, block * VECTORS, (block + 1) * VECTORS)",
        "add_run(&vectors, block * VECTORS + 1, (block + 1) * VECTORS)",
    ),
    Mutation(
        "mlp",
        "a tile of the weight gradient that asks for the slot of its first row alone",
        "kernels_cl/mlp/weight_tile.h",
        "tile.slots |= 1 << (first + o) / slot_rows(head);",
        "tile.slots |= 1 << first / slot_rows(head);",
    ),
    Mutation(
        "density",
        "gradient norm in pixels",
        "kernels_cl/anchors/density.cl",
        "vload2(first + i, d_mean2d) * half_size",
        "vload2(first + i, d_mean2d) * 1.0f",
    ),
    Mutation(
        "density",
        "anchors counted in the order of the view",
        "kernels_cl/anchors/density.cl",
        "visible[slot[n] / K_OFFSETS] * K_OFFSETS",
        "(slot[n] / K_OFFSETS) * K_OFFSETS",
    ),
    Mutation(
        "cull",
        "the extent that counts towards the smallest anchor has the blur in it",
        "kernels_cl/anchors/cull.cl",
        "36.0f * (largest - (fv)(BLUR))",
        "36.0f * largest",
    ),
    Mutation(
        "decode",
        "the opacity of the first slot for all",
        "kernels_cl/gaussian/project_anchors.cl",
        "opaque[m] = sample[j * rows->stride]",
        "opaque[m] = sample[0]",
    ),
)
