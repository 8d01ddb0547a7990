"""Built kernels, shared by all processes that run tests and kept from run to run.

PoCL keeps what it builds in a folder that processes side by side must not share. So each process
has a folder of its own (POCL_CACHE_DIR), and takes part in a common one between test files: it
links what others have built, and gives what it has built itself. PoCL names a build by a hash of
source, options, device and its own version: a changed kernel is another build.
"""

import atexit
import os
import shutil
import tempfile
import time
from pathlib import Path

VARIABLE = "CLGS_TEST_KERNELS"
"""Names the common folder; by default build/test_kernels of the checkout."""
DEFAULT = Path(__file__).resolve().parents[1] / "build" / "test_kernels"
UNUSED = 14 * 24 * 3600
"""Builds that nobody has used for this long, in seconds, are removed."""


class KernelCache:
    """The folder of one process, and the common one."""

    def __init__(self, common: Path, own: Path) -> None:
        """Both may be missing or empty yet."""
        self.common = common
        self.own = own
        self._known: set[str] = set()

    def take(self) -> None:
        """Add what other processes have built."""
        self._spread(self.common, self.own)

    def give(self) -> None:
        """Add what this process has built."""
        self._spread(self.own, self.common)

    def _spread(self, source: Path, target: Path) -> None:
        for folder, _, names in os.walk(source):
            for name in names:
                path = os.path.relpath(os.path.join(folder, name), source)
                # temporary files have other names, or lie further up
                built = name.endswith((".so", "program.bc", "last_accessed"))
                if built and path.count(os.sep) >= 2 and path not in self._known:
                    self._known.add(path)
                    add(source / path, target / path)


def add(source: Path, target: Path) -> None:
    """Make ``target`` the file ``source``, whole from the moment it appears; the first stays."""
    target.parent.mkdir(parents=True, exist_ok=True)
    try:
        os.link(source, target)
    except FileExistsError:
        pass
    except OSError:  # folders on two file systems
        copy = target.with_name(f"{target.name}.{os.getpid()}")
        shutil.copy2(source, copy)
        copy.replace(target)


def remove_unused(common: Path) -> None:
    """Remove builds that were not used for long."""
    for stamp in common.glob("*/*/last_accessed"):
        if time.time() - stamp.stat().st_mtime > UNUSED:
            shutil.rmtree(stamp.parent, ignore_errors=True)


def open_cache() -> KernelCache:
    """The cache of this process, with what is built so far; PoCL uses it.

    Its folder is removed when the process ends. Must come before pyopencl is imported.
    """
    common = Path(os.environ.get(VARIABLE, DEFAULT))
    if "PYTEST_XDIST_WORKER" not in os.environ:
        remove_unused(common)
    own = Path(tempfile.mkdtemp(prefix="clgs-pocl-"))
    atexit.register(shutil.rmtree, own, ignore_errors=True)
    os.environ["POCL_CACHE_DIR"] = str(own)
    cache = KernelCache(common, own)
    cache.take()
    return cache
