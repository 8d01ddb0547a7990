"""What the commands refuse before they begin, and what they say then."""

import json
import os
import shutil
import threading
from unittest.mock import Mock

import numpy as np
import pytest

from clgs.cli import main as cli
from clgs.codec.scene_encoder import encode
from clgs.data.splats.anchors import save_scaffold
from clgs.errors import DataError
from clgs.scene.storage import load_scene, save_scene
from clgs.train.state.hashes import read_fingerprint
from clgs.workflow.scenes import read_bytes
from tests.codec.scenes import random_scene

CAMERA = {
    "rotation": np.eye(3).tolist(), "translation": [0, 0, 4],
    "fx": 50.0, "fy": 50.0, "cx": 25.0, "cy": 25.0, "width": 50, "height": 50,
}  # fmt: skip
HASHES = {"scene": "0" * 64, "renders": ["1" * 64], "cameras": [CAMERA]}


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    folder = tmp_path_factory.mktemp("files")
    scene = random_scene(np.random.default_rng(3), 5)
    (folder / "s.clgs").write_bytes(encode(scene))
    save_scene(folder / "s.npz", scene)
    save_scaffold(folder / "s.ply", scene)
    save_scaffold(folder / "s.quantized.ply", scene)
    (folder / "folder").mkdir()
    (folder / "begun").mkdir()
    for name in ("file", "begun/config.toml"):
        (folder / name).touch()
    (folder / "link").symlink_to("s.ply")
    return folder


@pytest.fixture
def work(files, tmp_path, monkeypatch):
    monkeypatch.chdir(shutil.copytree(files, tmp_path, symlinks=True, dirs_exist_ok=True))
    return tmp_path


