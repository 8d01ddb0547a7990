"""A plain file server on the loopback address that knows ranges, or ignores them."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from contextlib import contextmanager
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer

CLAIMED = 1 << 56
"""Bytes that nobody has room for."""


@contextmanager
def serve(
    files: dict[str, bytes], ranges: bool = True, way: str = "", limit: int = CLAIMED
) -> Iterator[str]:
    """The address that the names of ``files`` are added to; /moved leads to a file of the disk.

    way: "pieces": answers come in pieces without a length; "long": they are longer than their
    range; "packed": they say that they are; "leaving": the connection ends after each one,
    unannounced; "huge": all files are said to have CLAIMED bytes, and answers are cut; "unknown":
    the size of files is not said; "failing": it says 503 where others break. limit: bytes of files
    that are sent before connections break.
    """
    left = limit

    class Handler(BaseHTTPRequestHandler):
        protocol_version = "HTTP/1.1"

        def do_GET(self) -> None:
            nonlocal left
            data = files.get(self.path.lstrip("/"))
            if data is None or (way == "failing" and not left):
                self.send_response(503 if data else 302 if self.path == "/moved" else 404)
                self.send_header("Location", "file:///etc/passwd")
                self.send_header("Content-Length", "0")
                self.end_headers()
                return
            part, asked = data, self.headers.get("Range")
            if ranges and asked:
                first, last = map(int, asked.removeprefix("bytes=").split("-"))
                part = data[first : last + 1]
                self.send_response(206)
                size = CLAIMED if way == "huge" else len(data)
                end = min(last + 1, size) - 1
                said = "*" if way == "unknown" else size
                self.send_header("Content-Range", f"bytes {first}-{end}/{said}")
            else:
                self.send_response(200)
            if way == "pieces":
                self.send_header("Transfer-Encoding", "chunked")
                part = b"%x\r\n%b\r\n0\r\n\r\n" % (len(part), part)
            else:
                part += b"!" * (way == "long")
                length = end - first + 1 if way == "huge" else len(part)
                self.send_header("Content-Length", str(length))
            if way == "packed":
                self.send_header("Content-Encoding", "gzip")
            self.end_headers()
            self.wfile.write(part[:left])
            self.close_connection |= way in ("leaving", "huge") or left < len(part)
            left = max(left - len(part), 0)

        def log_message(self, *_: object) -> None:
            pass

    server = ThreadingHTTPServer(("127.0.0.1", 0), Handler)
    threading.Thread(target=server.serve_forever, daemon=True).start()
    try:
        yield f"http://127.0.0.1:{server.server_port}/"
    finally:
        server.shutdown()
        server.server_close()
