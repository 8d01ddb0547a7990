"""What an output folder says of the run that it holds, so that --resume goes on with that run."""

from __future__ import annotations

import argparse
import json
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any

from clgs.cli.counted import counted
from clgs.cli.run.duration import in_words
from clgs.cli.run.source import PLAN, Source
from clgs.cli.tell import tell
from clgs.errors import DataError, ExistsError, UsageError
from clgs.files import atomic_write

DATA = "data"
"""The data set in it, if poses had to be found."""

RUN = "run"
"""The run folder of training in it."""


@dataclass(frozen=True)
class Record:
    """A run.

    input: the absolute path that it began with; photos: their number there; digest: as a source
    has it; time: seconds that it was planned for; settings: of training, empty until it is planned;
    plan: figures behind them; seconds: that its stages took so far, over all calls; made: bytes of
    the files that they made, by name.
    """

    input: str
    photos: int
    digest: str
    time: float
    settings: dict[str, Any] = field(default_factory=dict)
    plan: dict[str, Any] = field(default_factory=dict)
    seconds: dict[str, float] = field(default_factory=dict)
    made: dict[str, int] = field(default_factory=dict)

    def write(self, out: Path) -> None:
        """Into the folder ``out``."""
        atomic_write(out / PLAN, (json.dumps(asdict(self), indent=1) + "\n").encode())

    def check(self, out: Path, source: Source, args: argparse.Namespace) -> None:
        """See that this run has that input and these options.

        Raises:
            UsageError: it has others.
        """
        if self.input != str(source.path.resolve()):
            raise UsageError(f"{out}: is a run of {self.input}; name that, or another folder")
        if not self.settings and not (out / DATA).is_dir():
            return
        if self.photos != source.photos.count:
            raise UsageError(
                f"{source.path}: has {counted(source.photos.count, 'photo')}, and the run in {out} "
                f"began with {self.photos}; start anew with --overwrite"
            )
        if self.digest != source.digest:
            raise UsageError(
                f"{source.path}: holds other photos than the run in {out} began with; start anew "
                "with --overwrite"
            )
        if self.settings and args.time not in (None, self.time):
            raise _other("time", out, in_words(self.time))
        for name, kept in self.settings.items():
            if getattr(args, name, None) not in (None, kept):
                raise _other(name, out, kept)


def _other(name: str, out: Path, kept: Any) -> UsageError:
    option = "--" + name.replace("_", "-")
    return UsageError(
        f"{option}: the run in {out} has {kept}; leave it out, or start anew with --overwrite"
    )


def read_record(out: Path, args: argparse.Namespace) -> Record | None:
    """The run in ``out`` that is to go on; none if a run is to begin.

    Raises:
        DataError: its record is damaged.
        ExistsError: ``out`` holds other things, or a run that is neither resumed nor replaced.
        UsageError: options contradict each other.
    """
    path = out / PLAN
    if args.resume and args.overwrite:
        raise UsageError("--resume goes on with a run and --overwrite replaces it; give one")
    if not path.is_file():
        if (out / RUN / "config.toml").is_file():
            raise ExistsError(
                f"{out}: holds a run, but not its {PLAN}; finish {out / RUN} by `clgs train "
                "--resume`, or choose another folder"
            )
        if out.is_dir() and any(out.iterdir()):
            raise ExistsError(f"{out}: holds other files; choose another folder")
        if args.resume:
            tell(f"clgs: {out} holds no run yet; one begins")
        return None
    if args.plan or args.overwrite:
        return None
    if not args.resume:
        raise ExistsError(
            f"{out}: holds a run already; go on with it (--resume), replace it "
            "(--overwrite), or choose another folder"
        )
    try:
        found = Record(**json.loads(path.read_text(encoding="utf-8")))
        return replace(
            found,
            photos=int(found.photos),
            time=float(found.time),
            settings=dict(found.settings),
            made=dict(found.made),
            seconds={str(name): float(value) for name, value in found.seconds.items()},
        )
    except (ValueError, TypeError, AttributeError) as error:
        raise DataError(f"{path}: is damaged; start anew with --overwrite") from error