@pytest.mark.parametrize(
    ("command", "code", "said"),
    [
        ("encode s.npz -o nodir/x.clgs", 2, "nodir/x.clgs: cannot be written: there is no folder"),
        ("encode s.npz -o folder", 2, "folder: is a folder; name a file"),
        (f"encode s.npz -o {os.devnull}", 2, f"{os.devnull}: is not a regular file"),
        ("encode s.npz -o file/x.clgs", 2, "file/x.clgs: cannot be written: there is no folder"),
        (f"encode s.npz -o {'x' * 256}", 2, f"{'x' * 256}: File name too long; choose another"),
        ("pack s.ply -o nodir/x.clgs", 2, "nodir/x.clgs: cannot be written: there is no folder"),
        ("pack s.ply -o folder", 2, "folder: is a folder; name a file"),
        ("unpack s.clgs -o nodir/x.ply", 2, "nodir/x.ply: cannot be written: there is no folder"),
        ("unpack s.clgs -o file/x.ply", 2, "file/x.ply: cannot be written: there is no folder"),
        ("decode s.clgs -o file/x.npz", 2, "file/x.npz: cannot be written: there is no folder"),
        ("decode s.clgs -o x", 2, "x: the output must end in .npz"),
        ("decode s.clgs -o nodir/x.npz", 2, "nodir/x.npz: cannot be written"),
        ("decode s.clgs -o s.npz", 2, "s.npz: exists already; add --overwrite or choose another"),
        ("decode s.clgs -o s.ply", 2, "s.ply: exists already; add --overwrite or choose another"),
        ("encode s.npz -o s.clgs", 2, "s.clgs: exists already; add --overwrite or choose another"),
        ("pack s.ply -o s.clgs", 2, "s.clgs: exists already; add --overwrite or choose another"),
        ("unpack s.clgs -o s.ply", 2, "s.ply: exists already; add --overwrite or choose another"),
        ("unpack s.clgs -o x.spz", 2, "x.spz: the output is a .ply file; name it so"),
        ("encode s.npz -o y.zip", 2, "y.zip: the output is a .clgs file; name it so"),
        ("encode s.npz -o x", 2, "x: the output is a .clgs file; name it so"),
        ("pack s.ply -o config.toml", 2, "config.toml: the output is a .clgs file; name it so"),
        ("pack s.ply -o x.clgs", 3, "s.ply: holds anchors, no splats; `clgs encode` takes it"),
        ("train folder -o x --resume --overwrite", 2, "--resume goes on with a run and"),
        ("prepare file -o new", 3, "file: is a file; name the folder of the photos"),
        ("train file -o new", 3, "file: is a file; name the folder of the data set"),
        ("decode folder -o x.npz", 3, "folder: is a folder; name a .clgs file"),
        ("decode folder -o x.npz --box 0,0,0,1,1,1", 3, "folder: is a folder; name a .clgs file"),
        ("decode s.clgs -o x.npz --box 0,0,0,1,1", 2, "--box: 0,0,0,1,1: 6 numbers are needed"),
        ("decode s.clgs -o x.npz --box 0,0,a,1,1,1", 2, "--box: 0,0,a,1,1,1: 6 numbers"),
        ("decode s.clgs -o x.npz --box 0,0,0,1,-1,1", 2, "box: y from 0 to -1 is empty"),
        ("decode s.clgs -o x.npz --box nan,0,0,1,1,1", 2, "box: x from nan to 1 is empty"),
        ("decode s.clgs -o x.npz --threads 0", 2, "--threads: 0 is not a whole number from 1"),
        ("decode file -o x.npz --box 0,0,0,1,1,1", 3, "file: header at byte 0: the file is empty"),
        ("encode s.npz -o x.clgs --level best", 2, "level: 'best'; known are fast, default, max"),
        ("encode s.npz -o x.clgs --chunk 15", 2, "chunk: 15; 16 to 1048576 anchors are possible"),
        ("encode s.npz -o x.clgs --chunk -1", 2, "--chunk: -1 is not a whole number from 1"),
        ("encode s.npz -o x.clgs --threads 0", 2, "--threads: 0 is not a whole number from 1"),
        ("encode s.npz -o s.npz", 2, "s.npz: is read by this command; choose another output"),
        ("encode s.clgs -o ./s.clgs --level max", 2, "s.clgs: is read by this command"),
        ("encode s.ply -o s.mlps.npz", 2, "s.mlps.npz: is read by this command"),
        ("encode s.ply --mlps s.npz -o s.npz", 2, "s.npz: is read by this command"),
        ("encode link -o s.ply", 2, "s.ply: is read by this command"),
        ("pack s.ply -o link", 2, "link: is read by this command"),
        ("unpack s.clgs -o s.clgs", 2, "s.clgs: is read by this command"),
        ("decode s.npz -o s.npz", 2, "s.npz: is read by this command"),
        ("decode s.mlps.npz -o s.ply", 2, "s.mlps.npz: is read by this command"),
        ("decode s.clgs -o nodir/x.ply", 2, "nodir/x.ply: cannot be written"),
        ("encode s.quantized.ply -o x.clgs --q 100,1,1,8", 2, "s.quantized.ply: its integers"),
        ("encode s.npz -o x.clgs --q 100,1,1,8", 2, "s.npz: --mlps and --q are for a PLY file"),
        (
            "encode s.ply -o x.clgs --q 1e15,1,1,8",
            3,
            "s.ply: z of row 0 is -0.045, beyond int32 at",
        ),
        ("encode s.ply -o x.clgs --q 1e8,1,1,8", 3, "s.ply: position: x spans "),
        ("encode s.ply -o x.clgs --q 1e-9,1,1,8", 3, "s.ply: position: rows 0 and 1 share cell"),
        ("info folder", 3, "folder: is a folder; name a .clgs file"),
        ("info begun", 3, "begun: is a folder; let `clgs train` finish (--resume)"),
        (f"info {os.devnull}", 3, f"{os.devnull}: is neither a file nor a pipe"),
        ("encode s.clgs -o new.npz", 2, "new.npz: the output is a .clgs file; name it so"),
        ("pack s.ply -o new.PLY", 2, "new.PLY: the output is a .clgs file; name it so"),
        ("pack s.ply -o x.clgs --step a=1 --step a=2", 2, "--step a: is given more than once"),
        ("pack none.ply -o x.clgs", 3, "none.ply: no such file; name a .ply file"),
        ("unpack none.clgs -o x.ply", 3, "none.clgs: no such file; `clgs encode` and `clgs pack`"),
        ("bench codec none.clgs", 3, "none.clgs: No such file or directory; name a .npz or .clgs"),
        ("bench codec file", 3, "file: is no .npz archive with `values` or `positions`, and no"),
        ("eval s.clgs", 2, "the photos are not known; name their data set with --data"),
        ("eval none.clgs --data none --json nodir/x.json", 2, "nodir/x.json: cannot be written"),
        ("eval none.clgs --data none --csv nodir/x.csv", 2, "nodir/x.csv: cannot be written"),
        ("eval s.clgs --data none --csv x.txt", 2, "x.txt: the table is a .csv file; name it so"),
        (
            "render none -o new",
            3,
            "none: no such file or folder; name a run folder or a .clgs file",
        ),
        ("eval s.clgs --csv x.csv", 2, "--csv: scores need photos; name them with --data"),
        ("eval s.clgs --hashes file --inria new", 2, "--inria: scores need photos"),
        ("eval s.clgs --data none --inria file", 2, "file: is no folder"),
        ("eval s.clgs --data none --json n/results.json --inria n", 2, "n/results.json: cannot be"),
        ("eval s.npz --data none --csv x.csv", 2, "s.npz: has no size in bytes for --csv"),
        ("eval s.clgs --data none --submethod a", 2, "--submethod: names a row of --csv"),
        ("eval s.clgs --data none --lpips none.npz", 3, "none.npz: no such file; name the .npz"),
        ("eval s.clgs --data none --lpips s.npz", 3, "s.npz: not the weights of LPIPS with VGG-16"),
        ("bench step --json nodir/x.json", 2, "nodir/x.json: cannot be written"),
        ("render s.clgs --data none -o file", 2, "file: is no folder"),
        ("train folder -o new --from folder", 3, "folder: holds no finished run; name one"),
        ("train folder -o new --from file", 3, "file: holds no finished run; name one"),
        ("run folder -o new --clip circle", 2, "--clip circle: is not orbit, spiral, interpolate"),
        ("run folder -o new --clip no.json --plan", 3, "no.json: "),
        ("run folder -o new --clip-size 641x480", 2, "--clip-size 641x480: a video needs even"),
        ("run folder -o new --set steps=5", 2, "steps: the plan decides it; give --steps"),
        ("prepare folder -o new", 3, "folder: 0 photos that can be read (JPEG, PNG, WebP, HEIC)"),
    ],
)
def test_refusals_are_one_line(work, refusal, command, code, said):
    before = sorted(work.iterdir())
    assert refusal(code, *command.split()).startswith(said)
    assert sorted(work.iterdir()) == before


