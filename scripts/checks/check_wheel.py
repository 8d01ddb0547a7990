"""Check that a wheel holds every file of the package: ``check_wheel.py WHEEL``.

A build backend packs an empty kernel folder without complaint; this finds it.
"""

from __future__ import annotations

import re
import subprocess
import sys
import zipfile
from collections.abc import Iterable
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
FOLDERS = ("clgs", "kernels_cl", "web/page")
PAGE_DECODER = "clgs/web/scene.wasm"
"""Built where there is a compiler for WebAssembly; a wheel may lack it."""
BUILT = {"extension clgs/_codec.*": re.compile(r"clgs/_codec\.[\w.-]*(so|pyd)")}
"""Files that the build makes, one of each."""


def main(arguments: list[str]) -> int:
    """Print what is wrong with the wheel; exit code 1 if anything is, 2 for wrong usage."""
    if len(arguments) != 1:
        print("usage: check_wheel.py WHEEL", file=sys.stderr)
        return 2
    with zipfile.ZipFile(arguments[0]) as wheel:
        names = wheel.namelist()
    tracked = tracked_files()
    found = complaints(tracked, names)
    for complaint in found:
        print(f"check_wheel: {complaint}", file=sys.stderr)
    if not found:
        print(f"check_wheel: {len(tracked)} files of the package, {len(BUILT)} built, are there")
    return 1 if found else 0


def tracked_files() -> list[str]:
    """Files of the package, the kernels and the web page that git knows, new ones included."""
    # The checkout may belong to another user, as in a container.
    git = ["git", "-c", f"safe.directory={ROOT}", "-C", str(ROOT), "ls-files"]
    command = [*git, "--cached", "--others", "--exclude-standard", "--", *FOLDERS]
    listing = subprocess.run(command, check=True, capture_output=True, text=True).stdout
    return [name for name in listing.splitlines() if (ROOT / name).is_file()]


def complaints(tracked: Iterable[str], names: Iterable[str]) -> list[str]:
    """What is missing from, or too much in, a wheel with these ``names``."""
    expected = {n if n.startswith("clgs/") else f"clgs/{n}" for n in tracked}
    packed = {name for name in names if not name.endswith("/")}
    found = [f"missing: {name}" for name in sorted(expected - packed)]
    built: set[str] = set()
    for what, pattern in BUILT.items():
        made = {name for name in packed if pattern.fullmatch(name)}
        if len(made) != 1:
            found.append(f"expected one {what}, found {len(made)}")
        built |= made
    if not any(name.endswith(".cl") for name in packed):
        found.append("no kernels")
    metadata = {name for name in packed if name.split("/")[0].endswith(".dist-info")}
    surplus = packed - expected - built - metadata - {PAGE_DECODER}
    return found + [f"not of the package: {name}" for name in sorted(surplus)]


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
