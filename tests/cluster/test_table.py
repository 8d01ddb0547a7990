"""Tables of scenes: what they give, and what is refused with its place."""

from __future__ import annotations

import pytest

from clgs.cluster.table import read_scenes
from clgs.errors import UsageError

TABLE = """
[settings]
steps = 60
voxel = 0.05

[scene.a]
data = "photos/a"

[scene.b-2]
data = "b"
settings = { steps = 90, "learning_rates.offset" = [0.01, 0.001] }
blocks = "2x1"
"""


@pytest.fixture
def read(tmp_path):
    """``read(text)``: the tasks of a table with that text."""

    def of_text(text):
        (tmp_path / "table.toml").write_text(text)
        return read_scenes(tmp_path / "table.toml", tmp_path / "runs")

    return of_text


def test_scenes_have_the_shared_settings_and_their_own(read, tmp_path):
    first, second = read(TABLE)
    assert first["run"] == "a"
    assert first["data"] == str(tmp_path / "photos" / "a")
    assert first["folder"] == str(tmp_path / "runs" / "a")
    assert first["settings"] == {"steps": 60, "voxel": 0.05}
    rates = {"learning_rates.offset": (0.01, 0.001)}
    assert second["settings"] == {"steps": 90, "voxel": 0.05, **rates}
    assert first["lock"] != second["lock"]
    assert (first["blocks"], second["blocks"]) == (None, "2x1")


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "scene: there is none; write [scene.NAME] and its fields"),
        ("[scene", "not a TOML file"),
        ("[scenes.a]\n", "the table: no field 'scenes'; it may have settings, scene"),
        ("[scene.a]\n", "scene.a.data: give the folder of the data set"),
        ("[scene.a]\ndata = 3\n", "scene.a.data: give the folder of the data set"),
        ('[scene.a]\ndata = "a\\u0000"\n', "scene.a.data: give the folder of the data set"),
        ("[scene]\na = 1\n", "scene.a: is not a table; write [scene.a]"),
        ('[scene."../a"]\ndata = "a"\n', "scene.'../a': is no name"),
        ('[scene.locks]\ndata = "a"\n', "scene.locks: the folder of runs has one of this name"),
        ('[scene.a]\ndata = "a"\nstep = 3\n', "scene.a: no field 'step'; it may have data"),
        ('[scene.a]\ndata = "a"\nblocks = "auto"\n', "scene.a.blocks: a table cannot ask what"),
        ('[scene.a]\ndata = "a"\nblocks = 2\n', "scene.a.blocks: --blocks 2: is not NxM, such as"),
        ('[settings]\nstep = 3\n[scene.a]\ndata = "a"\n', "settings: step: no such setting"),
        (
            '[scene.a]\ndata = "a"\nsettings = { steps = 0 }\n',
            "scene.a.settings: steps: 0 is out of range",
        ),
    ],
)
def test_what_cannot_be_names_its_place(read, tmp_path, text, message):
    with pytest.raises(UsageError) as refused:
        read(text)
    assert str(refused.value).startswith(f"{tmp_path / 'table.toml'}: {message}")


def test_a_byte_order_mark_is_no_part_of_a_table(read):
    assert read("\ufeff" + TABLE) == read(TABLE)


def test_a_table_that_is_not_there_is_named(tmp_path):
    with pytest.raises(UsageError, match=r"absent\.toml: No such file or directory; name a table"):
        read_scenes(tmp_path / "absent.toml", tmp_path)
