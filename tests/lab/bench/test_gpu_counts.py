"""The plugin that counts for a GPU, on kernels whose counts are known by hand."""

from __future__ import annotations

import json
import os
import re
import sys
from pathlib import Path
from subprocess import run

import pytest

ROOT = Path(__file__).resolve().parents[3]
FOLDER = ROOT / "scripts" / "gpu_counts"
if not FOLDER.is_dir():
    pytest.skip("needs a checkout", allow_module_level=True)
pytestmark = pytest.mark.slow

PROGRAM = """
__kernel void coalesced(__global const float *x, __global float *y)
{
    const int i = (int)get_global_id(0);
    y[i] = x[i];
}
__kernel void strided(__global const float *x, __global float *y)
{
    const int i = (int)get_global_id(0);
    y[i] = x[8 * i];
}
__kernel void vectors(__global const float *x, __global float *y)
{
    const int i = (int)get_global_id(0);
    vstore4(vload4((size_t)i, x), (size_t)i, y);
}
__kernel void shared(__global const float *x, __global float *y)
{
    __local float values[1024];
    const int i = (int)get_local_id(0);
    values[2 * i] = x[i];
    barrier(CLK_LOCAL_MEM_FENCE);
    y[i] = values[31 * 2 - 2 * i] + values[0];
}
__kernel void counting(__global const float *x, __global float *y)
{
    __local int number[2];
    const int i = (int)get_local_id(0);
    if (i < 2)
        number[i] = 0;
    barrier(CLK_LOCAL_MEM_FENCE);
    atomic_inc(&number[i % 2]);
    barrier(CLK_LOCAL_MEM_FENCE);
    y[i] = (float)number[0];
}
__kernel void divergent(__global const float *x, __global float *y)
{
    const int i = (int)get_global_id(0) % 32;
    float sum = 0.0f;
#pragma unroll 1
    for (int k = 0; k < i; ++k)
        sum = fma(sum, x[0], x[1]);
    y[get_global_id(0)] = sum;
}
__kernel void alternating(__global const float *x, __global float *y)
{
    const int i = (int)get_local_id(0);
#pragma unroll 1
    for (int k = 0; k < 8; ++k)
        if ((i + k) % 2)
            y[i + 32 * k] = 1.0f;
}
__kernel void negated(__global const float *x, __global float *y)
{
    const int i = (int)get_global_id(0);
    const float4 v = (float4)(1.0f, -1.0f, 1.0f, -1.0f) * (1.0f + x[i]);
    const float4 w = (float4)(3.0f, 3.0f, -3.0f, -3.0f) + 0.0f * x[i];
    const int4 none = v < (float4)(0.0f);
    const float4 chosen = none ? (float4)(16.0f) : (w > (float4)(0.0f) ? w : (float4)(0.0f));
    y[i] = chosen.x + chosen.y + chosen.z + chosen.w;
}
__kernel void missing(__global const float *x, __global float *y)
{
    const int i = (int)get_global_id(0);
    const uint word = as_uint(x[i]);
    y[i] = (float)(popcount(word) + abs((int)word) + (int)rotate(word, 3u) + (int)clz(word));
}
"""
KERNELS = re.findall(r"__kernel void (\w+)", PROGRAM)

DRIVER = """
import sys
import numpy as np, pyopencl as cl
device = next(d for p in cl.get_platforms() if "clgrind" in p.name for d in p.get_devices())
context = cl.Context([device])
queue = cl.CommandQueue(context)
program = cl.Program(context, open(sys.argv[1]).read()).build()
x, y = (cl.Buffer(context, cl.mem_flags.READ_WRITE, 4096) for _ in range(2))
cl.enqueue_copy(queue, x, np.linspace(0, 1, 1024, dtype=np.float32))
for name in sys.argv[2:]:
    cl.Kernel(program, name)(queue, (64,), (32,), x, y)
    if name == "negated":
        found = np.empty(64, np.float32)
        cl.enqueue_copy(queue, found, y)
        assert (found == 35).all(), found
queue.finish()
"""


