"""More seeded bugs of ``mutation_check.py``: those that only the GPU form of the kernels has.

In files that both forms share, USE_LOCAL, 1 in the GPU form and 0 in the other, keeps a bug to it.
A missing barrier where PoCL has one of its own, at the start, the turn or the end of a loop that
holds barriers, shows under Oclgrind alone: ``race_check.sh``.
"""

from __future__ import annotations

from mutations import Mutation

BLEND_FORWARD = "kernels_cl/blend/forward_gpu.cl"
BLEND_BACKWARD = "kernels_cl/blend/backward_gpu.cl"
UNITS = "kernels_cl/blend/units.h"
LAYER = "kernels_cl/mlp/group/layer.h"
GROUP_INPUTS = "kernels_cl/mlp/group/inputs.h"
ORDER = "kernels_cl/mlp/order_gpu.cl"
MLP_FORWARD = "kernels_cl/mlp/forward_gpu.cl"
MLP_BACKWARD = "kernels_cl/mlp/backward_gpu.cl"
GROUP = "kernels_cl/loss/group.h"
PIXEL_SUMS = "kernels_cl/loss/pixel_sums.h"
EXPOSURE = "kernels_cl/loss/exposure.cl"
RATE = "kernels_cl/anchors/rate.cl"
DENSITY = "kernels_cl/anchors/density.cl"

BARRIER = "    barrier(CLK_LOCAL_MEM_FENCE);\n"

BLEND = (
    Mutation(
        "blend",
        "GPU form: the last record of a list is not staged",
        BLEND_FORWARD,
        "if (k < end)",
        "if (k < end - 1)",
    ),
    Mutation(
        "blend",
        "GPU form: the last record of a full batch is not blended",
        BLEND_FORWARD,
        "? end : begin + BATCH;",
        "? end : begin + BATCH - 1;",
    ),
    Mutation(
        "blend",
        "GPU form: a work-item's unit is one bit off",
        BLEND_FORWARD,
        "unit_bit(item / UNIT_SIZE)",
        "unit_bit(item / UNIT_SIZE + 1)",
    ),
    Mutation(
        "blend",
        "GPU form: a unit's last row of pixels is not asked what it touches",
        UNITS,
        "for (int row = 0; row < UNIT_HEIGHT; ++row) {",
        "for (int row = 0; row < UNIT_HEIGHT - USE_LOCAL; ++row) {",
    ),
    Mutation(
        "blend",
        "GPU form: a tile is finished as soon as its first warp is",
        BLEND_FORWARD,
        "if (p.stop > 0.0f)",
        "if (p.stop > 0.0f && item < 32)",
    ),
    Mutation(
        "blend",
        "GPU form: contributors counted from the batch on, not from the list on",
        BLEND_FORWARD,
        "&t, k - first + 1);",
        "&t, k - begin + 1);",
    ),
    Mutation(
        "blend",
        "GPU form: one record too few staged, backwards",
        BLEND_BACKWARD,
        "if (item < RECORD_VECTORS * count)",
        "if (item < RECORD_VECTORS * (count - 1))",
    ),
    Mutation(
        "blend",
        "GPU form: the last contributor of a tile left out",
        BLEND_BACKWARD,
        "min(first + shared.last, end)",
        "min(first + max(shared.last - 1, 0), end)",
    ),
    Mutation(
        "blend",
        "GPU form: the last contributor of the first warp counts for the tile",
        BLEND_BACKWARD,
        "    atomic_max(&shared.last, p.last);",
        "    if (item < 32)\n        atomic_max(&shared.last, p.last);",
    ),
    Mutation(
        "blend",
        "GPU form: the row of the first entry past the contributors is not cleared",
        BLEND_BACKWARD,
        "k >= lit; --k)",
        "k > lit; --k)",
    ),
    Mutation(
        "blend",
        "GPU form: the last round of a batch dropped",
        BLEND_BACKWARD,
        "write_rows(&shared, i, round_end, rows);",
        "if (round_end < batch)\n                write_rows(&shared, i, round_end, rows);",
    ),
    Mutation(
        "blend",
        "GPU form: the last record of a round is given no blocks",
        BLEND_BACKWARD,
        "shared->end = i;",
        "shared->end = i + (i < count);",
    ),
    Mutation(
        "blend",
        "GPU form: a round takes one block more than there are",
        BLEND_BACKWARD,
        "if (after > ROUND_BLOCKS)",
        "if (after > ROUND_BLOCKS + 1)",
    ),
    Mutation(
        "blend",
        "GPU form: rows of moments past the first pass of a long round left out",
        BLEND_BACKWARD,
        "i < (end - begin) * ROW_USED; i += TILE_PIXELS",
        "i < min((end - begin) * ROW_USED, TILE_PIXELS); i += TILE_PIXELS",
    ),
    Mutation(
        "blend",
        "GPU form: sums without the last unit that a record touches",
        BLEND_BACKWARD,
        "count > 0; --count",
        "count > 1; --count",
    ),
    Mutation(
        "blend",
        "GPU form: units after a pixel's own counted as before it, so that blocks change order",
        BLEND_BACKWARD,
        "units_before = ~(0xffffffffu >> pixel->unit)",
        "units_before = 0x7fffffffu >> pixel->unit",
    ),
    Mutation(
        "blend",
        "GPU form: blocks added up before all of them are there",
        BLEND_BACKWARD,
        "            " + BARRIER.lstrip() + "            write_rows(",
        "            write_rows(",
    ),
    Mutation(
        "blend",
        "GPU form: lanes added up in another order than the CPU form's",
        "kernels_cl/common/lanes.h",
        "const float4 four = (a + c) + (b + d);",
        "const float4 four = (a + b) + (c + d);",
    ),
)

