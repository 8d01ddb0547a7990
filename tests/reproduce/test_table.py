"""The table of runs: what it expands to, and one line for each thing that cannot be."""

from pathlib import Path

import pytest
from reproduce.table import chosen, entries, jobs, read_table

from clgs.errors import UsageError
from clgs.train.config import layered
from tests.reproduce.conftest import SCRIPTS, TABLE


def expand(table, **options):
    return [(one.experiment, one.label, one.seed) for one in entries(table, **options)]


def test_experiments_become_cells(table_file):
    assert expand(read_table(table_file)) == [
        ("main", "", 0),
        ("main", "", 1),
        ("lambda", "0.5", 0),
        ("lambda", "1", 0),
        ("taken-away", "as it is", 0),
        ("taken-away", "lambda 0", 0),
    ]


def test_equal_runs_are_one(table_file, tmp_path):
    table = read_table(table_file)
    found = entries(table)
    run = {(one.experiment, one.label, one.seed): one.run for one in found}
    # 1 is lambda of the scene, so that this is the main row, too
    assert run["main", "", 0] == run["lambda", "1", 0] == run["taken-away", "as it is", 0]
    tasks = jobs(table, found, tmp_path, tmp_path / "out", {"state": "x"})
    assert len(tasks) == len(set(run.values())) == 4
    assert {job["settings"]["seed"] for job in tasks} == {0, 1}
    assert tasks[0]["data"] == str(tmp_path / "balls")
    assert layered(tasks[0]["settings"]).checkpoint_interval == 3


def test_other_steps_are_other_runs_and_move_what_is_named(tmp_path):
    path = tmp_path / "table.toml"
    path.write_text(TABLE.replace("steps = 60", "steps = 60, freeze_step = 60"))
    table = read_table(path)
    found, shorter = entries(table), entries(table, 30)
    assert not {one.run for one in found} & {one.run for one in shorter}
    assert shorter[0].settings["steps"] == shorter[0].settings["freeze_step"] == 30


def test_only_chooses_experiments_and_scenes(table_file):
    table = read_table(table_file)
    found = entries(table)
    assert {one.experiment for one in chosen(table, ["main", "balls"], found)} == {"main"}
    assert chosen(table, ["balls"], found) == chosen(table, [], found) == found
    with pytest.raises(UsageError, match=r"--only x: no such .* the table has main, .*balls"):
        chosen(table, ["x"], found)


def test_the_default_table_is_one():
    table = read_table(SCRIPTS / "reproduce" / "default.toml")
    assert {"mic", "chair", "fox", "fern"} == set(table.scenes)
    assert len(entries(table, 60)) == len(entries(table))
    main = [one for one in entries(table) if one.experiment == "main"]
    assert {one.seed for one in main} == {0, 1, 2}


CASES = [
    ("kind = ", "not a TOML file"),
    ("", "scene: there is none; write [scene.NAME]"),
    ("x = 1", "the table: no field 'x'; it may have scene, experiment"),
    (TABLE.replace('data = "balls"', "data = 3"), "scene.balls.data: give"),
    (TABLE.replace("voxel", "voxl"), "scene.balls.settings: voxl: no such setting; did you mean"),
    (TABLE.replace("0.05", "-1"), "scene.balls.settings: voxel: -1 is out of range"),
    (TABLE.replace("steps = 60", "seed = 1"), "scene.balls.settings: seed is no setting here"),
    (TABLE.replace('"main"', '"maim"'), "experiment.main.kind: 'maim'; give main, curve, ablation"),
    (TABLE.replace("[0, 1]", "[0, true]"), "experiment.main.seeds: [0, True]; give whole numbers"),
    (TABLE.replace("[0, 1]", "[]"), "experiment.main.seeds: []; give whole numbers"),
    (TABLE.replace('["balls"]', '["bulls"]'), "experiment.main.scenes: no scene 'bulls'; there"),
    (TABLE.replace('setting = "size_lambda"', ""), "experiment.lambda.setting: is missing"),
    (
        TABLE.replace("[0.5, 1.0]", "[0.5, 'a']"),
        "experiment.lambda.values: size_lambda: 'a' is not",
    ),
    (TABLE.replace("seeds", "values"), "experiment.main.values: has no meaning here"),
    (TABLE.replace("protocol", "protocoll"), "scene.balls: no field 'protocoll'"),
    (TABLE.replace('"lambda 0" =', '"as it is" ='), "'as it is' is what the experiment's own"),
    (TABLE.replace("[experiment.lambda]", "[experiment.balls]"), "balls: names a scene and an"),
    (TABLE.replace("size_lambda = 0.0", "freeze_step = 1"), "taken-away: lambda 0, balls: "),
]


@pytest.mark.parametrize(("text", "message"), CASES, ids=[message for _, message in CASES])
def test_a_wrong_table_is_one_line(tmp_path, text, message):
    path = tmp_path / "table.toml"
    path.write_text(text)
    with pytest.raises(UsageError) as error:
        read_table(path)
    line = str(error.value)
    assert line.startswith(f"{path}: ")
    assert message in line
    assert "\n" not in line
    assert error.value.exit_code == 2


def test_a_missing_table_is_named():
    with pytest.raises(UsageError, match=r"absent\.toml: No such file"):
        read_table(Path("absent.toml"))
