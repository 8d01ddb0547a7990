"""A file server on the loopback address that sends a file only as far as the test lets it."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from contextlib import contextmanager
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer


class SlowServer:
    """Serves ``/page.html`` at once, and ``/s.clgs`` up to the byte that ``let`` was last given.

    ``address``: of the two; ``asked``: the paths that were asked for, in order.
    """

    def __init__(self, page: bytes, data: bytes) -> None:
        self._page, self._data = page, data
        self._end, self._cut, self._moved = 0, False, threading.Condition()
        self.asked: list[str] = []
        self.address = ""

    def let(self, end: int, cut: bool = False) -> None:
        """Send the file up to the byte ``end``; ``cut``: and no further, ever."""
        with self._moved:
            self._end, self._cut = end, cut
            self._moved.notify_all()

    def answer(self, request: BaseHTTPRequestHandler) -> None:
        """Write the answer of one request."""
        self.asked.append(request.path)
        data = {"/page.html": self._page, "/s.clgs": self._data}.get(request.path.split("?")[0])
        request.send_response(404 if data is None else 200)
        request.send_header("Content-Type", "text/html")
        request.send_header("Content-Length", str(len(data or b"")))
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
            request.wfile.write(data[sent:end])
            request.wfile.flush()
            sent = end
        request.close_connection = True


@contextmanager
def serve_slowly(page: bytes, data: bytes) -> Iterator[SlowServer]:
    """A server of a page and of the file ``data``."""
    own = SlowServer(page, data)

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
