"""Checkpoints: the whole state of a run in one file, written atomically, the last two kept.

A checkpoint is an .npz file (an uncompressed zip of .npy members, no pickle) with one more
member, ``metadata.json``: format version, configuration digest, scalars, and CRC-32, dtype and
shape of every array. A run that is resumed from it gives the same bits.
"""

from __future__ import annotations

import io
import json
import re
import struct
import tomllib
import warnings
import zipfile
import zlib
from dataclasses import astuple, fields
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from clgs.errors import ClgsError, DataError, ExistsError, is_full
from clgs.files import atomic_path
from clgs.opencl.array import DeviceArray
from clgs.opencl.device import Device
from clgs.ops.adam import Moments
from clgs.ops.density import Statistics
from clgs.ops.rate import Rate
from clgs.render.frame import DeviceScene
from clgs.scene.anchors import FIELDS, Anchors, QuantizationScales
from clgs.train.config import TrainConfig
from clgs.train.config.option import older_values, options_of
from clgs.train.quality.importance import Sensitivity
from clgs.train.state.run_state import (
    ANCHOR_GROUPS,
    ExposureMaps,
    Means,
    Parameters,
    RateState,
    RateTables,
    RunState,
    ViewOrder,
)

FORMAT_VERSION = 1
KEPT = 2
METADATA = "metadata.json"

Arrays = dict[str, npt.NDArray[Any]]
Scalars = dict[str, Any]

DAMAGE = (
    *(OSError, EOFError, ValueError, LookupError, TypeError, AttributeError, OverflowError),
    *(MemoryError, zipfile.BadZipFile, zlib.error, struct.error),
    RuntimeError,  # zipfile: a flag for encryption or another compression method
)
"""What reading a damaged zip, JSON or .npy can raise."""


def save(folder: Path, arrays: Arrays, scalars: Scalars, digest: str) -> Path:
    """Write a checkpoint; returns its path.

    Afterwards all older ones but the newest are removed, and so are those of later steps, which
    a run that went back has abandoned. On a full disk they are removed before.

    Args:
        folder: made if it is missing; holds the checkpoints of one run.
        arrays: by name; any dtype but object.
        scalars: JSON-able, with the number of the last step done under "step".
        digest: of the configuration; :func:`load` asks for the same.

    Raises:
        ClgsError: the file cannot be written; older checkpoints are intact.
    """
    step = int(scalars["step"])
    path = folder / f"step_{step:08d}.npz"
    try:
        folder.mkdir(parents=True, exist_ok=True)
        metadata = {"scalars": scalars, "digest": digest}
        try:
            _write(path, arrays, metadata)
        except OSError as error:
            if not (is_full(error) and _make_room(folder, step)):
                raise
            _write(path, arrays, metadata)
        earlier = [old for old in checkpoints(folder) if old.name < path.name]
        kept = {path, *earlier[-(KEPT - 1) :]}
        for old in (*checkpoints(folder), *folder.glob(".step_*.npz")):
            if old not in kept:
                old.unlink(missing_ok=True)
    except OSError as error:
        raise ClgsError(
            f"{path}: cannot write the checkpoint ({error.strerror or error}); "
            "free space or choose another run folder"
        ) from error
    return path


def load(folder: Path, digest: str, changed: str = "") -> tuple[Arrays, Scalars]:
    """(arrays, scalars) of the newest usable checkpoint; a warning names each damaged one.

    Raises:
        DataError: there is none, all are damaged, or it has another format.
        ExistsError: it has another digest; a DataError, too.
    """
    paths = checkpoints(folder)
    for path in reversed(paths):
        try:
            arrays, scalars, written_for = _read(path)
        except DAMAGE as error:
            warnings.warn(f"{path}: damaged checkpoint ({error}), skipped", stacklevel=2)
            continue
        if written_for != digest:
            raise ExistsError(
                f"{path}: was made with other settings or photos{changed}; "
                "give the same options (config.toml lists them) or choose another run folder"
            )
        return arrays, scalars
    damaged = "its one checkpoint is" if len(paths) == 1 else f"all {len(paths)} checkpoints are"
    found = f"{damaged} damaged" if paths else "no checkpoint"
    raise DataError(f"{folder}: {found}; start the run again")


