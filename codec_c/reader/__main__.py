"""Print what a .clgs file holds: ``python -m codec_c.reader FILE.clgs``."""

from __future__ import annotations

import sys
from pathlib import Path

from .files import Splats, read_file


def main() -> None:
    """Decode the file that the command line names, and print its fields and arrays."""
    found = read_file(Path(sys.argv[1]).read_bytes())
    if isinstance(found, Splats):
        arrays = dict(zip(found.names, found.integers.T, strict=True))
    else:
        print(*(f"{name}: {value}" for name, value in found.meta._asdict().items()), sep="\n")
        arrays = {"positions": found.positions, **found.attributes, "weights": found.weights}
    for name, array in arrays.items():
        least, most = (array.min(), array.max()) if array.size else ("-", "-")
        print(f"{name}: {array.shape} {array.dtype}, {least} to {most}")


if __name__ == "__main__":
    main()
