"""The command itself: exit codes, one line an error, and a report of what is finished."""

import importlib.util
import json
import sys

import pytest
from reproduce.table import entries, read_table, run_folder
from reproduce.worker import ROW

from tests.reproduce.conftest import SCRIPTS, row

pytest.importorskip("distributed")
pytest.importorskip("matplotlib")


@pytest.fixture(scope="module")
def script():
    """The module of scripts/reproduce.py; the package of its parts has the plain name."""
    spec = importlib.util.spec_from_file_location("reproduce_script", SCRIPTS / "reproduce.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.fixture
def call(script, table_file, data, tmp_path, capsys):
    """``call(...)``: exit code and the lines of the error output."""

    def run(*words):
        common = ["--table", table_file, "--data", data, "--output", tmp_path / "out"]
        code = script.main([str(word) for word in (*common, *words)])
        return code, capsys.readouterr().err.splitlines()

    return run


@pytest.mark.slow
@pytest.mark.parametrize(
    ("words", "code", "message"),
    [
        (["--table", "absent.toml"], 2, "absent.toml: No such file or directory; name a table"),
        (["--only", "x"], 2, "--only x: no such experiment or scene; the table has main"),
        (["--data", "absent"], 3, "absent: no such folder; name that of the scenes by --data"),
        (["--baseline", "absent.json"], 3, "absent.json: No such file or directory; give the"),
    ],
)
def test_what_cannot_be_is_one_line(call, words, code, message):
    found, lines = call(*words)
    assert found == code
    assert len(lines) == 1
    assert lines[0].startswith(f"reproduce: error: {message}")


@pytest.mark.parametrize("words", [["--steps", "0"], ["--workers", "x"], ["--unknown"]])
def test_wrong_options_are_refused(script, words):
    with pytest.raises(SystemExit) as stopped:
        script.main(words)
    assert stopped.value.code == 2


def test_without_dask_one_line_says_what_to_install(call, monkeypatch):
    monkeypatch.setitem(sys.modules, "distributed", None)
    assert call() == (1, ['reproduce: error: tasks need dask: pip install "clgs[distributed]"'])


@pytest.mark.slow
def test_no_scheduler_is_one_line(call, monkeypatch):
    monkeypatch.setattr("clgs.cluster.engine.CONNECT_SECONDS", 1)
    code, lines = call("--scheduler", "tcp://127.0.0.1:1")
    assert code == 2
    assert lines[-1].startswith("reproduce: error: --scheduler tcp://127.0.0.1:1: no scheduler")


def test_finished_runs_are_read_and_reported(call, table_file, tmp_path):
    for one in entries(read_table(table_file), 20):
        folder = run_folder(tmp_path / "out", one.run)
        folder.mkdir(parents=True, exist_ok=True)
        (folder / ROW).write_text(json.dumps(row(one.run, settings=one.settings)))
        (folder / "scene.clgs").touch()
    (tmp_path / "docs").mkdir()
    assert call("--steps", "20", "--report", tmp_path / "docs") == (0, [])
    text = (tmp_path / "docs" / "results.md").read_text()
    assert "Made by `scripts/reproduce.py --table table.toml --steps 20`" in text
    assert "Not finished" not in text


@pytest.mark.slow
def test_a_run_that_fails_is_named_and_the_others_go_on(call, table_file, data, tmp_path):
    text = table_file.read_text().replace('scenes = ["balls"]', 'scenes = ["balls", "gone"]', 1)
    table_file.write_text(text + '\n[scene.gone]\ndata = "gone"\nsettings = { steps = 20 }\n')
    code, lines = call("--steps", "10", "--only", "main")
    assert code == 3
    gone = [line for line in lines if line.startswith("reproduce: gone main seed ")]
    assert len(gone) == 2
    assert all(f"{data / 'gone'}: no such folder" in line for line in gone)
    page = (tmp_path / "out" / "results.md").read_text()
    assert "| balls | main | 10 | 2 |" in page
    assert "gone" in page.split("## Not finished")[1]
