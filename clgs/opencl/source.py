"""Read the OpenCL sources in ``kernels_cl/`` and expand their includes."""

from __future__ import annotations

import importlib.resources
import re
from importlib.resources.abc import Traversable

_INCLUDE = re.compile(r'\s*#include\s+"(?P<name>[^"]+)"\s*')


def kernel_root() -> Traversable:
    """Folder of the shipped kernels, in a wheel and in an editable install alike."""
    return importlib.resources.files("clgs") / "kernels_cl"


def program_files() -> list[str]:
    """Files of all programs, relative to the root, such as "blend/blend.cl"."""
    rooms = [entry for entry in kernel_root().iterdir() if entry.is_dir()]
    files = [f"{room.name}/{file.name}" for room in rooms for file in room.iterdir()]
    return sorted(name for name in files if name.endswith(".cl"))


def programs_of_form(form: str) -> dict[str, str]:
    """The names of all programs of a form ("cpu", "gpu"), each with its file."""
    other = "_gpu" if form == "cpu" else "_cpu"
    files = [name for name in program_files() if not name.endswith(f"{other}.cl")]
    return {name.removesuffix(".cl").removesuffix(f"_{form}"): name for name in files}


def program_file(program: str, form: str) -> str:
    """File of a program such as "blend/forward", relative to the root.

    ``<program>_<form>.cl`` if the forms ("cpu", "gpu") have files of their own, else
    ``<program>.cl``.
    """
    own = f"{program}_{form}.cl"
    return own if kernel_root().joinpath(*own.split("/")).is_file() else f"{program}.cl"


def read_program(name: str) -> str:
    """Source text of one program, includes expanded once, ``#line`` marks kept."""
    return _expand(name, seen=set())


def _expand(name: str, seen: set[str]) -> str:
    seen.add(name)
    out = [f'#line 1 "{name}"']
    text = kernel_root().joinpath(*name.split("/")).read_text(encoding="utf-8")
    for number, line in enumerate(text.splitlines(), start=1):
        include = _INCLUDE.fullmatch(line)
        if include is None:
            out.append(line)
            continue
        if include["name"] not in seen:
            out.append(_expand(include["name"], seen))
        out.append(f'#line {number + 1} "{name}"')
    return "\n".join(out)