MLP = (
    Mutation(
        "mlp",
        "GPU form: gradient through an inactive unit",
        MLP_BACKWARD,
        "sum[u][i] = hidden[u][i] > 0.0f ? sum[u][i] : 0.0f;",
        "sum[u][i] = hidden[u][i] >= 0.0f ? sum[u][i] : 0.0f;",
    ),
    Mutation(
        "mlp",
        "GPU form: a layer without the inputs of its last slice",
        LAYER,
        "for (int input = 0; input < inputs; input += SLICE) {",
        "for (int input = 0; input + SLICE <= inputs; input += SLICE) {",
    ),
    Mutation(
        "mlp",
        "GPU form: a share of the units that the layer fills in part is left out",
        LAYER,
        "if (own_share() * units < weights->count)",
        "if ((own_share() + 1) * units <= weights->count)",
    ),
    Mutation(
        "mlp",
        "GPU form: the direction to an anchor may be infinite",
        GROUP_INPUTS,
        "for (int k = 0; k < INPUT_DIM; ++k)\n        finite",
        "for (int k = 0; k < FEATURE_DIM; ++k)\n        finite",
    ),
    Mutation(
        "mlp",
        "GPU form: rows listed as if every slot had one",
        GROUP_INPUTS,
        "? j * each + own - count",
        "? j + own - count",
    ),
    Mutation(
        "mlp",
        "GPU form: slots that the first warp alone asks for",
        GROUP_INPUTS,
        "get_local_id(0) < SAMPLES && sample < end",
        "get_local_id(0) < 32 && sample < end",
    ),
    Mutation(
        "mlp",
        "GPU form: slots of a group without its last sample, backwards",
        MLP_BACKWARD,
        "first + (size_t)samples, outputs.stride",
        "first + (size_t)samples - 1, outputs.stride",
    ),
    Mutation(
        "mlp",
        "GPU form: opacities of the padding cleared in one pass alone",
        MLP_FORWARD,
        "i < K_OFFSETS * SAMPLES; i += LAYER_ITEMS) /* padding */",
        "i < LAYER_ITEMS; i += LAYER_ITEMS) /* padding */",
    ),
    Mutation(
        "mlp",
        "GPU form: samples sorted before all keys are there",
        ORDER,
        BARRIER,
        "",
    ),
    Mutation(
        "mlp",
        "GPU form: equal samples change places",
        ORDER,
        "keys[other] == keys[i] && other < i",
        "keys[other] == keys[i] && other > i",
    ),
    Mutation(
        "mlp",
        "GPU form: samples that draw nothing counted as active",
        ORDER,
        "keys[other] < KEY_NONE ? 1 : 0",
        "keys[other] <= KEY_NONE ? 1 : 0",
    ),
    Mutation(
        "mlp",
        "GPU form: the last, partial pass over a chunk moves no sample",
        ORDER,
        "i < samples; i += GROUP_SIZE) {\n        int rank",
        "i < samples / GROUP_SIZE * GROUP_SIZE; i += GROUP_SIZE) {\n        int rank",
    ),
    Mutation(
        "mlp",
        "GPU form: the first batch's number of active samples for all of a launch",
        MLP_BACKWARD,
        "batch = first_batch + sample / BATCH;",
        "batch = first_batch;",
    ),
    Mutation(
        "mlp",
        "GPU form: rows of slots that nobody draws keep what an earlier batch left",
        MLP_BACKWARD,
        "if ((slots >> row / each & 1) == 0)",
        "if ((slots >> row / each & 1) == 0 && row < each)",
    ),
    Mutation(
        "mlp",
        "GPU form: a sample that is not finite in the gradient of the bias",
        MLP_BACKWARD,
        "i / SAMPLES < INPUT_DIM || value == 1.0f",
        "i / SAMPLES <= INPUT_DIM || value == 1.0f",
    ),
    Mutation(
        "mlp",
        "GPU form: weight gradient without the last, partial step over a batch",
        MLP_BACKWARD,
        "v < samples; v += SUM_LANES",
        "v < samples / SUM_LANES * SUM_LANES; v += SUM_LANES",
    ),
    Mutation(
        "mlp",
        "GPU form: weight gradient without the last column tile of a pass",
        MLP_BACKWARD,
        "i < steps * SUMS; i += GROUP_SIZE",
        "i < (steps - 1) * SUMS; i += GROUP_SIZE",
    ),
    Mutation(
        "mlp",
        "GPU form: gradients of the first HIDDEN_DIM outputs of a head alone",
        MLP_BACKWARD,
        "for (int begin = 0; begin < count; begin += HIDDEN_DIM) {",
        "for (int begin = 0; begin < min(count, HIDDEN_DIM); begin += HIDDEN_DIM) {",
    ),
    Mutation(
        "mlp",
        "GPU form: gradients by the inputs read before all of them are there",
        MLP_BACKWARD,
        "group->x);\n" + BARRIER,
        "group->x);\n",
    ),
    Mutation(
        "mlp",
        "GPU form: active samples of a later launch taken from the first one",
        MLP_BACKWARD,
        "samples = active_samples(batch, padded, active);\n    const WeightTile",
        "samples = active_samples((int)get_group_id(1), padded, active);\n    const WeightTile",
    ),
    Mutation(
        "mlp",
        "GPU form: padding cleared past the end of a row",
        MLP_FORWARD,
        "            if (first + (size_t)(i % SAMPLES) < stride)\n    ",
        "        ",
    ),
    Mutation(
        "mlp",
        "GPU form: lanes added up in another order than the CPU form's",
        "kernels_cl/common/lanes.h",
        "sum[i] = lanes[i] + lanes[i + SUM_LANES / 2];",
        "sum[i] = lanes[2 * i] + lanes[2 * i + 1];",
    ),
)

