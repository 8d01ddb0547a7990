"""The whole of `clgs run`: look, plan, and work through the stages."""

from __future__ import annotations

import argparse
import json
import os
import shlex
import shutil
import time
from dataclasses import asdict, replace
from functools import cached_property
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Any

from clgs.cli.run.duration import in_words
from clgs.cli.run.plan import (
    DEFAULT_SECONDS,
    Photos,
    Plan,
    frames_within,
    make_plan,
    must_hurry,
    prepare_seconds,
)
from clgs.cli.run.record import DATA, RUN, Record, read_record
from clgs.cli.run.source import Source, find_source, measure_data
from clgs.cli.run.stages import Stages
from clgs.cli.run.summary import print_box
from clgs.cli.tell import tell
from clgs.errors import UsageError
from clgs.files import check_folder, make_folder, remove_temporaries

if TYPE_CHECKING:
    from clgs.opencl.device import Device
    from clgs.train.run.folder_lock import FolderLock

PAGE, SPLATS, CLIP = "scene.html", "scene.ply", "clip.mp4"
SCORES = "scores.json"
MADE = (DATA, RUN, "scene.clgs", SCORES, "report.html", PAGE, SPLATS, CLIP)
CLIP_FRAMES = 120

NEEDED = ("scene.clgs", "scene.npz", "hashes.json", "per_view.json", "progress.csv")
"""Files of the run that what follows needs."""