def test_what_exists_is_replaced_with_overwrite(work, capsys):
    whole = (work / "s.clgs").read_bytes()
    for name in ("x.clgs", "x.npz", "x.ply", "x.mlps.npz"):
        (work / name).write_bytes(b"mine")
    assert cli.main(["encode", "s.npz", "-o", "x.clgs", "--overwrite"]) == 0
    assert (work / "x.clgs").read_bytes() == whole
    for name in ("x.npz", "x.ply"):
        assert cli.main(["decode", "s.clgs", "-o", name, "--overwrite"]) == 0
        assert cli.main(["encode", name, "-o", "x.clgs", "--overwrite"]) == 0
        assert (work / "x.clgs").read_bytes() == whole


def test_an_input_without_permission_is_bad_data(work, refusal, monkeypatch):
    denied = PermissionError(13, "Permission denied", "s.clgs")
    monkeypatch.setattr("pathlib.Path.read_bytes", Mock(side_effect=denied))
    assert refusal(3, "info", "s.clgs").startswith("s.clgs: may not be read; give")


def test_encode_writes_through_a_link(work, capsys):
    (work / "link.clgs").symlink_to(work / "folder" / "real.clgs")
    assert cli.main(["encode", "s.npz", "-o", "link.clgs"]) == 0
    assert (work / "link.clgs").is_symlink()
    assert (work / "folder" / "real.clgs").read_bytes() == (work / "s.clgs").read_bytes()


def test_the_case_of_suffixes_does_not_matter(work, capsys):
    whole = (work / "s.clgs").read_bytes()
    for name in ("T.PLY", "T.Quantized.Ply", "U.NPZ"):
        assert cli.main(["decode", "s.clgs", "-o", name]) == 0
        assert cli.main(["encode", name, "-o", f"{name}.CLGS"]) == 0
        assert (work / f"{name}.CLGS").read_bytes() == whole
    assert (work / "T.mlps.npz").is_file()
    said = capsys.readouterr().out.splitlines()
    assert [line.partition("; ")[2] for line in said[::2]] == ["MLPs in T.mlps.npz"] * 2 + [""]
    assert cli.main(["decode", "T.PLY.CLGS", "-o", "v.npz"]) == 0
    assert (work / "v.npz").read_bytes() == (work / "U.NPZ").read_bytes()


