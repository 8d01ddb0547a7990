"""A run keeps what the world of its data set is, from the cameras to the exported file."""

from __future__ import annotations

import json
from dataclasses import replace

from clgs.cli.main import main
from clgs.data.dataset import load_dataset
from clgs.data.splats.gaussians import load_splats
from clgs.scene.world import EARTH
from clgs.train.config import preset
from clgs.train.run.session import train_scene
from clgs.workflow.export import export
from tests.data.programs.captures import PLACE, Capture

CONFIG = replace(preset("default").scaled(5), voxel=0.05)


def test_the_place_of_a_capture_is_in_all_files(tmp_path, cpu, capsys):
    data = Capture(tmp_path).form("opensfm")
    run = tmp_path / "run"
    dataset = load_dataset(data)
    result = train_scene(dataset, run, CONFIG, device=cpu)
    assert result.scene.transform == dataset.transform
    assert main(["info", str(run / "scene.clgs"), "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["world"].startswith("world: metres east, north and up of latitude 46.9481,")
    assert found["transform"]["centre"] == list(dataset.transform.centre)
    export(run, tmp_path / "scene.ply", data=data, steps=1)
    splats = load_splats(tmp_path / "scene.ply")
    assert (splats.transform.frame, splats.transform.place) == (EARTH, PLACE)
    # the splats lie where the points of the capture are, in its metres
    middle = splats.transform.to_world(splats.gaussians.mean.astype(float)).mean(axis=0)
    assert abs(middle - Capture(tmp_path).points.mean(axis=0)).max() < 1.0
