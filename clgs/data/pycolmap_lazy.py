"""pycolmap where it is needed: imported late, quiet, its failures in one line."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

# Pillow must be loaded before pycolmap: the other way round its PNG writer calls pycolmap's zlib
# and corrupts the heap (seen with pycolmap 4.2.1 and Pillow 13).
import PIL.Image  # noqa: F401 - imported for the order alone

from clgs.errors import DataError

_FATAL_ONLY = 3
"""glog severity: information, warnings and errors are not printed."""


@contextmanager
def quiet_pycolmap(task: str) -> Iterator[Any]:
    """The pycolmap module, printing nothing; its exceptions become a DataError naming ``task``.

    Raises:
        DataError: pycolmap is not installed, or fails.
    """
    try:
        import pycolmap
    except ImportError as error:
        raise DataError(
            f"{task}: pycolmap is missing; pip install pycolmap, or use a machine that it has a "
            "wheel for and copy the result"
        ) from error
    before = pycolmap.logging.minloglevel
    pycolmap.logging.minloglevel = _FATAL_ONLY
    try:
        yield pycolmap
    except DataError:
        raise
    # pycolmap throws whatever its C++ code or pybind11 chooses; all of it means a failed task.
    except Exception as error:
        raise DataError(f"{task}: {' '.join(str(error).split())[-200:]}") from error
    finally:
        pycolmap.logging.minloglevel = before
