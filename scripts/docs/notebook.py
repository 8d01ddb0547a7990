"""The notebook of the documentation as a page, and as the program that its cells are.

A notebook is JSON; Jupyter is needed for neither.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

NOTEBOOK = Path(__file__).resolve().parents[2] / "docs" / "notebooks" / "first_scene.ipynb"


def page() -> str:
    """The cells below the title as Markdown."""
    parts = []
    for cell in _cells()[1:]:
        text = "".join(cell["source"])
        parts.append(f"```python\n{text}\n```" if cell["cell_type"] == "code" else text)
    return "\n\n".join(parts)


def program() -> str:
    """The code cells, one after the other."""
    code = ["".join(cell["source"]) for cell in _cells() if cell["cell_type"] == "code"]
    return "\n\n".join(code) + "\n"


def _cells() -> list[dict[str, Any]]:
    cells: list[dict[str, Any]] = json.loads(NOTEBOOK.read_text(encoding="utf-8"))["cells"]
    return cells
