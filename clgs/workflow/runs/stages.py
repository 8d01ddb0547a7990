"""The stages of `clgs run`, each with the command of clgs that does the same."""

from __future__ import annotations

import json
import shlex
import shutil
import time
from collections.abc import Callable, Collection, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import asdict, replace
from functools import cached_property, partial
from importlib.util import find_spec
from math import ceil
from pathlib import Path
from typing import Any

from clgs.codec.scene_encoder import encode
from clgs.exports.framing import look_outward
from clgs.exports.report import write_run_report
from clgs.files import atomic_write, remove_temporaries, write_json
from clgs.opencl.device import Device
from clgs.train.config import layered
from clgs.train.config.sources import find
from clgs.train.run.run_folder import RESULTS
from clgs.workflow.events import Note, OnEvent, RunStage, StageFailure, StageRecord
from clgs.workflow.export import export
from clgs.workflow.options import FPS, FRAMES, PathOptions, ViewOptions
from clgs.workflow.pictures import render_clip
from clgs.workflow.prepare import prepare_data
from clgs.workflow.runs.clocks import speed_on, synthetic_speed, try_photos
from clgs.workflow.runs.plan import (
    SIZES,
    SKETCH_STEPS,
    SKETCH_TIMES,
    SPARE,
    Photos,
    Presentation,
    StepSpeed,
    TrainingPlan,
)
from clgs.workflow.runs.record import (
    DATA,
    RUN,
    RUN_OPTIONS,
    FinishedRun,
    RunInput,
    RunRecord,
    measure_data,
)
from clgs.workflow.scenes import read_drawable, read_scene
from clgs.workflow.smaller import EncodedFile
from clgs.workflow.train import train
from clgs.workflow.views import Evaluation, evaluate, load_views, scene_name

SCENE, SCORES, REPORT = "scene.clgs", "scores.json", "report.html"
PAGE, GAUSSIANS, CLIP = "scene.html", "scene.ply", "clip.mp4"
MADE = (DATA, RUN, SCENE, SCORES, REPORT, PAGE, GAUSSIANS, CLIP)
"""Everything in the output folder that is replaced by another run."""

NEEDED = (SCENE, "scene.npz", "hashes.json", "per_view.json", "progress.csv")
"""Files of the run folder that later stages need."""


