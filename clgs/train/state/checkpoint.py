"""Checkpoints: the whole state of a run in one file, written atomically, the last two kept.

A checkpoint is an .npz file (an uncompressed zip of .npy members, no pickle) with one more
member, ``metadata.json``: format version, configuration digest, scalars, and CRC-32, dtype and
shape of every array.
"""

from __future__ import annotations

import io
import json
import re
import struct
import warnings
import zipfile
import zlib
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from clgs.errors import ClgsError, DataError, ExistsError
from clgs.files import atomic_path, is_full

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
