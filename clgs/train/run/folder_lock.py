"""One process at a time works in the folder of a run."""

from __future__ import annotations

import os
import weakref
from pathlib import Path

from clgs.errors import DataError


class FolderLock:
    """Held from its making until :meth:`release`, or until the process ends, however it ends.

    Nothing is written. On Windows, and on file systems without locks, it holds nobody back.
    """

    def __init__(self, folder: Path) -> None:
        """Lock ``folder``, which exists.

        Raises:
            DataError: another process, or another lock of this one, holds it.
        """
        if os.name == "nt":
            return
        import fcntl

        opened = os.open(folder, os.O_RDONLY)
        self._close = weakref.finalize(self, os.close, opened)
        try:
            fcntl.flock(opened, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            self.release()
            raise DataError(
                f"{folder}: another process works in it; wait for it, or choose another folder"
            ) from None
        except OSError:
            self.release()

    def release(self) -> None:
        """Let others in."""
        if os.name != "nt":
            self._close()
