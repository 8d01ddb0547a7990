"""The page's C sources as a library of this machine, called as the page's worker calls them."""

import ctypes
import shutil
import subprocess
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

ROOT = Path(__file__).resolve().parents[2]
COMPILER = shutil.which("cc")
NEEDS = [
    pytest.mark.skipif(not (ROOT / "web/wasm").is_dir(), reason="needs a checkout"),
    pytest.mark.skipif(COMPILER is None, reason="needs a C compiler, cc"),
]
"""Marks of the tests that call the library."""

RECORD = 12
"""Words of a Gaussian, see web/wasm/view/gaussians.h."""


def build(folder: Path, compiler: str) -> ctypes.CDLL:
    """Compile the sources, every warning an error."""
    sources = [*(ROOT / "web/wasm").rglob("*.c"), *(ROOT / "codec_c/src").rglob("*.c")]
    flags = "-std=c11 -O2 -fPIC -shared -fno-math-errno -Wall -Wextra -Wconversion -Wshadow -Werror"
    rooms = ("web/wasm", "web/wasm/file", "web/wasm/view", "codec_c/include", "codec_c/src")
    includes = [f"-I{ROOT / name}" for name in rooms]
    output = folder / "page.so"
    command = [compiler, *flags.split(), *includes, *map(str, sources), "-lm", "-o", str(output)]
    subprocess.run(command, check=True)
    return ctypes.CDLL(str(output))


def sizes(library: ctypes.CDLL, data: bytes) -> tuple[int, int]:
    """What the beginning of a file says of its size, and of what comes before a BODY."""
    library.page_room.restype, library.page_problem.restype = ctypes.c_void_p, ctypes.c_char_p
    library.page_size.restype = ctypes.c_double
    ctypes.memmove(library.page_room(ctypes.c_size_t(len(data))), data, len(data))
    size, front = (int(library.page_size(which)) for which in (0, 1))
    if size < 0:
        raise ValueError(library.page_problem().decode())
    return size, front


class Page:
    """One scene; raises ValueError with the page's message if a file is damaged."""

    def __init__(self, library: ctypes.CDLL, data: bytes, there: int | None = None) -> None:
        """``there``: how many bytes of ``data`` have come; default: all."""
        self._library = library
        for name in ("room", "numbers", "hashes", "positions", "records", "order", "chunks"):
            getattr(library, f"page_{name}").restype = ctypes.c_void_p
        library.page_problem.restype = ctypes.c_char_p
        library.page_count.restype = library.page_sort.restype = ctypes.c_size_t
        library.page_layers.restype = ctypes.c_size_t
        library.page_chunk_count.restype = ctypes.c_size_t
        self._room = library.page_room(ctypes.c_size_t(len(data)))
        ctypes.memmove(self._room, data, len(data))
        if there is not None:
            library.page_arrived(ctypes.c_size_t(there))
        for _ in self._steps(library.page_open()):
            pass

    def arrive(self, there: int) -> None:
        """Decode what is complete with this many bytes."""
        for _ in self.steps(there):
            pass

    def steps(self, there: int) -> Iterator[int]:
        """The same step by step: how many are left, before the first and after each."""
        return self._steps(self._library.page_arrived(ctypes.c_size_t(there)))

    def _steps(self, left: int) -> Iterator[int]:
        while left > 0:
            yield left
            left = self._library.page_step()
        if left < 0:
            raise ValueError(self._library.page_problem().decode())
        yield left

    def fill(self, begin: int, data: bytes) -> None:
        """Bytes of the file, from ``begin`` on, have come."""
        ctypes.memmove(self._room + begin, data, len(data))

    def take(self, index: int, begin: int, data: bytes) -> None:
        """Decode a chunk whose bytes, from ``begin`` on, have come before others."""
        self.fill(begin, data)
        if self._library.page_take(ctypes.c_size_t(index)) < 0:
            raise ValueError(self._library.page_problem().decode())

    @property
    def chunks(self) -> np.ndarray:
        """(chunks, 9) float64: begin, end, layer, least and greatest position."""
        count = self._library.page_chunk_count()
        return self.array("chunks", ctypes.c_double, 9 * count).reshape(count, 9)

    @property
    def layers(self) -> tuple[int, int]:
        """How many layers there are, and are decoded."""
        return self._library.page_layers(0), self._library.page_layers(1)

    def array(self, name: str, kind: type, count: int) -> np.ndarray:
        """A copy of ``count`` numbers that ``page_<name>`` points to."""
        at = getattr(self._library, f"page_{name}")()
        return np.ctypeslib.as_array(ctypes.cast(at, ctypes.POINTER(kind)), (count,)).copy()

    @property
    def hashes(self) -> list[int]:
        """The hash of what was decoded, and the file's own hash."""
        return self.array("hashes", ctypes.c_uint64, 2).tolist()

    def gaussians(self, centre: np.ndarray) -> dict[str, np.ndarray]:
        """All Gaussians for a camera at ``centre``."""
        self._library.page_begin(*map(ctypes.c_float, centre))
        while self._library.page_add(ctypes.c_size_t(100)):
            pass
        count = self._library.page_count()
        words = self.array("records", ctypes.c_uint32, RECORD * count).reshape(count, RECORD)
        floats = words.view(np.float32)
        halves = words[:, 10:11].copy().view(np.float16).astype(np.float32)
        upper = floats[:, 4:10]
        return {
            "mean": floats[:, :3],
            "opacity": floats[:, 3],
            "covariance": upper[:, [0, 1, 2, 1, 3, 4, 2, 4, 5]].reshape(-1, 3, 3),
            "color": np.concatenate([halves, floats[:, 11:]], axis=1),
        }

    def order(self, row: np.ndarray) -> np.ndarray:
        """The last set's Gaussians by depth ``row`` . (x, y, z, 1), farthest first."""
        count = self._library.page_sort(*map(ctypes.c_float, row))
        return self.array("order", ctypes.c_uint32, count)
