"""The notebook of the documentation runs from its first cell to its last."""

import json
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT / "scripts" / "docs"))

import notebook  # noqa: E402 - the folder of the scripts comes first


def test_it_is_stored_without_outputs():
    cells = json.loads(notebook.NOTEBOOK.read_text(encoding="utf-8"))["cells"]
    code = [cell for cell in cells if cell["cell_type"] == "code"]
    assert [cell for cell in code if cell["outputs"] or cell["execution_count"]] == []


def test_every_cell_but_the_title_is_on_its_page():
    page = notebook.page()
    assert "# A first scene" not in page
    cells = json.loads(notebook.NOTEBOOK.read_text(encoding="utf-8"))["cells"]
    assert [cell for cell in cells[1:] if "".join(cell["source"]) not in page] == []


@pytest.mark.slow
def test_its_cells_run(tmp_path):
    program = tmp_path / "first_scene.py"
    program.write_text(notebook.program() + "assert picture.size == (384, 576)\n", encoding="utf-8")
    command = [sys.executable, str(program)]
    done = subprocess.run(command, cwd=notebook.NOTEBOOK.parent, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert "12 photos to train on, 3 held out" in done.stdout
