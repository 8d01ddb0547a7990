#!/usr/bin/env python3
"""Did a change of the sources change a bit? Record before it, check after it.

    scripts/checks/same_bits.py record FILE [--data FOLDER]
    scripts/checks/same_bits.py check FILE [--data FOLDER]

FOLDER, by default shared/data next to the checkout, holds the capture fox/ and the arrays of
codec/. Recorded are the hashes of ``clgs conformance`` in both forms of the kernels. A training run
of 120 steps of fox at an eighth of its size, on one and on two threads, gives the hash of every
section of its file and of every decoded array. Every array of codec/ gives the bytes that each
level codes it in. Gradients depend on the lanes of the device, so compare on a device of the same
kind. Exit code 1 if anything differs.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import os
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

import numpy as np

import clgs
from clgs import codec
from clgs.codec.sections import read_container

ROOT = Path(__file__).resolve().parents[2]
ATTRIBUTES = ("position", "offset", "feature", "scaling")
LEVELS = ("fast", "default", "max", "paper")
STEPS, DOWNSCALE = 120, 8

Hashes = Iterator[tuple[str, str]]


def sha256(data: bytes) -> str:
    """The hash that is compared, with the length, which tells more of a difference."""
    return f"{len(data)} {hashlib.sha256(data).hexdigest()}"


def run_clgs(*arguments: object, **environment: str) -> None:
    """Run a command of clgs; it prints to standard error."""
    command = [sys.executable, "-m", "clgs", *map(str, arguments)]
    subprocess.run(command, env={**os.environ, **environment}, check=True, stdout=sys.stderr)


def conformance(work: Path) -> Hashes:
    """Every tensor in both forms of the kernels."""
    for form in ("cpu", "gpu"):
        record = work / f"{form}.json"
        run_clgs("conformance", "-o", record, CLGS_SPECIALISATION=form)
        for one in json.loads(record.read_text(encoding="utf-8"))["tensors"]:
            yield f"{form}: {one['scene']} {one['stage']} {one['tensor']}", one["sha256"]


def training(work: Path, fox: Path) -> Hashes:
    """Sections and decoded arrays of a short training run."""
    for threads in ("1", "2"):
        run = work / f"fox_{threads}"
        length = "--downscale", DOWNSCALE, "--steps", STEPS
        run_clgs("train", fox, "-o", run, *length, POCL_MAX_PTHREAD_COUNT=threads)
        data = (run / "scene.clgs").read_bytes()
        for tag, section in read_container(data)[1].items():
            yield f"fox, {threads} threads: section {tag}", sha256(section.data)
        scene = clgs.decode(data)
        arrays = {name: getattr(scene.anchors, name) for name in ATTRIBUTES}
        for name, array in {**arrays, "weights": scene.mlps.flat}.items():
            yield f"fox, {threads} threads: decoded {name}", sha256(array.tobytes())


def coded_arrays(folder: Path) -> Hashes:
    """The bytes of every array at every level."""
    for path in sorted(folder.glob("*.npz")):
        with np.load(path, allow_pickle=False) as arrays:
            if "positions" in arrays:
                yield f"{path.stem}", sha256(codec.encode_positions(arrays["positions"]))
            else:
                values = arrays["values"]
                for level in LEVELS:
                    data = codec.encode_attributes(values, level=level)
                    yield f"{path.stem}, {level}", sha256(data)


def main() -> int:
    """Record or check; the exit code."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("action", choices=("record", "check"))
    parser.add_argument("file", type=Path)
    parser.add_argument("--data", type=Path, default=ROOT.parent / "shared" / "data")
    args = parser.parse_args()
    with tempfile.TemporaryDirectory(prefix="clgs-same-bits-") as name:
        work = Path(name)
        found = dict(conformance(work))
        found.update(training(work, args.data / "fox"))
        found.update(coded_arrays(args.data / "codec"))
    if args.action == "record":
        args.file.write_text(json.dumps(found, indent=1) + "\n", encoding="utf-8")
        print(f"{len(found)} hashes recorded")
        return 0
    wanted = json.loads(args.file.read_text(encoding="utf-8"))
    different = [key for key in {**wanted, **found} if wanted.get(key) != found.get(key)]
    for key in different:
        print(f"DIFFERENT: {key}: {wanted.get(key)} became {found.get(key)}")
    print(f"{len(wanted)} hashes recorded, {len(different)} differ")
    return int(bool(different))


if __name__ == "__main__":
    sys.exit(main())
