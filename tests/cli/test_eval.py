"""`clgs eval`, and the files that it writes for other tools."""

import json
import shutil

import numpy as np
import pytest

from clgs.cli import main as cli
from clgs.codec.scene_encoder import encode
from clgs.scene.storage import save_scene
from clgs.train.config import preset
from tests.codec.scenes import random_scene
from tests.small_scene import write_scene
from tests.train.quality.lpips_reference import random_weights


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A data set of two test views, and a scene and a table of settings next to each other."""
    folder = tmp_path_factory.mktemp("eval")
    write_scene(folder / "data", train=2, test=2)
    (folder / "run").mkdir()
    scene = random_scene(np.random.default_rng(1), 200)
    (folder / "run" / "scene.clgs").write_bytes(encode(scene))
    (folder / "run" / "config.toml").write_text(preset("quick").scaled(700).to_toml())
    return folder


def printed(folder, capsys, *options):
    """What `clgs eval` prints."""
    scene = folder / "run" / "scene.clgs"
    code = cli.main(["eval", str(scene), "--data", str(folder / "data"), *map(str, options)])
    out, err = capsys.readouterr()
    assert code == 0, err
    return out


def evaluate(folder, capsys, *options):
    """What `clgs eval --json` prints."""
    return json.loads(printed(folder, capsys, *options, "--json"))


def test_people_get_a_table_and_programs_a_file(folder, capsys, tmp_path):
    rows = printed(folder, capsys, "--json", tmp_path / "scores.json").splitlines()
    scores = json.loads((tmp_path / "scores.json").read_text())
    assert [row.split("  ", 1)[0] for row in rows] == [
        *("views", "PSNR", "PSNR, channel mean", "SSIM", "bytes", "anchors")
    ]
    assert rows[0].endswith("  2 (test)")
    assert rows[1].endswith(f"  {scores['psnr']:.2f} dB")
    assert rows[4].endswith(f"  {scores['bytes']:,}")
    assert len({row.rindex("  ") for row in rows}) == 1
    assert len(scores["per_view"]) == 2
    again = printed(folder, capsys, "--json", tmp_path / "scores.json", "--overwrite")
    assert again.splitlines() == rows


@pytest.mark.slow
def test_all_files_hold_the_same_scores(folder, capsys, tmp_path):
    pytest.importorskip("onnxruntime", reason='pip install "clgs[lpips]"')
    np.savez(tmp_path / "weights.npz", **random_weights())
    shown = printed(
        folder, capsys, "--lpips", tmp_path / "weights.npz", "--json", tmp_path / "scores.json",
        "--inria", tmp_path / "scores", "--csv", tmp_path / "scene.csv",
    )  # fmt: skip
    summary = json.loads((tmp_path / "scores.json").read_text())
    assert f"{summary['lpips']:.4f}" in shown
    assert summary["lpips"] > 0
    assert summary["psnr_channel_mean"] > summary["psnr"]
    assert 0 < summary["gaussians"] < 10 * summary["anchors"]
    results = json.loads((tmp_path / "scores" / "results.json").read_text())
    assert results == {
        "ours_700": {
            "SSIM": summary["ssim"],
            "PSNR": summary["psnr"],
            "LPIPS": summary["lpips"],
            "PSNR channel mean": summary["psnr_channel_mean"],
        }
    }
    views = json.loads((tmp_path / "scores" / "per_view.json").read_text())["ours_700"]
    assert views["LPIPS"] == {f"r_{i}.png": summary["per_view"][i]["lpips"] for i in range(2)}
    names = ("psnr", "ssim", "lpips", "bytes", "gaussians")
    row = ",".join(["Baseline", *(str(summary[name]) for name in names)])
    assert (tmp_path / "scene.csv").read_text().splitlines()[1:] == [row]


def test_rows_without_lpips_are_added_by_name(folder, capsys, tmp_path):
    for name in ("-small", ""):
        summary = evaluate(folder, capsys, "--csv", tmp_path / "x.csv", f"--submethod={name}")
        assert "lpips" not in summary
    rows = (tmp_path / "x.csv").read_text().splitlines()
    assert [row.split(",")[0] for row in rows] == ["Submethod", "-small", ""]
    assert rows[1].split(",")[3] == ""


def test_a_run_is_scored_by_its_file(folder, capsys, output_of, refusal, tmp_path):
    run = tmp_path / "run"
    shutil.copytree(folder / "run", run)
    save_scene(run / "scene.npz", random_scene(np.random.default_rng(7), 50))
    about = ["eval", str(run), "--data", str(folder / "data"), "--json"]
    assert json.loads(output_of(*about))["psnr"] == evaluate(folder, capsys)["psnr"]
    (run / "scene.clgs").write_bytes((run / "scene.clgs").read_bytes()[:1000])
    assert f"{run / 'scene.clgs'}: " in refusal(3, *about)


def test_photos_that_are_gone_are_named(folder, refusal, tmp_path):
    run = tmp_path / "run"
    shutil.copytree(folder / "run", run)
    there = {"folder": str(tmp_path / "gone"), "relative": "../gone", "radius": 1.0, "cameras": {}}
    (run / "data.json").write_text(json.dumps(there))
    said = f"the data set {tmp_path / 'gone'} is gone; name it with --data"
    for words in (["eval", str(run)], ["render", str(run), "-o", str(tmp_path / "pictures")]):
        assert said in refusal(2, *words)


def test_a_run_that_is_not_there_is_named(tmp_path, refusal):
    assert "run: no such file or folder" in refusal(3, "eval", tmp_path / "run")
