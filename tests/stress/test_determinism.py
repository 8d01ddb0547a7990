"""The same bits from any number of threads, work-group, vectors and form: family N29."""

from __future__ import annotations

import os
import subprocess
import sys
from itertools import product
from pathlib import Path

import pytest

from tests.small_scene import write_scene
from tests.stress.hash_worker import set_group_size, training

ROOT = Path(__file__).resolve().parents[2]
THREADS = (1, 2, 4)
GROUPS = (64, 32)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return write_scene(tmp_path_factory.mktemp("balls"))


def hash_of(folder, what, specialisation, threads, group, lanes, steps):
    """What ``hash_worker`` prints in a process of its own."""
    arguments = [str(folder), what, specialisation, str(group), str(steps)]
    done = subprocess.run(
        [sys.executable, "-m", "tests.stress.hash_worker", *arguments],
        cwd=ROOT,
        env={**os.environ, "POCL_MAX_PTHREAD_COUNT": str(threads), "CLGS_LANES": str(lanes)},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr[-500:]
    digest = done.stdout.strip()
    assert len(digest) == 64
    return digest


def hashes(folder, what, specialisation, steps, cases):
    return {hash_of(folder, what, specialisation, *case, steps) for case in cases}


LANES = (16, 8)
ALL = list(product(THREADS, GROUPS, LANES))
FEW = [(1, 64, 16), (4, 32, 8)]


FORMS = ("cpu", "gpu")


def hashes_of_forms(folder, what, steps, cases):
    return set().union(*(hashes(folder, what, form, steps, cases) for form in FORMS))


@pytest.mark.slow
@pytest.mark.family("N29")
def test_gradients_have_one_hash(folder):
    """Three repeats in each process."""
    assert len(hashes_of_forms(folder, "gradients", 3, FEW)) == 1


@pytest.mark.slow
@pytest.mark.family("N29")
def test_training_has_one_hash(folder):
    both = hashes(folder, "training", "cpu", 40, FEW) | hashes(
        folder, "training", "gpu", 40, FEW[:1]
    )
    assert len(both) == 1


@pytest.mark.release
@pytest.mark.family("N29")
def test_gradients_have_one_hash_on_all(folder):
    assert len(hashes_of_forms(folder, "gradients", 10, ALL)) == 1


@pytest.mark.release
@pytest.mark.family("N29")
def test_500_steps_have_one_hash(folder):
    both = hashes(folder, "training", "cpu", 500, ALL) | hashes(folder, "training", "gpu", 500, FEW)
    assert len(both) == 1


@pytest.mark.slow
@pytest.mark.family("N29")
def test_another_number_of_steps_has_other_bits(folder, open_device):
    one, other = (training(open_device("cpu"), folder, steps) for steps in (2, 3))
    assert one[-1] != other[-1]


@pytest.mark.family("N29")
def test_group_sizes_change():
    changed = set_group_size(64)
    assert {"adam", "blend", "neural", "project", "tiles"} <= set(changed)
