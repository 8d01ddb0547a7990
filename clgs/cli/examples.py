"""The examples at the end of each command's help."""

from __future__ import annotations

EXAMPLES: dict[str, tuple[str, ...]] = {
    "run": (
        "clgs run PHOTOS -o scene --time 5m",
        "clgs run data -o scene --steps 3000 --max-size 800",
    ),
    "devices": ("clgs devices", "clgs devices --json"),
    "doctor": ("clgs doctor", "clgs doctor data", "clgs doctor data --json"),
    "prepare": (
        "clgs prepare PHOTOS -o data",
        "clgs prepare clip.mp4 -o data --frames 80",
        "clgs prepare PHOTOS -o data --drop-doubtful",
        "clgs prepare PHOTOS -o data --quick",
    ),
    "train": (
        "clgs train data -o run --preset quick --downscale 4",
        "clgs train data -o run --preset quick --downscale 4 --resume",
        "clgs train data -o small --target-size 500000",
        "clgs train data -o longer --from run --steps 6000",
    ),
    "batch": (
        "clgs batch scenes.toml -o runs --workers 2",
        "clgs batch scenes.toml -o runs --scheduler tls://host:8786",
    ),
    "encode": (
        "clgs encode run -o scene.clgs --level max",
        "clgs encode run -o small.clgs --target-size 600k --data data",
    ),
    "decode": (
        "clgs decode scene.clgs -o scene.npz",
        "clgs decode scene.clgs -o part.npz --box -1,-1,-1,1,1,1",
    ),
    "crop": (
        "clgs crop run -o part.clgs --box -1,-1,-1,1,1,1",
        "clgs crop run -o object.clgs --object --seen 3",
        "clgs crop scene.clgs -o near.clgs --sphere 0,0,0,2 --data data",
    ),
    "pack": ("clgs pack splat.ply -o splat.clgs --step scale=0.03",),
    "unpack": ("clgs unpack splat.clgs -o splat.ply",),
    "render": (
        "clgs render run --data data -o views",
        "clgs render run/scene.clgs --data data --split train -o views",
        "clgs render run --data data --path orbit -o clip.mp4 --size 800x600",
        "clgs render splats.ply --path camera_path.json -o frames --depth",
    ),
    "eval": (
        "clgs eval run --data data",
        "clgs eval run/scene.clgs --data data --json scores.json",
        "clgs eval run --hashes run/hashes.json",
        "clgs eval splats.ply --data data --background white",
    ),
    "view": ("clgs view run --data data", "clgs view splats.ply --port 9000"),
    "export": (
        "clgs export run -o scene.html",
        "clgs export --viewer -o viewer.html",
        "clgs export run -o scene.ply",
        "clgs export run/scene.clgs --data data -o scene.sog --sh-degree 1",
        "clgs export data -o cameras.glb",
    ),
    "info": ("clgs info scene.clgs", "clgs info scene.clgs --json"),
    "selftest": ("clgs selftest", "clgs selftest --device 0 --verbose"),
    "bench": ("clgs bench step", "clgs bench ops --help"),
    "accept": (
        "clgs accept -o accept.json",
        "clgs accept -o accept.json --device 1 --data DATA --downscale 8",
    ),
    "conformance": ("clgs conformance -o here.json", "clgs conformance --check there.json"),
}
"""The examples of each command."""


def epilog(command: str) -> str:
    """The last paragraph of the command's help."""
    return "\n  ".join(("examples:", *EXAMPLES[command]))
