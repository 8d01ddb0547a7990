"""Whether a native module can be imported, tried in a process of its own: an import may abort."""

from __future__ import annotations

import subprocess
import sys

SECONDS = 60
"""After so long an import counts as failed."""


def import_problem(module: str) -> str:
    """Why ``module`` cannot be imported here, in a few words; empty if it can be."""
    # Pillow first, as in pycolmap_lazy.
    code = f"import sys; sys.path[:] = {sys.path!r}; import PIL.Image; import {module}"
    try:
        done = subprocess.run(
            [sys.executable, "-c", code],
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.PIPE,
            timeout=SECONDS,
        )
    except subprocess.TimeoutExpired:
        return f"its import takes more than {SECONDS} s"
    if done.returncode < 0:
        return f"its import ends by signal {-done.returncode}"
    if done.returncode:
        lines = done.stderr.decode(errors="replace").split("\n")
        return next((line.strip() for line in reversed(lines) if line.strip()), "unknown error")
    return ""