def test_decode_takes_no_name_that_it_was_not_given(work, refusal):
    (work / "x.mlps.npz").write_bytes(b"mine")
    before = {path: path.is_file() and path.read_bytes() for path in work.iterdir()}
    said = refusal(2, "decode", "s.clgs", "-o", "x.ply")
    assert said.startswith("x.mlps.npz: exists and holds other MLPs; remove it")
    (work / "x.mlps.npz").unlink()
    (work / "x.mlps.npz").mkdir()
    assert refusal(2, "decode", "s.clgs", "-o", "x.ply").startswith("x.mlps.npz: is a folder")
    (work / "x.mlps.npz").rmdir()
    (work / "x.mlps.npz").write_bytes(b"mine")
    assert {path: path.is_file() and path.read_bytes() for path in work.iterdir()} == before


def test_levels_and_chunks_reach_the_file(work, output_of):
    """--threads changes no byte; what the options were is shown by info."""
    for options in ("--level fast --threads 1", "--level fast --threads 3"):
        assert cli.main(f"encode s.npz -o {options[-1]}.clgs --chunk 64 {options}".split()) == 0
    assert (work / "1.clgs").read_bytes() == (work / "3.clgs").read_bytes()
    rows = dict(line.split(maxsplit=1) for line in output_of("info", "1.clgs").splitlines())
    assert (rows["version"], rows["level"], rows["chunks.anchors"]) == ("1.0", "fast", "64")


def test_a_box_of_a_file_and_of_a_pipe(work, capsys, output_of):
    """Negative numbers need no equals sign; a pipe cannot seek, and gives the same."""
    scene = random_scene(np.random.default_rng(3), 2000)
    (work / "s.clgs").write_bytes(whole := encode(scene, chunk=64))
    box = "-0.03,-inf,-1,0.01,1,1"  # Q of positions is 200: cells from -6 to 1
    assert cli.main(["decode", "s.clgs", "-o", "part.npz", "--box", box]) == 0
    said = capsys.readouterr().out
    part = load_scene(work / "part.npz")
    x = scene.anchors.position[:, 0]
    assert len(part.anchors) == ((x >= -6) & (x < 2)).sum()
    read = int(said.split(" bytes read")[0].split()[-3].replace(",", ""))
    assert said.strip().endswith(f"anchors in the box, {read:,} of {len(whole):,} bytes read")
    assert read < len(whole)
    assert cli.main(["decode", "s.clgs", "-o", "none.npz", "--box", "8,8,8,9,9,9"]) == 0
    out, err = capsys.readouterr()
    assert out.startswith("none.npz: 0 anchors in the box")
    assert err == "clgs: warning: the box holds no anchors; `clgs info s.clgs` shows where\n"
    rows = dict(line.split(maxsplit=1) for line in output_of("info", "s.clgs").splitlines())
    for name, corner in (("least", scene.anchors.position.min(0)), ("greatest", x.max())):
        found = np.array([float(word) for word in rows[f"extent.{name}"].split()])
        assert np.allclose(found if name == "least" else found[0], corner / 200)
    os.mkfifo(work / "pipe")
    writer = threading.Thread(target=(work / "pipe").write_bytes, args=(whole,))
    writer.start()
    assert cli.main(["decode", "pipe", "-o", "same.npz", "--box", box]) == 0
    writer.join()
    assert (work / "same.npz").read_bytes() == (work / "part.npz").read_bytes()


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="no named pipes")
def test_a_scene_may_come_through_a_pipe(work):
    os.mkfifo(work / "pipe")
    whole = (work / "s.clgs").read_bytes()
    writer = threading.Thread(target=(work / "pipe").write_bytes, args=(whole,))
    writer.start()
    assert read_bytes(work / "pipe") == whole
    writer.join()


def test_hashes_that_are_in_order_are_read(work):
    (work / "h.json").write_text(json.dumps(HASHES))
    assert read_fingerprint(work / "h.json") == HASHES


@pytest.mark.parametrize(
    "wrong",
    [
        [],
        {},
        HASHES | {"renders": [], "cameras": []},
        HASHES | {"renders": ["1" * 64] * 2},
        HASHES | {"scene": 7},
        HASHES | {"renders": ["1"]},
        HASHES | {"accuracy": "best"},
        HASHES | {"accuracy": []},
        HASHES | {"cameras": [7]},
        *(
            HASHES | {"cameras": [CAMERA | change]}
            for change in (
                {"width": 50.5},
                {"width": True},
                {"height": 10**9},
                {"height": 0},
                {"fx": 0},
                {"fx": -1.0},
                {"fy": float("nan")},
                {"cx": 1e300},
                {"cy": None},
                {"cy": "1"},
                {"rotation": [[1, 2], [3]]},
                {"translation": [0, float("inf"), 0]},
                {"translation": [0, 10**400, 0]},
            )
        ),
    ],
)
def test_hashes_that_make_no_sense_are_refused(work, wrong):
    (work / "h.json").write_text(json.dumps(wrong))
    with pytest.raises(DataError, match=r"^\S+h\.json: not a hashes\.json \(.+\)$"):
        read_fingerprint(work / "h.json")


