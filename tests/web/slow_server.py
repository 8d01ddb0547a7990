"""A file server on the loopback address that sends a file only as far as the test lets it."""

import threading
from collections.abc import Iterator
from contextlib import contextmanager
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer


class SlowServer:
    """Serves ``/page.html`` at once, and ``/s.clgs`` up to the byte that ``let`` was last given.

    ``address``: of the two; ``asked``: the paths that were asked for, in order. ``ranges``: whether
    parts of the file can be had; ``parts``: begin and end of those that were asked for, which are
    given as far as ``give`` lets them.
    """

    def __init__(self, page: bytes, data: bytes, ranges: bool) -> None:
        self._page, self._data, self.ranges = page, data, ranges
        self._given = 0
        self.parts: list[tuple[int, int]] = []
        self._end, self._cut, self._moved = 0, False, threading.Condition()
        self.asked: list[str] = []
        self.address = ""

    def let(self, end: int, cut: bool = False) -> None:
        """Send the file up to the byte ``end``; ``cut``: and no further, ever."""
        with self._moved:
            self._end, self._cut = end, cut
            self._moved.notify_all()

    def give(self, count: int) -> None:
        """Answer the first ``count`` requests for parts."""
        with self._moved:
            self._given = count
            self._moved.notify_all()

    def answer_part(self, request: BaseHTTPRequestHandler) -> None:
        """Write a part of the file, once it is its turn."""
        first, last = request.headers["Range"].removeprefix("bytes=").split("-")
        begin, end = int(first), int(last) + 1
        with self._moved:
            self.parts.append((begin, end))
            number = len(self.parts)
            self._moved.wait_for(lambda: self._given >= number or self._cut)
        request.send_response(206)
        request.send_header("Content-Range", f"bytes {begin}-{end - 1}/{len(self._data)}")
        request.send_header("Content-Length", str(end - begin))
        request.end_headers()
        request.wfile.write(self._data[begin:end])

    def answer(self, request: BaseHTTPRequestHandler) -> None:
        """Write the answer of one request."""
        self.asked.append(request.path)
        data = {"/page.html": self._page, "/s.clgs": self._data}.get(request.path.split("?")[0])
        if self.ranges and "Range" in request.headers:
            self.answer_part(request)
            return
        request.send_response(404 if data is None else 200)
        request.send_header("Content-Type", "text/html")
        request.send_header("Content-Length", str(len(data or b"")))
        if self.ranges:
            request.send_header("Accept-Ranges", "bytes")
        request.end_headers()
        if data is self._page:
            request.wfile.write(data)
        sent = 0
        while data is self._data and sent < len(data):
            with self._moved:
                self._moved.wait_for(lambda sent=sent: self._end > sent or self._cut)
                end = self._end
            if end <= sent:
                break
            try:
                request.wfile.write(data[sent:end])
            except OSError:  # the browser asks for parts instead
                break
            request.wfile.flush()
            sent = end
        request.close_connection = True


@contextmanager
def serve_slowly(page: bytes, data: bytes, ranges: bool = False) -> Iterator[SlowServer]:
    """A server of a page and of the file ``data``."""
    own = SlowServer(page, data, ranges)

    class Handler(BaseHTTPRequestHandler):
        protocol_version = "HTTP/1.1"

        def do_GET(self) -> None:
            own.answer(self)

        def log_message(self, *_: object) -> None:
            pass

    server = ThreadingHTTPServer(("127.0.0.1", 0), Handler)
    threading.Thread(target=server.serve_forever, daemon=True).start()
    own.address = f"http://127.0.0.1:{server.server_port}/"
    try:
        yield own
    finally:
        own.let(0, cut=True)
        server.shutdown()