class RunStages:
    """Works through stages whose files are missing or damaged, and keeps their seconds."""

    def __init__(
        self,
        out: Path,
        record: RunRecord,
        seed: int,
        device: str | None,
        on_event: OnEvent,
        begun: bool = False,
    ) -> None:
        """Stages of the run in ``out``; they add to ``record`` what they took and made.

        The record is written if the run has ``begun``; before, the folder may hold another run.
        """
        self._out, self.run_folder, self._record, self._begun = out, out / RUN, record, begun
        self.seed, self._device_name, self._on_event = seed, device, on_event

    @cached_property
    def device(self) -> Device:
        """The device of all stages, opened when it is first needed."""
        return Device(self._device_name)

    @property
    def posed(self) -> bool:
        """Whether poses were found by an earlier call."""
        return (self._out / DATA).is_dir()

    def measure_speed(self, photos: Photos, data: Path | None) -> StepSpeed:
        """The speed of steps on the data set ``data`` of these photos, or on a synthetic scene."""
        self._on_event(Note("measuring how fast this device trains"))
        if data is None:
            return synthetic_speed(self.device)
        return speed_on(self.device, data, photos, self.run_folder, self.seed, self._on_event)

    def try_photos(self, given: RunInput) -> Photos:
        """The photos of a run with what a few of them tell, if their poses are wanted."""
        if not given.tried or self.posed:
            return given.photos
        self._on_event(Note(f"trying {len(given.tried)} of the photos"))
        return replace(given.photos, trial=try_photos(self.device, given.tried, given.largest))

    def begin(self, kept: Collection[str]) -> None:
        """Write the record, and remove the files of an earlier run but those of these names."""
        self._begun = True
        self._record.write(self._out)
        for path in (self._out / name for name in MADE if name not in kept):
            if path.is_dir() and not path.is_symlink():
                shutil.rmtree(path)
            else:
                path.unlink(missing_ok=True)

    def settle(self, plan: TrainingPlan, chosen: Mapping[str, Any], title: str | None) -> None:
        """Keep the plan of the training, the settings that follow from it or are chosen, the title.

        They are written into the record.
        """
        settings = {"steps": plan.steps, "max_size": plan.max_size, "seed": self.seed, **chosen}
        self._record.settings.update(settings, coarse_to_fine=plan.coarse)
        self._record.plan.update(asdict(plan), title=title)
        self._record.write(self._out)

    def prepare(
        self, given: RunInput, quick: bool, max_size: int | None, on_event: OnEvent
    ) -> Path:
        """Find the poses; the folder of the data set. ``max_size``: of training, if it is given.

        ``on_event`` receives the progress. Photos are no larger than training may want them.
        """
        width = SIZES[0] if max_size is None else SPARE * max_size
        data = self._out / DATA
        frames = given.photos.count if given.video else None
        words = ["prepare", given.path, "-o", data, "--seed", self.seed]
        words += ["--quick"] * quick + ["--frames", frames] * given.video
        words += ["--max-size", width, "--device", self.device.name]
        work = partial(prepare_data, given.path, data, seed=self.seed, quick=quick, frames=frames)
        work = partial(work, max_size=width, device=self.device.name)
        self._stage("prepare", data, words, partial(work, on_event=on_event))
        return data

    def train(self, data: Path) -> None:
        """Train; what a damaged run lacks is made again from its last checkpoint."""
        run, settings = self.run_folder, self._record.settings
        if not all((run / name).is_file() for name in NEEDED):
            (run / RESULTS).unlink(missing_ok=True)
        device = self.device.name
        words = ["train", data, "-o", run, "--preset", "quick", *setting_options(settings, "=")]
        for name in ("coarse_to_fine", "exposure"):
            words += [f"--{name.replace('_', '-')}"] * bool(settings.get(name))
        words += ["--device", device]
        given = {name: value for name, value in settings.items() if value is not False}
        config = layered({}, {"preset": "quick", **given})
        command = command_line(*words)
        work = partial(train, data, run, config, device=device, resume=True, command=command)
        words.append("--resume")
        self._stage("train", run / RESULTS, words, partial(work, on_event=self._on_event))

    def encode(self) -> None:
        """Write the scene as one file."""
        run, file = self.run_folder, self._out / SCENE

        def work() -> EncodedFile:
            scene, _ = read_scene(run)
            data = encode(scene)
            atomic_write(file, data)
            return EncodedFile(file, len(data), len(scene.anchors))

        self._stage("encode", file, ["encode", run, "-o", file, "--overwrite"], work)

    def evaluate(self, data: Path) -> None:
        """Score the file on the views that the run was scored on."""
        file, scores, device = self._out / SCENE, self._out / SCORES, self.device.name
        split = json.loads((self.run_folder / RESULTS).read_text(encoding="utf-8"))["split"]
        settings = self._record.settings
        size = settings["max_size"]
        names = [name for name in ("masks", "test_every") if name in settings]
        others: dict[str, Any] = {name: settings[name] for name in names}
        words = ["eval", file, "--data", data, "--json", scores, "--overwrite"]
        words += ["--max-size", size, "--split", split, "--device", device]
        words += setting_options(others)

        def work() -> Evaluation:
            views = ViewOptions(data, split, max_size=size, device=device, **others)
            scene, nbytes = read_drawable(file)
            opened = Device(device)
            found = evaluate(opened, file, scene, nbytes, views, on_event=self._on_event)
            write_json(scores, found.record())
            return found

        self._stage("eval", scores, words, work)

    def export(self, shown: Presentation) -> dict[str, Exception]:
        """Write page, Gaussians and clip; the errors of those that failed."""
        page, gaussians, clip = (self._out / name for name in (PAGE, GAUSSIANS, CLIP))
        for path in (page, gaussians, clip):
            remove_temporaries(path)
        run, device, on_event = self.run_folder, self.device.name, self._on_event
        device_words = ["--device", device]
        views = ViewOptions(device=device)
        along = self._clip_path(views, shown)
        path_words = ["--path", along.name, "--frames", along.frames, "--fps", f"{along.fps:g}"]
        if along.size is not None:
            path_words += ["--size", "{}x{}".format(*along.size)]
        write = partial(export, run, overwrite=True, on_event=on_event)
        write_page = partial(write, page, name=shown.title)
        write_gaussians = partial(write, gaussians, device=device)
        draw = partial(render_clip, run, clip, along, views, overwrite=True, on_event=on_event)
        todo: list[tuple[str, Path, list[Any], Callable[[], object]]] = [
            ("page", page, ["export", run, "--name", shown.title], write_page),
            ("Gaussians", gaussians, ["export", run, *device_words], write_gaussians),
            ("clip", clip, ["render", run, *path_words, *device_words], draw),
        ]
        failures: dict[str, Exception] = {}
        for name, file, words, work in todo:
            if name == "clip" and along.name == "none":
                on_event(RunStage(name, "left out, as asked for"))
                continue
            if name == "clip" and find_spec("imageio_ffmpeg") is None:
                on_event(RunStage(name, "left out; it needs: pip install 'clgs[video]'"))
                continue
            try:
                self._stage(name, file, [*words, "-o", file, "--overwrite"], work, needed=False)
            except Exception as error:
                failures[name] = error
                on_event(StageFailure(name, error))
        return failures

    def _clip_path(self, views: ViewOptions, chosen: Presentation) -> PathOptions:
        """The path of the clip as it was planned, or as it is chosen now."""
        plan: dict[str, Any] = self._record.plan.get("clip", {})  # older runs have none
        name, fps = chosen.path or plan.get("path"), plan.get("fps", FPS)
        if not name:
            scene, _ = read_scene(self.run_folder)
            cameras = [view.camera for view in load_views(self.run_folder, scene, views).train]
            name = "interpolate" if look_outward(cameras) else "orbit"
        frames = plan.get("frames", FRAMES)
        if chosen.seconds is not None:
            frames = max(1, round(chosen.seconds * fps))
        size = chosen.size or ((plan["width"], plan["height"]) if plan else None)
        return PathOptions(name, frames, fps, size)

    def _clip_options(self, chosen: Presentation) -> list[object]:
        """The options that ask for the clip that was planned, or is chosen now."""
        plan: dict[str, Any] = self._record.plan.get("clip", {})  # older runs have none
        path, seconds, size = chosen.path or plan.get("path"), chosen.seconds, chosen.size
        if plan and path != "none":
            seconds = seconds or plan["frames"] / plan["fps"]
            size = size or (plan["width"], plan["height"])
        words: list[object] = ["--clip", path] if path else []
        words += ["--clip-time", f"{seconds:g}s"] if seconds else []
        return words + (["--clip-size", f"{size[0]}x{size[1]}"] if size else [])

    def finish(
        self, given: RunInput, data: Path, failures: dict[str, Exception], shown: Presentation
    ) -> FinishedRun:
        """Write the report, with the command that repeats the run; what was made."""
        out, record = self._out, self._record
        used = f"{given.photos.count} of the data set {given.path}"
        if not given.posed:
            used = f"{measure_data(data).count} of {given.photos.count} found their pose"
        links = {"the scene as a web page": PAGE, "clip": CLIP, "the file": SCENE}
        links |= {"ordinary Gaussians": GAUSSIANS, "poses of the photos": f"{DATA}/{REPORT}"}
        sketch, steps = "", record.plan.get("steps", SKETCH_STEPS)
        if steps < SKETCH_STEPS:
            longer = f"{ceil(SKETCH_TIMES * sum(record.seconds.values()) / 60)}m"
            more = command_line("run", given.path, "-o", out, "--resume", "--time", longer)
            sketch = f"A sketch: {steps:,} steps. More time makes it sharp: {more}"
        own = {name: value for name, value in record.settings.items() if name in RUN_OPTIONS}
        words = ["run", given.path, "-o", out, *setting_options(own)]
        words += ["--exposure"] * bool(record.settings.get("exposure"))
        for name, value in record.settings.items():
            if name not in own and name != "coarse_to_fine":  # the plan decides that
                words += ["--set", f"{name}={_as_word(value)}"]
        if self._device_name is not None:
            words += ["--device", self._device_name]
        if shown.title not in (None, scene_name(given.path)):
            words += ["--name", shown.title]
        words += self._clip_options(shown)
        write_run_report(
            self.run_folder,
            command=command_line(*words),
            lead=f"{used}. {sketch}".strip(),
            seconds=record.seconds,
            links=[(label, name) for label, name in links.items() if (out / name).exists()],
            page=out / REPORT,
            title=shown.title or "",
        )
        scores = json.loads((out / SCORES).read_text(encoding="utf-8"))
        return FinishedRun(out, used, scores, record.seconds, failures, sketch)

    def _stage(
        self,
        name: str,
        made: Path,
        words: list[Any],
        work: Callable[[], object],
        needed: bool = True,
    ) -> None:
        """Do the work of a stage, unless ``made`` is there as it was made.

        ``words`` are the arguments of the command that does the same.
        """
        size = self._record.made.get(made.name)
        if made.is_dir() or (made.is_file() and made.stat().st_size == size):
            self._on_event(RunStage(name, f"is there: {made}"))
            return
        self._on_event(RunStage(name, command_line(*words)))
        try:
            with self.timed(name):
                record = work()
                if made.is_file():
                    self._record.made[made.name] = made.stat().st_size
        except Exception as error:
            if needed:
                error.add_note(f"{name} failed; mend that and repeat the command with --resume")
            raise
        self._on_event(StageRecord(record))

    @contextmanager
    def timed(self, stage: str) -> Iterator[None]:
        """Add the seconds of the block to those of ``stage``, and write the record."""
        start, seconds = time.perf_counter(), self._record.seconds
        try:
            yield
        finally:
            seconds[stage] = seconds.get(stage, 0.0) + time.perf_counter() - start
            if self._begun:
                self._record.write(self._out)


def command_line(*words: object) -> str:
    """The words of a command, as a shell takes them."""
    return shlex.join(["clgs", *map(str, words)])


def setting_options(settings: dict[str, Any], between: str | None = None) -> list[str]:
    """The settings that the user may choose too, as options with their values."""
    found: list[str] = []
    for name, value in settings.items():
        if not isinstance(value, bool):
            words = find(name).flag, _as_word(value)
            found += words if between is None else [between.join(words)]
    return found


def _as_word(value: object) -> str:
    """A value of a setting as commands take it."""
    if isinstance(value, bool):
        return str(value).lower()
    return ",".join(map(str, value)) if isinstance(value, tuple | list) else str(value)
