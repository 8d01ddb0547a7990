"""The table of what is trained: scenes, experiments on them, and the runs that these need."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from clgs.cluster.table import Settings, checked, named, only, read_toml
from clgs.errors import UsageError
from clgs.train.config import layered
from clgs.train.config.sources import find

KINDS = ("main", "curve", "ablation")
"""main: rows to compare with the published ones; curve: one setting takes several values;
ablation: variants of the experiment's own settings.
"""

BASE = "as it is"
"""The label of an ablation's own settings."""

CHECKPOINTS = 20
"""Checkpoints per run: what a killed worker did after its last one is done again."""

DIGITS = 12
"""Length of the digest in the name of a run."""

MAX_SEED = 2**31


@dataclass(frozen=True)
class Scene:
    """A data set: its folder below ``--data``, and what else the table says of it."""

    name: str
    data: str
    settings: Settings = field(default_factory=dict)
    protocol: str = ""


@dataclass(frozen=True)
class Experiment:
    """Runs that belong together; ``variants``: settings by label, in the order of the table."""

    name: str
    kind: str
    scenes: list[str]
    seeds: list[int]
    setting: str
    variants: dict[str, Settings]


@dataclass(frozen=True)
class Table:
    """A whole table, checked."""

    scenes: dict[str, Scene]
    experiments: dict[str, Experiment]


@dataclass(frozen=True)
class Entry:
    """One cell of an experiment; ``run``: the scene and a digest of all settings of its run."""

    experiment: str
    scene: str
    label: str
    seed: int
    settings: Settings
    run: str


def read_table(path: Path) -> Table:
    """The table in a TOML file.

    Raises:
        UsageError: no such file, not TOML, or a name or value that cannot be; names where.
    """
    table = read_toml(path)
    try:
        return _table(table)
    except UsageError as error:
        raise UsageError(f"{path}: {error}") from None


def entries(table: Table, steps: int | None = None) -> list[Entry]:
    """Every cell of every experiment; cells of equal settings share their run.

    Args:
        table: what is asked for.
        steps: of every run, in place of the table's.
    """
    found = []
    for one in table.experiments.values():
        for label, settings in one.variants.items():
            for scene in one.scenes:
                whole = {**table.scenes[scene].settings, **settings}
                if steps is not None:
                    whole = _in_steps(whole, steps)
                for seed in one.seeds:
                    full = _complete(whole, seed)
                    run = f"{scene}-{layered(full).digest()[:DIGITS]}"
                    found.append(Entry(one.name, scene, label, seed, full, run))
    return found