class Job:
    """One call of the command."""

    def __init__(self, args: argparse.Namespace) -> None:
        self._args = args
        self._out: Path = args.output
        self._stages = Stages(on_time=self._keep)
        self._record: Record | None = None  # nothing is written before there is one
        self._lock: FolderLock | None = None
        self._start = time.perf_counter()
        self._time: float = args.time or DEFAULT_SECONDS

    def run(self) -> int:
        """All stages; the exit code: that of the last of the exports that failed, if one did.

        Raises:
            DataError: another process works in OUT.
        """
        check_folder(self._out)
        if self._out.is_dir() and not self._args.plan:
            self._hold()
        try:
            return self._run()
        finally:
            if self._lock:
                self._lock.release()

    def _hold(self) -> None:
        """Keep other processes out of OUT."""
        from clgs.train.run.folder_lock import FolderLock

        self._lock = self._lock or FolderLock(self._out)

    def _run(self) -> int:
        record = read_record(self._out, self._args)
        source = find_source(self._args.input)
        if record:
            record.check(self._out, source, self._args)
            self._time = self._args.time or record.time
            self._stages.seconds |= record.seconds
            self._stages.made |= record.made
            self._record = record
        where, count = str(source.path.resolve()), source.photos.count
        begun = Record(where, count, source.digest, self._time)
        source = self._shortened(source)
        settings = record.settings if record else {}
        if not settings:
            hurry = self._must_hurry(source)
            ready = source.path if source.complete else None
            plan = self._plan(source.photos, self._preparing(source, hurry), ready)
            _tell(source, plan, self._device.name, hurry, self._time)
            if self._args.plan:
                return 0
            if not record:
                self._clear(source, begun)
        data = self._data(source)
        settings = settings or self._settings(source, data, plan)
        self._train(data, settings)
        failed = self._exports()
        self._report(source, settings)
        return failed

    def _shortened(self, source: Source) -> Source:
        """With as many frames as the time allows, of a video."""
        if not source.video:
            return source
        count = frames_within(os.cpu_count() or 1, self._time)
        return replace(source, photos=replace(source.photos, count=count))

    @cached_property
    def _device(self) -> Device:
        from clgs.opencl.device import Device

        return Device(self._args.device)

    def _plan(self, photos: Photos, preparing: float, data: Path | None) -> Plan:
        """By the speed on ``data``, if that is there already."""
        from clgs.cli.run.measure import speed_on, synthetic_speed

        args = self._args
        with self._stages.timed("plan"):
            tell("clgs: measuring how fast this device trains")
            if data is None:
                speed = synthetic_speed(self._device)
            else:
                speed = speed_on(self._device, data, photos, self._out / RUN, args.seed or 0)
        left = self._time - (time.perf_counter() - self._start)
        return make_plan(photos, speed, preparing, left, args.steps, args.max_size)

    def _must_hurry(self, source: Source) -> bool:
        return must_hurry(source.photos.count, os.cpu_count() or 1, self._time)

    def _preparing(self, source: Source, hurry: bool) -> float:
        if source.pointless:
            return prepare_seconds(source.photos.count, os.cpu_count() or 1, quick=True)
        if source.posed:
            return 0.0
        return prepare_seconds(source.photos.count, os.cpu_count() or 1, hurry)

    def _keep(self, record: Record | None = None) -> None:
        """Write what is known of the run, once it has begun."""
        self._record = record or self._record
        if self._record:
            seconds, made = self._stages.seconds, self._stages.made
            replace(self._record, seconds=seconds, made=made).write(self._out)

    def _clear(self, source: Source, begun: Record) -> None:
        """Make OUT, without what an earlier run left there.

        Raises:
            UsageError: the input lies in it.
        """
        doomed = [self._out / name for name in MADE]
        inside = {source.path.resolve(), *source.path.resolve().parents}
        if any(path.resolve() in inside for path in doomed):
            raise UsageError(f"{source.path}: lies in the folder that is written to; copy it first")
        make_folder(self._out)
        self._hold()
        self._keep(begun)
        for path in doomed:
            if path.is_dir() and not path.is_symlink():
                shutil.rmtree(path)
            else:
                path.unlink(missing_ok=True)

    def _data(self, source: Source) -> Path:
        """The data set: the input, or what `prepare` makes of it."""
        if source.posed:
            return source.path
        data = self._out / DATA
        options = ["--seed", str(self._args.seed or 0)]
        if self._must_hurry(source):
            options.append("--quick")
        if source.video:
            options += ["--frames", str(source.photos.count)]
        self._stages.run("prepare", data, "prepare", source.path, "-o", data, *options)
        return data

    def _settings(self, source: Source, data: Path, plan: Plan) -> dict[str, Any]:
        """Steps and size of training, planned again once there are poses and points."""
        if not source.complete:
            plan = self._plan(measure_data(data), 0.0, data)
            print(f"training: {_training(plan)}")
        settings = {"steps": plan.steps, "max_size": plan.max_size, "seed": self._args.seed or 0}
        settings["coarse_to_fine"] = plan.coarse
        assert self._record is not None
        self._keep(replace(self._record, settings=settings, plan=asdict(plan)))
        return settings

    def _train(self, data: Path, settings: dict[str, Any]) -> None:
        """Train, encode, and score the file."""
        from clgs.train.run.finished_run import RESULTS

        run, scene = self._out / RUN, self._out / "scene.clgs"
        on = ("--device", self._device.name)
        options = [f"{_option(name)}={value}" for name, value in _chosen(settings)]
        options += [_option(name) for name, value in settings.items() if value is True]
        words: list[str | Path] = [data, "-o", run, "--preset", "quick", *options, *on, "--resume"]
        if not all((run / name).is_file() for name in NEEDED):
            (run / RESULTS).unlink(missing_ok=True)  # made again from the last checkpoint
        self._stages.run("train", run / RESULTS, "train", *words)
        self._stages.run("encode", scene, "encode", run, "-o", scene, "--overwrite")
        scores = self._out / SCORES
        views = ("--max-size", str(settings["max_size"]), *self._split(run), *on)
        into = ("--data", data, "--json", scores)
        self._stages.run("eval", scores, "eval", scene, *into, *views)

    def _split(self, run: Path) -> tuple[str, ...]:
        """Which views the run was scored on."""
        summary = json.loads((run / "results.json").read_text(encoding="utf-8"))
        return ("--split", str(summary["split"]))

    def _exports(self) -> int:
        """Page, Gaussians and clip; the exit code of the last that failed, 0 if none did."""
        run, code = self._out / RUN, 0
        for name in (PAGE, SPLATS, CLIP):
            remove_temporaries(self._out / name)
        on = ("--device", self._device.name, "--overwrite")
        path = ("--path", "interpolate", "--frames", str(CLIP_FRAMES))
        wanted: dict[str, tuple[str, tuple[str | Path, ...]]] = {
            "page": (PAGE, ("export", run)),
            "Gaussians": (SPLATS, ("export", run)),
            "clip": (CLIP, ("render", run, *path)),
        }
        if find_spec("imageio_ffmpeg") is None:
            del wanted["clip"]
            print("\n[clip] left out; it needs: pip install 'clgs[video]'")
        for name, (file, words) in wanted.items():
            made = self._out / file
            code = self._stages.attempt(name, made, *words, "-o", made, *on) or code
        return code

    def _report(self, source: Source, settings: dict[str, Any]) -> None:
        from clgs.export.run_report import RunStory, write_run_report

        made = {"the scene as a web page": PAGE, "clip": CLIP, "the file": "scene.clgs"}
        made |= {"ordinary Gaussians": SPLATS, "poses of the photos": "data/report.html"}
        links = [(label, name) for label, name in made.items() if (self._out / name).exists()]
        seconds, photos = self._stages.seconds, self._photos(source)
        story = RunStory(_command(self._args, settings), f"{photos}.", seconds, links)
        write_run_report(self._out / RUN, story, self._out / "report.html")
        scores = json.loads((self._out / SCORES).read_text(encoding="utf-8"))
        print_box(self._out, photos, scores, seconds)

    def _photos(self, source: Source) -> str:
        """How many photos were used, in words."""
        if source.posed:
            return f"{source.photos.count} of the data set {source.path}"
        found = measure_data(self._out / DATA).count
        return f"{found} of {source.photos.count} found their pose"


