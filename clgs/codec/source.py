"""Where the bytes of a .clgs file come from: memory, or a file that is read in parts."""

from __future__ import annotations

import threading
from typing import BinaryIO, Protocol

from clgs.errors import CodecError


class Source(Protocol):
    """``size`` bytes, of which any part can be read."""

    size: int

    def read(self, offset: int, length: int) -> memoryview:
        """``length`` bytes from ``offset`` on; the caller has checked them against ``size``."""
        ...


class BytesSource:
    """Bytes in memory."""

    def __init__(self, data: bytes) -> None:
        self._data = memoryview(data)
        self.size = len(data)

    def read(self, offset: int, length: int) -> memoryview:
        """A view, nothing copied."""
        return self._data[offset : offset + length]


class FileSource:
    """An open file that can seek; ``bytes_read`` counts what was read. Threads may share it."""

    def __init__(self, file: BinaryIO) -> None:
        self._file = file
        self._turn = threading.Lock()
        self.size = file.seek(0, 2)
        self.bytes_read = 0

    def read(self, offset: int, length: int) -> memoryview:
        """The bytes, read from the file.

        Raises:
            CodecError: the file has become shorter since it was opened.
        """
        with self._turn:
            self._file.seek(offset)
            data = self._file.read(length)
            self.bytes_read += len(data)
        if len(data) < length:
            raise CodecError(f"file at byte {offset + len(data)}: it was cut while it was read")
        return memoryview(data)
