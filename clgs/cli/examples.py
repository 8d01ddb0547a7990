"""The examples at the end of each command's help."""

from __future__ import annotations

EXAMPLES: dict[str, tuple[str, ...]] = {
    "devices": ("clgs devices", "clgs devices --json"),
    "prepare": ("clgs prepare PHOTOS -o data", "clgs prepare PHOTOS -o data --quick"),
    "train": (
        "clgs train data -o run --preset quick --downscale 4",
        "clgs train data -o run --preset quick --downscale 4 --resume",
        "clgs train data -o small --target-size 500000",
    ),
    "encode": (
        "clgs encode run -o scene.clgs --level max",
        "clgs encode run -o small.clgs --target-size 600k --data data",
    ),
    "decode": (
        "clgs decode scene.clgs -o scene.npz",
        "clgs decode scene.clgs -o part.npz --box -1,-1,-1,1,1,1",
    ),
    "pack": ("clgs pack splat.ply -o splat.clgs --step scale=0.03",),
    "unpack": ("clgs unpack splat.clgs -o splat.ply",),
    "render": (
        "clgs render run --data data -o views",
        "clgs render run/scene.clgs --data data --split train -o views",
    ),
    "eval": (
        "clgs eval run --data data",
        "clgs eval run/scene.clgs --data data --json scores.json",
        "clgs eval run --hashes run/hashes.json",
    ),
    "export": ("clgs export data -o cameras.glb",),
    "info": ("clgs info scene.clgs", "clgs info scene.clgs --json"),
    "selftest": ("clgs selftest", "clgs selftest --device 0 --verbose"),
    "bench": ("clgs bench step", "clgs bench ops --help"),
    "conformance": (
        "clgs conformance -o here.json",
        "clgs conformance --check there.json",
    ),
}
"""By command."""


def epilog(command: str) -> str:
    """The last paragraph of the command's help."""
    return "\n  ".join(("examples:", *EXAMPLES[command]))
