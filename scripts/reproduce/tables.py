"""The page of a report as Markdown: one function a section."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from statistics import mean
from typing import Any

from reproduce.results import Comparison, Group, Results
from reproduce.table import BASE

MEGABYTE = 2**20
SECTIONS = {
    "positions": "ANCH",
    "offsets": "OFFS",
    "features": "FEAT",
    "scalings": "SCAL",
    "MLPs": "MLPS",
}
NOTES = {
    "head": (
        "Made by `{command}`. Scores are of the decoded `.clgs` file alone. All figures, and more "
        "of them, are in `results.json` next to this page."
    ),
    "main": (
        "Means over seeds, in brackets the least and the largest. `PSNR` is one MSE over all "
        "pixels and channels of 8-bit pictures; `PSNR of channels` the mean of the three channels' "
        "PSNRs of the render before clamping and rounding."
    ),
    "bits": ("Bits per anchor, and the share of the file; `rest` is the header and the directory."),
    "time": (
        "`training` is reading the photos, training and encoding; not the scores. Times hold if "
        "one run had the machine: `at once` is the number of workers that shared it. Peak memory "
        "is that of the worker's process, the largest of the seeds."
    ),
    "baseline": (
        "BD-rate: mean difference of bytes at equal PSNR (Bjontegaard, piecewise cubic), negative "
        "is smaller; where the baseline has one point, the bytes at its PSNR."
    ),
    "ablation": (
        "Each variant changes what its name says and nothing else; changes are against the first "
        "row of the scene."
    ),
}
"""Text of the page between its figures."""

Rows = Iterable[Sequence[str]]
Column = Callable[[Group], str]


def page(
    results: Results,
    command: str,
    plots: dict[str, str],
    kept: dict[str, str],
    compared: list[Comparison],
    published: dict[str, Any],
    note: str = "",
) -> str:
    """The whole page; ``plots`` and ``kept`` name files in the folder ``results`` next to it.

    ``note``: a sentence at its head.
    """
    main = [group for one in results.experiments("main") for group in results.groups(one.name)]
    parts = ["# Results", NOTES["head"].format(command=command), _state(results), note]
    if main:
        parts += ["## Main rows", NOTES["main"], by_group(main, MAIN)]
        parts += ["### Compared with published figures", _compared(main, published)]
        parts += [_protocol(results, main, published)]
        parts += ["### Bits by section", NOTES["bits"], by_group(main, BITS)]
        parts += ["### Time and memory", NOTES["time"], by_group(main, TIME)]
        parts += ["### Files", _files(main, kept)]
    parts += _curves(results, plots, compared)
    parts += _ablations(results)
    if results.missing:
        runs = len({one.run for one in results.missing})
        names = ", ".join(sorted({f"{one.experiment} of {one.scene}" for one in results.missing}))
        parts += ["## Not finished", f"{runs} runs are missing: {names}."]
    return "\n\n".join(part for part in parts if part) + "\n"


def _state(results: Results) -> str:
    rows = results.rows()
    if not rows:
        return "Nothing is finished."
    states = ", ".join(sorted({row["state"] for row in rows}))
    machines = sorted({f"{row['machine']['processor']}" for row in rows})
    return f"{len(rows)} runs, of the states {states}, on {' and '.join(machines)}."


def by_group(groups: list[Group], columns: Mapping[str, Column]) -> str:
    """A line for each group, with some columns."""
    return table(tuple(columns), ([cell(one) for cell in columns.values()] for one in groups))


def spread(name: str, form: str) -> Column:
    """A column: the mean over seeds, and the least and the largest value if there are several."""

    def cell(one: Group) -> str:
        text = form.format(one.mean(name))
        low, high = (form.format(value) for value in one.range(name))
        return text if len(one.rows) == 1 else f"{text} ({low} to {high})"

    return cell


def bits(part: str) -> Column:
    """A column: bits per anchor of a section, of the ``rest`` or the ``whole``, and the share."""

    def cell(one: Group) -> str:
        sizes = {
            name: mean(row["sections"].get(tag, 0) for row in one.rows)
            for name, tag in SECTIONS.items()
        }
        whole = one.mean("bytes")
        size = {**sizes, "rest": whole - sum(sizes.values()), "whole": whole}[part]
        return f"{8 * size / (one.mean('anchors') or 1.0):.1f} ({100 * size / whole:.1f} %)"

    return cell


def most_memory(one: Group) -> str:
    """The largest peak of the seeds, megabytes; nothing where the system does not count it."""
    known = [row["peak_memory_bytes"] for row in one.rows if row["peak_memory_bytes"]]
    return f"{max(known) / MEGABYTE:,.0f}" if known else ""


NAMES: dict[str, Column] = {
    "scene": lambda one: one.entry.scene,
    "experiment": lambda one: one.entry.experiment,
    "steps": lambda one: f"{one.rows[0]['steps']:,}",
}
MAIN: dict[str, Column] = {
    **NAMES,
    "seeds": lambda one: str(len(one.rows)),
    "PSNR": spread("psnr", "{:.2f}"),
    "PSNR of channels": spread("psnr_channel_mean", "{:.2f}"),
    "SSIM": spread("ssim", "{:.4f}"),
    "bytes": spread("bytes", "{:,.0f}"),
    "anchors": spread("anchors", "{:,.0f}"),
}
BITS: dict[str, Column] = {**NAMES, **{part: bits(part) for part in (*SECTIONS, "rest", "whole")}}
TIME: dict[str, Column] = {
    **NAMES,
    "training, s": spread("seconds", "{:,.0f}"),
    "encode, s": spread("encode_seconds", "{:.2f}"),
    "decode, s": spread("decode_seconds", "{:.2f}"),
    "pictures/s": spread("pictures_per_second", "{:.1f}"),
    "peak memory, MB": most_memory,
    "at once": lambda one: ", ".join(sorted({str(row["workers"]) for row in one.rows})),
    "device": lambda one: ", ".join(sorted({row["machine"]["device"]["name"] for row in one.rows})),
}


def _compared(groups: list[Group], published: dict[str, Any]) -> str:
    """The main rows of each scene, and below them the published ones."""
    rows = []
    for scene in dict.fromkeys(one.entry.scene for one in groups):
        rows += [
            (
                scene,
                f"here, {one.entry.experiment}",
                f"{one.rows[0]['steps']:,}",
                f"{one.mean('psnr'):.2f}",
                f"{one.mean('psnr_channel_mean'):.2f}",
                f"{one.mean('ssim'):.3f}",
                f"{one.mean('bytes') / MEGABYTE:.3f}",
                f"{one.mean('anchors'):,.0f}",
            )
            for one in groups
            if one.entry.scene == scene
        ]
        for method, figures in published["methods"].items():
            found = figures["scenes"].get(scene)
            if not found:
                continue
            psnr = (f"{found['psnr']:.2f}", "")
            if method == "Voxel-GS":  # whose code states the mean over channels, see `protocol`
                psnr = psnr[::-1]
            ssim = f"{found['ssim']:.3f}" if "ssim" in found else ""
            megabytes = f"{found['megabytes'] * figures['megabyte'] / MEGABYTE:.3f}"
            anchors = f"{found['anchors']:,}" if "anchors" in found else ""
            rows.append((scene, method, "30,000", *psnr, ssim, megabytes, anchors))
    head = ("scene", "method", "steps", "PSNR", "PSNR of channels", "SSIM", "MB of 2^20", "anchors")
    return table(head, rows)


def _protocol(results: Results, groups: list[Group], published: dict[str, Any]) -> str:
    """What differs between the figures here and the published ones."""
    lines = list(published["protocol"])
    sources = (f"{name}: {one['source']}" for name, one in published["methods"].items())
    lines.append(f"Sources: {'; '.join(sources)}.")
    for scene in dict.fromkeys(one.entry.scene for one in groups):
        if text := results.table.scenes[scene].protocol:
            lines.append(f"{scene}: {text}.")
    return "What differs:\n\n" + "\n".join(f"- {line}" for line in lines)


def _files(groups: list[Group], kept: dict[str, str]) -> str:
    head = ("scene", "experiment", "steps", "seed", "bytes", "SHA-256", "file")
    rows = []
    for one in groups:
        for row in one.rows:
            seed, name = str(row["settings"]["seed"]), kept.get(row["run"])
            file = f"`results/{name}`" if name else "not kept"
            names = one.entry.scene, one.entry.experiment, f"{row['steps']:,}"
            rows.append((*names, seed, f"{row['bytes']:,}", f"`{row['sha256']}`", file))
    return table(head, rows)


def _curves(results: Results, plots: dict[str, str], compared: list[Comparison]) -> list[str]:
    """The points of every curve; against another state."""
    parts: list[str] = []
    for one in results.experiments("curve"):
        groups = results.groups(one.name)
        image = f"![PSNR against bytes over {one.setting}](results/{plots[one.name]})"
        columns: dict[str, Column] = {
            "scene": NAMES["scene"],
            f"`{one.setting}`": lambda group: group.entry.label,
            **{name: MAIN[name] for name in ("PSNR", "bytes", "anchors")},
        }
        parts += [f"## Curve {one.name}: `{one.setting}`", image, by_group(groups, columns)]
    if compared:
        rows = (
            (
                found.scene,
                found.experiment,
                found.kind,
                found.reason if found.change is None else f"{100 * found.change:+.1f} %",
            )
            for found in compared
        )
        head = ("scene", "experiment", "measure", "change")
        parts += ["## Against the baseline", NOTES["baseline"], table(head, rows)]
    return parts


def _ablations(results: Results) -> list[str]:
    parts: list[str] = []
    for one in results.experiments("ablation"):
        groups = results.groups(one.name)
        base = {group.entry.scene: group for group in groups if group.entry.label == BASE}
        rows = [_ablation_row(group, base.get(group.entry.scene)) for group in groups]
        head = ("scene", "variant", "PSNR", "change", "bytes", "change", "anchors", "training, s")
        parts += [f"## Ablation {one.name}", NOTES["ablation"], table(head, rows)]
    return parts


def _ablation_row(group: Group, base: Group | None) -> tuple[str, ...]:
    decibel = share = ""
    if base is not None and base is not group:
        decibel = f"{group.mean('psnr') - base.mean('psnr'):+.2f}"
        share = f"{100 * (group.mean('bytes') / base.mean('bytes') - 1):+.1f} %"
    return (
        group.entry.scene,
        group.entry.label,
        MAIN["PSNR"](group),
        decibel,
        MAIN["bytes"](group),
        share,
        f"{group.mean('anchors'):,.0f}",
        f"{group.mean('seconds'):,.0f}",
    )


def table(head: Sequence[str], rows: Rows) -> str:
    """A table as Markdown."""
    lines = [head, ["---"] * len(head), *rows]
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)