def checkpoints(folder: Path) -> list[Path]:
    """Paths of the checkpoints in a folder, by step."""
    return sorted(
        path for path in folder.glob("step_*.npz") if re.fullmatch(r"step_\d+", path.stem)
    )


def _write(path: Path, arrays: Arrays, metadata: dict[str, Any]) -> None:
    described = {name: _description(array) for name, array in arrays.items()}
    document = json.dumps({"version": FORMAT_VERSION, **metadata, "arrays": described})
    with (
        atomic_path(path) as temporary,
        zipfile.ZipFile(temporary, "w", zipfile.ZIP_STORED) as archive,
    ):
        archive.writestr(zipfile.ZipInfo(METADATA), document)
        for name, array in arrays.items():
            with archive.open(f"{name}.npy", "w", force_zip64=True) as member:
                np.lib.format.write_array(member, array, allow_pickle=False)


def _read(path: Path) -> tuple[Arrays, Scalars, str]:
    """Arrays, scalars and digest; raises one of DAMAGE or, for another format, DataError."""
    with zipfile.ZipFile(path) as archive:
        for member in archive.infolist():
            if member.compress_type != zipfile.ZIP_STORED:
                raise ValueError(f"{member.filename} is compressed, which no checkpoint is")
        metadata = json.loads(archive.read(METADATA))
        if metadata["version"] != FORMAT_VERSION:
            raise DataError(
                f"{path}: checkpoint format {metadata['version']}, this program reads "
                f"{FORMAT_VERSION}; resume with the program that wrote it"
            )
        arrays = {  # read whole first, so that no declared size is trusted
            name: np.lib.format.read_array(
                io.BytesIO(archive.read(f"{name}.npy")), allow_pickle=False
            )
            for name in metadata["arrays"]
        }
    for name, array in arrays.items():
        if _description(array) != metadata["arrays"][name]:
            raise ValueError(f"{name} differs from its checksum")
    return arrays, metadata["scalars"], metadata["digest"]


def _description(array: npt.NDArray[Any]) -> dict[str, Any]:
    contiguous = np.ascontiguousarray(array)
    return {
        "dtype": array.dtype.str,
        "shape": list(array.shape),
        "crc32": zlib.crc32(contiguous.reshape(-1).view(np.uint8).data),
    }


def _make_room(folder: Path, step: int) -> bool:
    """Remove what a killed process left and, if the newest before ``step`` is whole, the others.

    Returns whether anything was removed.
    """
    removable = list(folder.glob(".step_*.npz"))
    earlier = [path for path in checkpoints(folder) if path.name < f"step_{step:08d}.npz"]
    if earlier and _is_whole(earlier[-1]):
        removable += [path for path in checkpoints(folder) if path != earlier[-1]]
    for path in removable:
        path.unlink(missing_ok=True)
    return bool(removable)


def _is_whole(path: Path) -> bool:
    try:
        _read(path)
    except (*DAMAGE, DataError):
        return False
    return True


SETTINGS = "config.toml"
"""The first file of a run."""

SHOWN = 3
"""The most settings that a message names."""


def save_state(folder: Path, device: Device, state: RunState, digest: str) -> None:
    """Write a checkpoint of ``state``; no anchor may be hidden.

    Raises:
        ClgsError: as :func:`clgs.train.state.checkpoint.save`.
    """
    parameters = state.parameters
    assert not parameters.hidden
    arrays: dict[str, DeviceArray] = dict(parameters.scene.items())
    for name, moments in parameters.moments.items():
        arrays |= {f"{which}.{name}": array for which, array in moments.items()}
    arrays |= {f"statistics.{name}": array for name, array in parameters.statistics.items()}
    if state.exposures is not None:
        arrays["exposure"] = state.exposures.maps
        moments = state.exposures.moments
        arrays |= {f"{which}.exposure": array for which, array in moments.items()}
    arrays |= {f"mean.{name}": array for name, array in state.means.tensors.items()}
    scalars = {
        "step": state.step,
        "mean_begin": state.means.begin,
        "merged": state.merged,
        "begun": state.begun,
        "rng": state.rng.bit_generator.state,
        "sampler": state.views.record(),
    }
    host: Arrays = {name: device.download(array) for name, array in arrays.items()}
    rate, known = state.rate, state.known
    host["rate.scales"], host["rate.price"] = np.array(astuple(rate.scales)), np.array(rate.price)
    if rate.tables:
        newest = rate.tables[-1]
        host |= {f"rate.{name}": one.table for name, one in newest.rates.items()}
        bits = (one.bits for one in newest.rates.values())
        host["rate.kept"] = np.array([newest.step, newest.anchors, *bits], np.float64)
    if known is not None:
        host |= {"known.importance": known.importance, "known.seen": known.seen}
        host |= {f"known.{name}": array for name, array in known.curvature.items()}
    save(folder, host, scalars, digest)


