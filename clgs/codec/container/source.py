"""Where the bytes of a .clgs file come from: memory, or a file that is read in parts."""

from __future__ import annotations

import threading
from io import RawIOBase
from typing import Protocol

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
    """An open file that can seek, without a buffer; threads may share it.

    ``bytes_read`` counts what was read.
    """

    def __init__(self, file: RawIOBase) -> None:
        self._file = file
        self._turn = threading.Lock()
        self.size = file.seek(0, 2)
        self.bytes_read = 0

    def read(self, offset: int, length: int) -> memoryview:
        """The bytes, read from the file.

        Raises:
            CodecError: the file has become shorter since it was opened.
        """
        data = memoryview(bytearray(length))
        with self._turn:
            self._file.seek(offset)
            done = 0
            while done < length and (count := self._file.readinto(data[done:])):
                done += count
            self.bytes_read += done
        if done < length:
            raise CodecError(f"file at byte {offset + done}: it was cut while it was read")
        return data