def _tell(source: Source, plan: Plan, device: str, hurry: bool, allowed: float) -> None:
    """Print the plan."""
    photos = source.photos
    kind = "data set" if source.posed else "frames" if source.video else "photos"
    print(f"{source.path}: {kind}, {photos.count} of {photos.width} x {photos.height} pixels")
    if not source.posed:
        tested = "not tested, for lack of time" if hurry else "tested by a second reconstruction"
        print(f"poses:    about {in_words(plan.prepare_seconds)}, {tested}")
    if source.pointless:
        print(f"points:   about {in_words(plan.prepare_seconds)}")
    print(f"training: {_training(plan)}")
    print(f"the rest: about {in_words(plan.other_seconds)}: scores, page, Gaussians, clip")
    late = f", more than the {in_words(allowed)} of --time" if plan.seconds > 1.05 * allowed else ""
    print(f"in all:   about {in_words(plan.seconds)} on {device}{late}", flush=True)


def _training(plan: Plan) -> str:
    return (
        f"{plan.steps:,} steps on photos at most {plan.max_size} wide, "
        f"about {in_words(plan.train_seconds)}"
    )


def _command(args: argparse.Namespace, settings: dict[str, Any]) -> str:
    """What repeats the run, whatever the clock says."""
    words = ["clgs", "run", str(args.input), "-o", str(args.output)]
    for name, value in _chosen(settings):
        words += [_option(name), str(value)]
    if args.device is not None:
        words += ["--device", args.device]
    return shlex.join(words)


def _option(name: str) -> str:
    return f"--{name.replace('_', '-')}"


def _chosen(settings: dict[str, Any]) -> list[tuple[str, Any]]:
    """What the user may choose as well; the rest follows from it."""
    return [(name, value) for name, value in settings.items() if not isinstance(value, bool)]
