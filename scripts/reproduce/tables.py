"""The page of a report as Markdown: one function a section."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
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
        parts += ["## Main rows", NOTES["main"], _main(main)]
        parts += ["### Compared with published figures", _compared(main, published)]
        parts += [_protocol(results, main, published)]
        parts += ["### Bits by section", NOTES["bits"], _bits(main)]
        parts += ["### Time and memory", NOTES["time"], _time(main)]
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


def _main(groups: list[Group]) -> str:
    head = ("scene", "experiment", "steps", "seeds", "PSNR", "PSNR of channels", "SSIM", "bytes",
            "anchors")  # fmt: skip
    return table(
        head,
        (
            (
                *_names(one),
                str(len(one.rows)),
                spread(one, "psnr", "{:.2f}"),
                spread(one, "psnr_channel_mean", "{:.2f}"),
                spread(one, "ssim", "{:.4f}"),
                spread(one, "bytes", "{:,.0f}"),
                spread(one, "anchors", "{:,.0f}"),
            )
            for one in groups
        ),
    )


def _names(one: Group) -> tuple[str, str, str]:
    return one.entry.scene, one.entry.experiment, f"{one.rows[0]['steps']:,}"


def spread(one: Group, name: str, form: str) -> str:
    """The mean over seeds, and the least and the largest value if there are several."""
    text = form.format(one.mean(name))
    low, high = (form.format(value) for value in one.range(name))
    return text if len(one.rows) == 1 else f"{text} ({low} to {high})"


def _compared(groups: list[Group], published: dict[str, Any]) -> str:
    rows = []
    for one in groups:
        rows.append(
            (
                one.entry.scene,
                f"here, {one.entry.experiment}",
                f"{one.rows[0]['steps']:,}",
                f"{one.mean('psnr'):.2f}",
                f"{one.mean('psnr_channel_mean'):.2f}",
                f"{one.mean('ssim'):.3f}",
                f"{one.mean('bytes') / MEGABYTE:.3f}",
                f"{one.mean('anchors'):,.0f}",
            )
        )
    for scene in dict.fromkeys(one.entry.scene for one in groups):
        for method, figures in published["methods"].items():
            if found := figures["scenes"].get(scene):
                rows.append(_published_row(scene, method, figures["megabyte"], found))
    order = list(dict.fromkeys(one.entry.scene for one in groups))
    rows.sort(key=lambda row: order.index(row[0]))
    head = ("scene", "method", "steps", "PSNR", "PSNR of channels", "SSIM", "MB of 2^20", "anchors")
    return table(head, rows)


def _published_row(
    scene: str, method: str, megabyte: int, found: dict[str, Any]
) -> tuple[str, ...]:
    # the code of Voxel-GS states the mean over channels, see `protocol`
    channels = method == "Voxel-GS"
    psnr = f"{found['psnr']:.2f}"
    return (
        scene,
        method,
        "30,000",
        "" if channels else psnr,
        psnr if channels else "",
        f"{found['ssim']:.3f}" if "ssim" in found else "",
        f"{found['megabytes'] * megabyte / MEGABYTE:.3f}",
        f"{found['anchors']:,}" if "anchors" in found else "",
    )


def _protocol(results: Results, groups: list[Group], published: dict[str, Any]) -> str:
    """What differs between the figures here and the published ones."""
    lines = list(published["protocol"])
    sources = (f"{name}: {one['source']}" for name, one in published["methods"].items())
    lines.append(f"Sources: {'; '.join(sources)}.")
    for scene in dict.fromkeys(one.entry.scene for one in groups):
        if text := results.table.scenes[scene].protocol:
            lines.append(f"{scene}: {text}.")
    return "What differs:\n\n" + "\n".join(f"- {line}" for line in lines)


def _bits(groups: list[Group]) -> str:
    head = ("scene", "experiment", "steps", *SECTIONS, "rest", "whole")
    rows = []
    for one in groups:
        anchors = one.mean("anchors") or 1.0
        sizes = {
            name: mean(row["sections"].get(tag, 0) for row in one.rows)
            for name, tag in SECTIONS.items()
        }
        sizes["rest"] = one.mean("bytes") - sum(sizes.values())
        sizes["whole"] = one.mean("bytes")
        cells = (
            f"{8 * size / anchors:.1f} ({100 * size / sizes['whole']:.1f} %)"
            for size in sizes.values()
        )
        rows.append((*_names(one), *cells))
    return table(head, rows)


def _time(groups: list[Group]) -> str:
    head = ("scene", "experiment", "steps", "training, s", "encode, s", "decode, s", "pictures/s",
            "peak memory, MB", "at once", "device")  # fmt: skip
    rows = []
    for one in groups:
        memory = [row["peak_memory_bytes"] for row in one.rows if row["peak_memory_bytes"]]
        rows.append(
            (
                *_names(one),
                spread(one, "seconds", "{:,.0f}"),
                spread(one, "encode_seconds", "{:.2f}"),
                spread(one, "decode_seconds", "{:.2f}"),
                spread(one, "pictures_per_second", "{:.1f}"),
                f"{max(memory) / MEGABYTE:,.0f}" if memory else "",
                ", ".join(sorted({str(row["workers"]) for row in one.rows})),
                ", ".join(sorted({row["machine"]["device"]["name"] for row in one.rows})),
            )
        )
    return table(head, rows)


def _files(groups: list[Group], kept: dict[str, str]) -> str:
    head = ("scene", "experiment", "steps", "seed", "bytes", "SHA-256", "file")
    rows = []
    for one in groups:
        for row in one.rows:
            seed, name = str(row["settings"]["seed"]), kept.get(row["run"])
            file = f"`results/{name}`" if name else "not kept"
            rows.append((*_names(one), seed, f"{row['bytes']:,}", f"`{row['sha256']}`", file))
    return table(head, rows)


def _curves(results: Results, plots: dict[str, str], compared: list[Comparison]) -> list[str]:
    """The points of every curve; against another state."""
    parts: list[str] = []
    for one in results.experiments("curve"):
        groups = results.groups(one.name)
        rows = (
            (
                group.entry.scene,
                group.entry.label,
                spread(group, "psnr", "{:.2f}"),
                spread(group, "bytes", "{:,.0f}"),
                spread(group, "anchors", "{:,.0f}"),
            )
            for group in groups
        )
        image = f"![PSNR against bytes over {one.setting}](results/{plots[one.name]})"
        points = table(("scene", f"`{one.setting}`", "PSNR", "bytes", "anchors"), rows)
        parts += [f"## Curve {one.name}: `{one.setting}`", image, points]
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
        spread(group, "psnr", "{:.2f}"),
        decibel,
        spread(group, "bytes", "{:,.0f}"),
        share,
        f"{group.mean('anchors'):,.0f}",
        f"{group.mean('seconds'):,.0f}",
    )


def table(head: Sequence[str], rows: Rows) -> str:
    """A table as Markdown."""
    lines = [head, ["---"] * len(head), *rows]
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)
