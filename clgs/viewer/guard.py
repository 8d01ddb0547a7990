"""Who may speak to the viewer: browsers that have its address, from pages of its own alone.

The address ends in a token, which other pages and other users of this machine do not know. The
header Host must name this machine: a page whose name is made to lead here (DNS rebinding) gives
its own. The header Origin, which browsers add, must be that of the viewer's own page.
"""

from __future__ import annotations

import secrets
import socket
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from ipaddress import ip_address
from typing import Any
from urllib.parse import urlsplit

from clgs.errors import ClgsError

REFUSED = "open the address that `clgs view` has printed\n"


def may_enter(host: str, token: str, path: str, hosts: list[str], origins: list[str]) -> bool:
    """Whether a request is answered.

    Args:
        host: the name or the address that the server listens at.
        token: the first part of every path.
        path: of the request.
        hosts: its headers Host.
        origins: its headers Origin; programs that are no browsers send none.
    """
    first = path.partition("?")[0].split("/")[1:2]
    if not first or not secrets.compare_digest(ascii(first[0]), ascii(token)):
        return False
    try:
        (netloc,) = hosts
        name = (urlsplit(f"//{netloc}").hostname or "").rstrip(".")
        own_pages = all(urlsplit(origin).netloc.lower() == netloc.lower() for origin in origins)
    except ValueError:
        return False
    return own_pages and _is_here(name, host)


def _is_here(name: str, host: str) -> bool:
    """Whether a name of a Host header is this machine's, or an address: no page is named by one."""
    own = socket.gethostname().lower()
    if name in ("localhost", host.lower(), own, f"{own}.local", own.partition(".")[0]):
        return bool(name)
    try:
        ip_address(name)
    except ValueError:
        return False
    return True


@contextmanager
def guarded(host: str, token: str) -> Iterator[None]:
    """Servers of web sockets that are opened in the block answer only whom :func:`may_enter` lets.

    viser has no hook of its own for this.

    Raises:
        ClgsError: viser has not opened its server by the function that is guarded.
    """
    from websockets.asyncio import server as sockets

    plain, used = sockets.serve, False

    def serve(*args: Any, process_request: Callable[[Any, Any], Any], **options: Any) -> Any:
        nonlocal used
        used = True

        def answer(connection: Any, request: Any) -> Any:
            get = request.headers.get_all
            if not may_enter(host, token, request.path, get("Host"), get("Origin")):
                return connection.respond(403, REFUSED)
            inside = request.path.partition("?")[0].split("/", 2)[2:]
            return process_request(connection, replace(request, path=f"/{''.join(inside)}"))

        return plain(*args, process_request=answer, **options)

    sockets.serve = serve  # type: ignore[assignment,misc]  # a function for a class
    try:
        yield
    finally:
        sockets.serve = plain  # type: ignore[misc]  # the class again
    if not used:
        raise ClgsError("this version of viser opens its server in an unknown way; install 1.1")
