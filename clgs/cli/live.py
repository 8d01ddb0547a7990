"""What the displays of progress share: a bar that is there while the block runs."""

from __future__ import annotations

from types import TracebackType
from typing import Self

from rich.progress import Progress


class Live:
    """Shows ``_progress``, which a subclass makes, from the begin of a block to its end."""

    _progress: Progress

    def __enter__(self) -> Self:
        self._progress.start()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        self._progress.stop()