@pytest.fixture(scope="module")
def counts(tmp_path_factory):
    """The plugin's sums of each kernel: two work-groups of a warp each."""
    sys.path.insert(0, str(FOLDER))
    try:
        import oclgrind
    finally:
        sys.path.remove(str(FOLDER))
    if lacks := oclgrind.missing():
        pytest.skip(f"needs {', '.join(lacks)}")
    folder = tmp_path_factory.mktemp("gpu_counts")
    (folder / "program.cl").write_text(PROGRAM, encoding="utf-8")
    plugin, file = oclgrind.build(folder), folder / "counts.jsonl"
    environment = oclgrind.environment(folder, plugin, file)
    command = [sys.executable, "-c", DRIVER, str(folder / "program.cl"), *KERNELS]
    run(command, check=True, env={**os.environ, **environment})
    found = [json.loads(line) for line in file.read_text(encoding="utf-8").splitlines()]
    assert [one["kernel"] for one in found] == KERNELS
    return {one["kernel"]: one["sums"] for one in found}


def some(sums, *names):
    return tuple(sums.get(name, 0) for name in names)


def read(sums):
    return some(sums, "global_asked_read", "global_used_read", "global_sectors_read")


def test_a_coalesced_warp_touches_four_sectors(counts):
    assert read(counts["coalesced"]) == (256, 256, 8)
    assert counts["coalesced"]["global_sectors_written"] == 8
    assert counts["coalesced"]["global_requests"] == 4
    assert counts["coalesced"]["global_wavefronts"] == 4
    assert some(counts["coalesced"], "work_items", "work_groups") == (64, 2)


def test_a_stride_of_a_sector_touches_one_for_every_lane(counts):
    assert read(counts["strided"]) == (256, 256, 64)
    assert counts["strided"]["global_wavefronts"] == 2 * 8 + 2


def test_unaligned_vectors_are_requests_of_their_elements_to_the_same_sectors(counts):
    assert read(counts["vectors"]) == (1024, 1024, 32)
    assert counts["vectors"]["global_requests"] == 2 * 2 * 4
    assert counts["vectors"]["global_wavefronts"] == 2 * 2 * 4 * 4


def test_compulsory_bytes_are_those_of_the_whole_launch(counts):
    assert some(counts["shared"], "compulsory_read", "compulsory_written") == (128, 128)
    assert some(counts["strided"], "compulsory_read", "compulsory_written") == (256, 256)
    assert counts["divergent"]["compulsory_read"] == 8
    assert counts["divergent"]["group_sectors_read"] == 2


def test_a_stride_of_two_words_conflicts_twice_and_a_broadcast_never(counts):
    sums = counts["shared"]
    assert sums["local_requests"] == 2 * 3
    assert sums["local_wavefronts"] == 2 * (2 + 2 + 1)
    assert sums["local_ideal_wavefronts"] == 2 * 3
    assert sums["barriers"] == 2


def test_atomics_on_one_word_wait_for_each_other(counts):
    sums = counts["counting"]
    assert sums["local_atomics"] == 64
    assert sums["local_wavefronts"] == 2 * (1 + 16 + 1)


def test_loops_of_different_lengths_diverge(counts):
    sums = counts["divergent"]
    assert sums["lane_operations"] == 2 * 2 * sum(range(32))
    assert sums["warp_operations"] == 2 * 2 * 31
    assert 32 * sums["warp_instructions"] > 1.5 * sums["lane_instructions"]
    assert 32 * counts["coalesced"]["warp_instructions"] == counts["coalesced"]["lane_instructions"]


def test_lanes_that_take_turns_do_not_run_together(counts):
    assert counts["alternating"]["global_requests"] == 2 * 8
    assert counts["alternating"]["global_sectors_written"] == 2 * 8 * 4
    assert counts["alternating"]["global_used_written"] == 2 * 8 * 16 * 4
