"""What all users of imageio-ffmpeg share."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager, suppress
from types import GeneratorType
from typing import Any


@contextmanager
def ffmpeg_closed(generator: GeneratorType[Any, Any, Any]) -> Iterator[None]:
    """After the block, close a generator of imageio-ffmpeg and the pipes that it leaves open."""
    frame = generator.gi_frame
    try:
        yield
    finally:
        generator.close()
        found = frame.f_locals if frame else {}
        process = found.get("process") or found.get("p")
        for pipe in (process.stdin, process.stdout, process.stderr) if process else ():
            if pipe is not None:
                with suppress(OSError):
                    pipe.close()
