"""The progress of training as TensorBoard shows it: `tensorboard --logdir RUN/tensorboard`."""

from __future__ import annotations

from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING

from clgs.errors import UsageError

if TYPE_CHECKING:
    from clgs.train.run.session import Progress


def check_tensorboard() -> None:
    """See that the library is there.

    Raises:
        UsageError: it is not.
    """
    if find_spec("tensorboard") is None:
        raise UsageError("--tensorboard: is not installed; pip install 'clgs[tensorboard]'")


class EventLog:
    """Writes what :class:`Progress` tells at the steps at which the PSNR is measured."""

    def __init__(self, folder: Path) -> None:
        from tensorboard.summary import Writer

        self._writer = Writer(str(folder))

    def update(self, progress: Progress) -> None:
        """Write a step, if it was looked at, and leave nothing in memory."""
        if progress.psnr is None:
            return
        result = progress.result
        values = {
            "loss/total": result.loss,
            "loss/l1": result.l1,
            "loss/ssim": result.ssim,
            "psnr/training views": progress.psnr,
            "size/anchors": result.anchors,
            "size/estimated bytes": progress.estimated_bytes,
        }
        for name, value in values.items():
            if value is not None:
                self._writer.add_scalar(name, float(value), result.step)
        self._writer.flush()
