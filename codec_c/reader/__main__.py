"""Print what a .clgs file holds: ``python -m codec_c.reader FILE.clgs``."""

from __future__ import annotations

import os
import sys
from pathlib import Path

from .files import Splats, read_file


def main(arguments: list[str]) -> str:
    """Print the fields and arrays of the file that the command line names; what is wrong, or ""."""
    if len(arguments) != 1:
        return "name one file: python -m codec_c.reader FILE.clgs"
    try:
        found = read_file(Path(arguments[0]).read_bytes())
    except (OSError, ValueError) as error:
        return f"{arguments[0]}: {getattr(error, 'strerror', None) or error}"
    if isinstance(found, Splats):
        arrays = dict(zip(found.names, found.integers.T, strict=True))
    else:
        print(*(f"{name}: {value}" for name, value in found.meta._asdict().items()), sep="\n")
        if found.layers[1]:
            print("layers: {} of {}".format(*found.layers))
        arrays = {"positions": found.positions, **found.attributes, "weights": found.weights}
    for name, array in arrays.items():
        least, most = (array.min(), array.max()) if array.size else ("-", "-")
        print(f"{name}: {array.shape} {array.dtype}, {least} to {most}")
    return ""


if __name__ == "__main__":
    try:
        problem = main(sys.argv[1:])
        sys.stdout.flush()
    except BrokenPipeError:  # the reader went away, as in `... | head`
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        sys.exit(0)
    sys.exit(f"error: {problem}" if problem else 0)