def _complete(settings: Settings, seed: int) -> Settings:
    """Add what the table leaves to the experiment."""
    interval = max(1, layered(settings).steps // CHECKPOINTS)
    return {**settings, "seed": seed, "checkpoint_interval": interval}


def _in_steps(settings: Settings, steps: int) -> Settings:
    """``settings`` for a run of ``steps`` steps; moments that they name move in proportion."""
    moved = layered(settings).scaled(steps)
    named = {name: getattr(moved, name) for name in settings if find(name).scaled}
    return {**settings, **named, "steps": steps}


def chosen(table: Table, words: list[str], all_entries: list[Entry]) -> list[Entry]:
    """The entries of the experiments and of the scenes that ``words`` name; of all, if of neither.

    Raises:
        UsageError: a word names neither.
    """
    for word in words:
        if word not in table.experiments and word not in table.scenes:
            known = ", ".join([*table.experiments, *table.scenes])
            raise UsageError(f"--only {word}: no such experiment or scene; the table has {known}")
    scenes = {word for word in words if word in table.scenes}
    experiments = {word for word in words if word in table.experiments}
    return [
        one
        for one in all_entries
        if (not scenes or one.scene in scenes)
        and (not experiments or one.experiment in experiments)
    ]


def jobs(
    table: Table, wanted: Iterable[Entry], data: Path, output: Path, facts: Mapping[str, Any]
) -> list[dict[str, Any]]:
    """The runs of some entries, each once, as plain dictionaries that a worker is sent.

    Keys: run (its name), data, folder and lock (paths), settings, and those of ``facts``, which
    come back in the row.
    """
    found: dict[str, dict[str, Any]] = {}
    for one in wanted:
        found[one.run] = {
            "run": one.run,
            "data": str((data / table.scenes[one.scene].data).resolve()),
            "folder": str(run_folder(output, one.run).resolve()),
            "settings": one.settings,
            "lock": str(run_folder(output, one.run).resolve() / "lock"),
            "facts": dict(facts),
        }
    return list(found.values())


def run_folder(output: Path, run: str) -> Path:
    """Where a run is kept."""
    return output / "runs" / run


def _table(table: Mapping[str, Any]) -> Table:
    only(table, "the table", ("scene", "experiment"))
    scenes = {name: _scene(name, one) for name, one in named(table, "scene")}
    experiments = {name: _experiment(name, one, scenes) for name, one in named(table, "experiment")}
    if both := set(scenes) & set(experiments):
        raise UsageError(f"{min(both)}: names a scene and an experiment; rename one")
    return Table(scenes, experiments)


def _scene(name: str, one: Mapping[str, Any]) -> Scene:
    where = f"scene.{name}"
    only(one, where, ("data", "settings", "protocol"))
    settings = _settings(one.get("settings", {}), f"{where}.settings")
    protocol = one.get("protocol", "")
    if not isinstance(protocol, str):
        raise UsageError(f"{where}.protocol: is not a text")
    data = one.get("data")
    if not isinstance(data, str) or not data:
        raise UsageError(f"{where}.data: give the data set's folder below --data")
    return Scene(name, data, settings, protocol)


def _experiment(name: str, one: Mapping[str, Any], scenes: Mapping[str, Scene]) -> Experiment:
    where = f"experiment.{name}"
    only(one, where, ("kind", "scenes", "seeds", "settings", "setting", "values", "variants"))
    kind = one.get("kind")
    if kind not in KINDS:
        raise UsageError(f"{where}.kind: {kind!r}; give {', '.join(KINDS)}")
    settings = _settings(one.get("settings", {}), f"{where}.settings")
    setting, variants = _variants(one, where, settings)
    wanted = _scenes(one.get("scenes"), where, scenes)
    for label, values in variants.items():
        for scene in wanted:
            try:
                layered({**scenes[scene].settings, **values})
            except UsageError as error:
                raise UsageError(f"{where}: {label}, {scene}: {error}") from None
    return Experiment(name, kind, wanted, _seeds(one, where), setting, variants)


def _variants(
    one: Mapping[str, Any], where: str, settings: Settings
) -> tuple[str, dict[str, Settings]]:
    """The setting of a curve, else "", and the settings of every label."""
    needed = {"main": (), "curve": ("setting", "values"), "ablation": ("variants",)}[one["kind"]]
    for name in ("setting", "values", "variants"):
        if (name in one) != (name in needed):
            problem = "is missing" if name in needed else "has no meaning here"
            raise UsageError(f"{where}.{name}: {problem}; the kind is {one['kind']}")
    if one["kind"] == "main":
        return "", {"": settings}
    if one["kind"] == "ablation":
        return "", {BASE: settings, **_ablation(one["variants"], f"{where}.variants", settings)}
    setting, values = one["setting"], one["values"]
    if not isinstance(values, list) or not values:
        raise UsageError(f"{where}.values: is not a list of values")
    if not isinstance(setting, str):
        raise UsageError(f"{where}.setting: is not the name of a setting")
    swept = [_settings({setting: value}, f"{where}.values") for value in values]
    labels = [f"{value:g}" if isinstance(value, float) else str(value) for value in values]
    return setting, {label: settings | own for label, own in zip(labels, swept, strict=True)}


def _ablation(variants: Any, where: str, settings: Settings) -> dict[str, Settings]:
    if not isinstance(variants, dict):
        raise UsageError(f"{where}: is not a table; write a line LABEL = {{ NAME = VALUE }} each")
    if BASE in variants:
        raise UsageError(f"{where}: {BASE!r} is what the experiment's own settings are called")
    return {
        label: settings | _settings(own, f"{where}.{label!r}") for label, own in variants.items()
    }


def _settings(values: Any, where: str) -> Settings:
    """Checked settings; what the table or the options choose is none of them."""
    found = checked(values, where)
    if taken := {"seed", "checkpoint_interval"} & set(found):
        raise UsageError(f"{where}: {min(taken)} is no setting here; give the experiment's seeds")
    return found


def _scenes(wanted: Any, where: str, scenes: Mapping[str, Scene]) -> list[str]:
    if not isinstance(wanted, list) or not wanted:
        raise UsageError(f"{where}.scenes: is not a list of scenes")
    for name in wanted:
        if name not in scenes:
            raise UsageError(f"{where}.scenes: no scene {name!r}; there are {', '.join(scenes)}")
    return list(dict.fromkeys(wanted))


def _seeds(one: Mapping[str, Any], where: str) -> list[int]:
    seeds = one.get("seeds", [0])
    usable = isinstance(seeds, list) and all(
        type(seed) is int and 0 <= seed < MAX_SEED for seed in seeds
    )
    if not usable or not seeds:
        raise UsageError(f"{where}.seeds: {seeds!r}; give whole numbers, such as [0, 1, 2]")
    return list(dict.fromkeys(seeds))