def load_state(folder: Path, device: Device, digest: str, changed: str = "") -> RunState:
    """The state in the newest usable checkpoint, on ``device``.

    ``digest`` and ``changed`` as for :func:`clgs.train.state.checkpoint.load`.

    Raises:
        DataError: all checkpoints are damaged, or belong to a run with other settings or photos.
    """
    host, scalars = load(folder, digest, changed)
    on_host = ("rate.", "known.")
    arrays = {n: device.upload(array) for n, array in host.items() if not n.startswith(on_host)}
    moments = {
        name.removeprefix("first."): Moments(array, arrays[name.replace("first.", "second.")])
        for name, array in arrays.items()
        if name.startswith("first.")
    }
    means = {n.removeprefix("mean."): a for n, a in arrays.items() if n.startswith("mean.")}
    exposures = None
    if "exposure" in arrays:
        exposures = ExposureMaps(arrays["exposure"], moments.pop("exposure"))
    scene = DeviceScene(Anchors(*(arrays[name] for name in FIELDS)), arrays["weights"])
    statistics = Statistics(*(arrays[f"statistics.{one.name}"] for one in fields(Statistics)))
    scales = QuantizationScales(*map(float, host["rate.scales"]))
    rate = RateState(scales, float(host["rate.price"]))
    if "rate.kept" in host:
        step, anchors, *bits = host["rate.kept"]
        rates = {
            name: Rate(float(each), getattr(scales, name), host[f"rate.{name}"])
            for name, each in zip(ANCHOR_GROUPS, bits, strict=True)
        }
        rate.tables = [RateTables(int(step), rates, int(anchors))]
    known = None
    if "known.seen" in host:
        curvature = {name: host[f"known.{name}"] for name in ANCHOR_GROUPS}
        known = Sensitivity(host["known.importance"], curvature, host["known.seen"])
    rng = np.random.default_rng()
    rng.bit_generator.state = scalars["rng"]
    return RunState(
        parameters=Parameters(scene, moments, statistics),
        rate=rate,
        exposures=exposures,
        rng=rng,
        views=ViewOrder.restore(scalars["sampler"]),
        known=known,
        means=Means(int(scalars.get("mean_begin", 0)), means),
        merged=int(scalars["merged"]),
        step=int(scalars["step"]),
        begun=int(scalars.get("begun", 0)),
    )


def changed_settings(folder: Path, config: TrainConfig) -> str:
    """What differs between ``config`` and the run in ``folder``: " (--steps: 300 there, 400 here)".

    The text is empty if that is unknown, or if no setting that results depend on differs.
    """
    try:
        there = tomllib.loads((folder / SETTINGS).read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return ""
    here = tomllib.loads(config.to_toml())
    options = options_of(TrainConfig)
    there = {**older_values(TrainConfig), **there}
    kept = [name for name, one in options.items() if one.in_digest]
    names = [name for name in kept if there.get(name) != here.get(name)]
    if "steps" in names:
        names = ["steps"]  # most others follow from it
    elif "batch" in names:
        names = [name for name in names if name != "size_lambda"]  # follows from it
    if "size_lambda" in names or "target_size" in names:
        names = [name for name in names if name != "growth_threshold"]  # follows from them
    shown = [
        f"{options[name].flag}: {there.get(name)} there, {here.get(name)} here"
        for name in names[:SHOWN]
    ]
    return f" ({'; '.join(shown)})" if shown else ""