OTHERS = (
    Mutation(
        "loss",
        "GPU form: a reduction without the second half of the group",
        GROUP,
        "int reach = ITEMS / 2;",
        "int reach = ITEMS / 4;",
    ),
    Mutation(
        "loss",
        "GPU form: pixels outside of the image keep what was staged there",
        PIXEL_SUMS,
        "pixels[pixel] = 0.0f;",
        "pixels[pixel] += 0.0f;",
    ),
    Mutation(
        "loss",
        "GPU form: sums of a patch without its last row",
        PIXEL_SUMS,
        "row < PATCH_ROWS && ITEM",
        "row < PATCH_ROWS - 1 && ITEM",
    ),
    Mutation(
        "loss",
        "GPU form: columns blurred before all rows are",
        "kernels_cl/loss/window.h",
        "    SYNC();\n",
        "",
    ),
    Mutation(
        "loss",
        "GPU form: maps moved to shifts that are not there yet",
        "kernels_cl/loss/backward.cl",
        "(own.y - own.x);\n    }\n    SYNC();\n",
        "(own.y - own.x);\n    }\n",
    ),
    Mutation(
        "exposure",
        "GPU form: a map's gradient without the last, partial step over the pixels",
        EXPOSURE,
        "begin + lane; pixel < end;",
        "begin + lane; pixel < end / SUM_LANES * SUM_LANES;",
    ),
    Mutation(
        "exposure",
        "GPU form: lanes added up before all of them are there",
        EXPOSURE,
        "    SYNC();\n",
        "",
    ),
    Mutation(
        "rate",
        "GPU form: the last symbol of a channel is not counted",
        RATE,
        "if (vector * VEC >= total)\n            break;\n        sum +=",
        "if ((vector + USE_LOCAL) * VEC >= total)\n            break;\n        sum +=",
    ),
    Mutation(
        "rate",
        "GPU form: the last, partial work-group of an attribute belongs to the next one",
        "kernels_cl/common/parts.h",
        "(items + get_local_size(0) - 1)",
        "(items + (USE_LOCAL ? 0 : get_local_size(0) - 1))",
    ),
    Mutation(
        "density",
        "GPU form: all work-groups add the Gaussians of the first one",
        "kernels_cl/common/items.h",
        "return get_global_id(0);",
        "return get_local_id(0);",
    ),
    Mutation(
        "density",
        "GPU form: the last element of a derivative left out",
        DENSITY,
        "if (vector * VEC >= (size_t)total)",
        "if ((vector + USE_LOCAL) * VEC >= (size_t)total)",
    ),
)

GPU_MUTATIONS = (*BLEND, *MLP, *OTHERS)
