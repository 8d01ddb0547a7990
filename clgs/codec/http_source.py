"""A file behind an address, read by HTTP range requests: http and https, no redirects."""

from __future__ import annotations

import http.client
import re
import threading
from urllib.parse import quote, urlsplit

from clgs.errors import DataError

FRONT = 1 << 15
"""Bytes of the first request: most directories, with what decoding needs, fit in."""

PIECE = 1 << 20
"""Bytes that are asked of the connection at once: what is only claimed takes no memory."""

SMALL_PIECE = 1 << 12
"""The same of the first request: a piece that breaks off is lost."""

SECONDS = 30.0
"""How long a server may say nothing."""

MOST_SHOWN = 200
"""Characters of another address that are shown."""

_RANGE = re.compile(r"bytes (\d{1,18})-(\d{1,18})/(\d{1,18})", re.IGNORECASE)

_AS_IT_IS = "!#$%&'()*+,/:;=?@[]~"
"""What stands in addresses for itself; all else, such as blanks and letters of other alphabets, is
written in percent."""

_DOWNLOAD = "download the file and read its bytes"

_OTHER_LENGTH = f"the answer is not as long as its range; {_DOWNLOAD}"


class BrokenConnectionError(DataError):
    """Nothing answers at an address, the server fails, or what it sends breaks off."""


class HttpSource:
    """The bytes of a file at ``url``; threads may share it. ``bytes_read`` counts those received.

    Raises:
        DataError: the address is none of http or https, nothing answers there, or the server
            answers otherwise than with the range that was asked for.
    """

    def __init__(self, url: str) -> None:
        url = " ".join(url.split())
        try:
            parts = urlsplit(url)
            host, port = parts.hostname, parts.port
            secure = parts.scheme == "https"
            kind = http.client.HTTPSConnection if secure else http.client.HTTPConnection
            self._connection = kind(host or "", port, timeout=SECONDS)
        except (ValueError, http.client.InvalidURL) as error:
            raise DataError(f"{url}: no address ({error}); correct it") from None
        if parts.scheme not in ("http", "https") or not host:
            raise DataError(f"{url}: no http or https address; name one, or read the file's bytes")
        self._url = url
        target = (parts.path or "/") + (f"?{parts.query}" if parts.query else "")
        self._target = quote(target, safe=_AS_IT_IS, errors="replace")
        self._turn = threading.Lock()
        self.bytes_read, self.size = 0, 0
        self._front = memoryview(self._request(0, FRONT, partly=True))

    def close(self) -> None:
        """End the connection."""
        self._connection.close()

    def read(self, offset: int, length: int) -> memoryview:
        """The bytes, received unless they were among the first ones."""
        if offset + length <= len(self._front):
            return self._front[offset : offset + length]
        if length == 0:
            return memoryview(b"")
        with self._turn:
            return memoryview(self._request(offset, length))

    def _request(self, offset: int, length: int, partly: bool = False) -> bytes:
        """Up to ``length`` bytes; fewer at the file's end or, ``partly``, if the answer breaks off.

        Raises:
            BrokenConnectionError: they broke off, ``partly`` before the first one.
        """
        asked = {"Range": f"bytes={offset}-{offset + length - 1}", "Accept-Encoding": "identity"}
        data, broken = bytearray(), "the answer is cut; try again"
        piece_size = SMALL_PIECE if partly else PIECE
        try:
            try:
                answer = self._ask(asked)
            except ConnectionError:  # a server may end a connection that waits; a new one opens
                self.close()
                answer = self._ask(asked)
            left = self._check(answer, offset, length)
            while left and (piece := answer.read(min(left, piece_size))):
                data += piece
                left -= len(piece)
            # An answer in pieces ends with an empty one, which must be read before the next answer.
            more = answer.read(1) if answer.length is None and not left else b""
        except (OSError, http.client.HTTPException, ValueError) as error:
            problem = " ".join(str(error).split()) or type(error).__name__
            broken = f"not read ({problem}); look at the address, or try again"
            left, more = 1, b""
        if more:
            self.close()
            raise DataError(f"{self._url}: {_OTHER_LENGTH}")
        if left:
            self.close()
            if not (partly and data):
                raise BrokenConnectionError(f"{self._url}: {broken}")
        self.bytes_read += len(data)
        return bytes(data)

    def _ask(self, headers: dict[str, str]) -> http.client.HTTPResponse:
        self._connection.request("GET", self._target, headers=headers)
        return self._connection.getresponse()

    def _check(self, answer: http.client.HTTPResponse, offset: int, length: int) -> int:
        """The bytes of an answer that has the range asked for, which sets the file's size."""
        problem = _refusal(answer)
        found = _RANGE.fullmatch(answer.headers.get("Content-Range", ""))
        first, last, size = map(int, found.groups()) if found else (-1, -1, -1)
        if not problem and (first, last) != (offset, min(offset + length, size) - 1):
            problem = f"the server sends another range; {_DOWNLOAD}"
        if not problem and answer.headers.get("Content-Encoding", "identity") != "identity":
            problem = f"the server packs what it sends; {_DOWNLOAD}"
        if not problem and answer.length not in (None, last - first + 1):
            problem = _OTHER_LENGTH
        if not problem and self.size not in (0, size):
            problem = "the file has changed meanwhile; try again"
        if problem:
            self.close()
            failed = BrokenConnectionError if answer.status >= 500 else DataError
            raise failed(f"{self._url}: {problem}")
        self.size = size
        return last - first + 1


def _refusal(answer: http.client.HTTPResponse) -> str:
    """Why an answer has no range of a file of known length; "" if it has."""
    if answer.status == 200:
        return f"the server ignores ranges; {_DOWNLOAD}"
    if 300 <= answer.status < 400:
        place = " ".join(answer.headers.get("Location", "another place").split())[:MOST_SHOWN]
        return f"the file has moved to {place}; name that address"
    if answer.status != 206:
        remedy = "try again" if answer.status >= 500 else "look at the address"
        return f"the server says {answer.status}; {remedy}"
    if answer.headers.get("Content-Range", "").endswith("/*"):
        return f"the server does not say how long the file is; {_DOWNLOAD}"
    return ""