def test_files_that_are_no_hashes_are_refused(work):
    (work / "deep.json").write_text("[" * 100_000)
    (work / "binary.json").write_bytes(b"\xff\xfe\x00")
    for name in ("deep.json", "binary.json", "folder", "none.json"):
        with pytest.raises(DataError, match=name):
            read_fingerprint(work / name)


def test_positions_are_refused_in_words_of_the_options(work, refusal):
    """--q is for floats of a PLY file alone."""
    scene = load_scene(work / "s.npz")
    scene.anchors.position[0] += 2**21
    save_scene(work / "wide.npz", scene)
    save_scaffold(work / "wide.quantized.ply", scene)
    for name in ("wide.npz", "wide.quantized.ply"):
        said = refusal(3, "encode", name, "-o", "x.clgs")
        assert said.startswith(f"{name}: position: x spans ")
        assert said.endswith(" integers, at most 2097152 fit; crop the scene\n")
    assert refusal(3, "encode", "s.ply", "-o", "x.clgs", "--q", "1e8,1,1,8").endswith(
        "; crop the scene, or give a smaller P in --q P,O,A,S\n"
    )
    said = refusal(3, "encode", "s.ply", "-o", "x.clgs", "--q", "1e-9,1,1,8")
    assert said.endswith(", or give a larger P in --q P,O,A,S\n")


@pytest.mark.parametrize("number", ["1e30", "1e-30", "0", "-1", "nan", "inf", "x", ""])
def test_steps_and_q_are_in_range(work, refusal, number):
    for command, option in (
        ("encode s.ply -o x.clgs --q", f"1,{number},1,1"),
        ("pack s.ply -o x.clgs --step", f"x={number}"),
    ):
        said = refusal(2, *command.split(), option).split(": ", 1)[1]
        assert said == f"{number} is not a number from 2^-64 to 2^64 (5.5e-20 to 1.8e19)\n"


@pytest.mark.parametrize("folder", ["file", "file/x", "x" * 300])
def test_a_run_needs_a_folder(work, refusal, folder):
    refusal(2, "train", work, "-o", folder)
    assert not (work / "config.toml").exists()


@pytest.mark.parametrize("output", ["data", "data/images"])
def test_pictures_and_runs_stay_out_of_the_photos(tmp_path, monkeypatch, refusal, output):
    monkeypatch.chdir(tmp_path)
    photo = tmp_path / "data" / "images" / "one.png"
    photo.parent.mkdir(parents=True)
    photo.write_bytes(b"a photo")
    for command in (["render", "s.clgs", "--data", "data"], ["train", "data"]):
        assert "is the folder of the photos" in refusal(2, *command, "-o", output)
    assert photo.read_bytes() == b"a photo"


@pytest.mark.parametrize("output", ["s.clgs", "scores.txt", "data/transforms.json"])
def test_scores_replace_neither_scene_nor_data(tmp_path, monkeypatch, refusal, output):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "data").mkdir()
    for name in ("s.clgs", "data/transforms.json"):
        (tmp_path / name).write_bytes(b"kept")
    refusal(2, "eval", "s.clgs", "--data", "data", "--json", output)
    assert (tmp_path / "s.clgs").read_bytes() == b"kept"
    assert (tmp_path / "data" / "transforms.json").read_bytes() == b"kept"


def test_tables_of_scores_replace_nothing_else(work, refusal):
    (work / "run").mkdir()
    (work / "run" / "config.toml").touch()
    (work / "other.csv").write_text("a,b\n")
    (work / "data").mkdir()
    (work / "data" / "results.json").write_text("kept")
    for option, said in (
        ("--inria run", "run: is a run with scores of its own; name another folder"),
        ("--inria data", "data/results.json: is a file of the data set; choose another output"),
        ("--csv other.csv", "other.csv: line 1 is not Submethod,PSNR,"),
        ("--json folder/results.json --inria folder", "folder/results.json: is written by --inria"),
    ):
        assert refusal(2, *f"eval s.clgs --data data {option}".split()).startswith(said)
    assert (work / "data" / "results.json").read_text() == "kept"
