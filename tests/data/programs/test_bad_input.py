"""Files of other programs that are damaged or hold what is not read: one line that says so."""

import json
import shutil

import numpy as np
import pytest

from clgs.data.dataset import read_photo_set
from clgs.data.lens import Lens
from clgs.doctor.dataset import examine
from clgs.errors import DataError
from tests.data.programs.captures import SIZE, Capture, metashape_xml

FILES = {
    "metashape": "cameras.xml",
    "realityscan": "parameters.csv",
    "opensfm": "opensfm/reconstruction.json",
    "opendronemap": "odm_report/shots.geojson",
    "polycam": "keyframes/corrected_cameras/1003.json",
    "record3d": "metadata.json",
}
F = "<f>150.0</f>"
CASES = [
    ("metashape", "</document>", "", "invalid XML"),
    ("metashape", "<document", "<!DOCTYPE x [<!ENTITY a 'b'>]><document", "declares entities"),
    ("metashape", "<chunk ", "<chunk/><chunk ", "holds 2 chunks; export the cameras of one"),
    ("metashape", 'type="frame"', 'type="spherical"', "type 'spherical' is not read; let `clgs p"),
    ("metashape", F, "<f>many</f>", "'A camera': f is not a finite number; correct it"),
    ("metashape", F, "<f>1_50.0</f>", "'A camera': f is not a finite number; correct it"),
    ("metashape", F, "<f>\u0661\u0665</f>", "'A camera': f is not a finite number; correct it"),
    ("metashape", F, "<f>0</f>", "the focal length is 0, not 0.001 to 1e+09 pixels"),
    ("metashape", F, "", "calibration has no f; align the photos"),
    ("metashape", F, f"{F}<p3>0.1</p3>", "p3 and p4 are not read"),
    ("metashape", 'width="160"', 'width="0"', "width and height are no size of an image"),
    ("metashape", 'sensor_id="7"', 'sensor_id="1"', "'IMG_0000': sensor_id names no sensor"),
    ("metashape", ">2.5</scale>", ">-2</scale>", "transform: scale is -2; correct it"),
    ("metashape", "<transform>", "<transform>nan ", "transform is not 16 finite numbers"),
    ("metashape", "<transform>", "<away>", "invalid XML"),
    ("realityscan", ",heading", ",alpha", "has no column heading; export 'Internal/External"),
    ("realityscan", "IMG_0001.png,", "IMG_0001.png,x", "line 4: x is not a finite number"),
    ("realityscan", "IMG_0001.png,", "IMG_0001.png,1,", "line 4: 17 values for 16 columns"),
    ("realityscan", "IMG_0001.png,", "IMG_0000.png,", "'IMG_0000.png' is listed twice"),
    ("realityscan", "IMG_0001.png,", "../../x.png,", "must stay inside the data folder"),
    ("opensfm", '"brown"', '"fisheye624"', "projection_type 'fisheye624' is not read; take one of"),
    ("opensfm", '"brown"', '"spherical"', "clgs prepare --equirectangular"),
    ("opensfm", '"v2 phone": {', '"x": {', "camera 'v2 phone' is not among the cameras; add it"),
    ("opensfm", '"rotation": [', '"rotation": [1, ', "rotation is not 3 finite numbers"),
    ("opensfm", '"coordinates": [', '"coordinates": [1, ', "coordinates is not 150 finite numbers"),
    ("opensfm", '"shots"', '"shoots"', "shots is missing or malformed"),
    ("opensfm", '"latitude": ', '"latitude": "x", "": ', "latitude is not a finite number"),
    ("opendronemap", '"features"', '"x"', "features is missing or malformed"),
    ("opendronemap", '"filename"', '"x"', "filename is missing or malformed"),
    ("opendronemap", '"translation": [', '"translation": [NaN, ', "NaN is not a number"),
    ("polycam", '"t_00"', '"t_0"', "1003.json: t_00 is not a finite number"),
    ("polycam", '"t_00": ', '"t_00": 9.5, "x": ', "the rotation is not a rotation; recompute"),
    ("polycam", '"fx": ', '"fx": -', "the focal length is -150, not"),
    ("polycam", "{", "[", "invalid JSON"),
    ("record3d", '"poses": [[', '"poses": [[1, ', "frame 0: pose is not 7 finite numbers"),
    ("record3d", '"poses": [[', '"poses": [[0,0,0,0,0,0,0],[', "not one entry for each of the 7"),
    ("record3d", '"w": 160', '"w": 16', "image is 160x120 but its intrinsics are for 16x120"),
]


@pytest.mark.parametrize(("form", "old", "new", "said"), CASES)
def test_one_line_says_what_is_wrong(tmp_path, form, old, new, said):
    root = Capture(tmp_path).form(form)
    file = root / FILES[form]
    text = file.read_text()
    assert old in text
    file.write_text(text.replace(old, new))
    with pytest.raises(DataError) as caught:
        read_photo_set(root)
    message = str(caught.value)
    assert said in message
    assert "\n" not in message
    assert str(root) in message
    assert [one.level for one in examine(root).findings] == ["error"]


def test_a_quaternion_that_is_none_is_refused(tmp_path):
    root = Capture(tmp_path).form("record3d")
    document = json.loads((root / "metadata.json").read_text())
    document["poses"][2][:4] = [0, 0, 0, 0.5]
    (root / "metadata.json").write_text(json.dumps(document))
    with pytest.raises(DataError, match="frame 2: pose begins with no unit quaternion"):
        read_photo_set(root)


def test_cameras_that_are_disabled_or_not_aligned_are_left_out(tmp_path, caplog):
    root = Capture(tmp_path).form("metashape")
    pose = "<transform>1 0 0 0 0 1 0 0 0 0 1 0 0 0 0 1</transform>"
    extra = (
        f'<camera id="8" sensor_id="7" label="x" enabled="false">{pose}</camera>'
        '<camera id="9" sensor_id="7" label="y"/>'
    )
    (root / "cameras.xml").write_text(metashape_xml(Capture(tmp_path), extra=extra))
    found = read_photo_set(root)
    assert (len(found.train + found.test), found.missing) == (6, [])
    assert "1 cameras are not aligned and are left out" in caplog.text


def test_the_largest_component_without_a_place_is_read(tmp_path, caplog):
    root = Capture(tmp_path).form("metashape")
    text = metashape_xml(Capture(tmp_path), component=True).replace(
        'component_id="3"', 'component_id="4"', 2
    )
    (root / "cameras.xml").write_text(text)
    found = read_photo_set(root)
    assert len(found.train + found.test) == 4
    assert "of 2 components with 6 cameras the largest with 4 is read" in caplog.text


def test_skew_of_metashape_is_that_of_its_manual(tmp_path):
    capture = Capture(tmp_path, coefficients={"k1": -0.05, "p1": 0.001, "p2": 0.002})
    root = capture.form("metashape")
    text = (root / "cameras.xml").read_text()
    (root / "cameras.xml").write_text(text.replace("<b1>0.0</b1>", "<b1>3.0</b1><b2>-2.0</b2>"))
    lens = read_photo_set(root).train[0].lens
    x, y = 0.2, -0.3
    r2 = x * x + y * y
    p1, p2 = 0.002, 0.001  # Metashape's
    bent_x = x * (1 - 0.05 * r2) + p1 * (r2 + 2 * x * x) + 2 * p2 * x * y
    bent_y = y * (1 - 0.05 * r2) + p2 * (r2 + 2 * y * y) + 2 * p1 * x * y
    expected = 81.5 + 153.0 * bent_x - 2.0 * bent_y, 58.25 + 150.0 * bent_y
    found = lens.distort(np.array([[x, y]]))[0] * (lens.fx, lens.fy) + (lens.cx, lens.cy)
    assert np.abs(found - expected).max() <= 1e-12


def test_realityscan_looks_where_heading_pitch_and_roll_say(tmp_path):
    """Level with the horizon (pitch 90) and heading 90: east; not turned: down, north on top."""
    root = Capture(tmp_path).form("realityscan")
    head = "#name,x,y,alt,heading,pitch,roll,f\n"
    rows = "IMG_0000.png,1,2,3,90,90,0,36\nIMG_0001.png,1,2,3,0,0,0,36\n"
    (root / "parameters.csv").write_text(head + rows)
    found = read_photo_set(root, 0)
    east, down = found.train
    assert np.allclose(east.rotation, [[0, -1, 0], [0, 0, -1], [1, 0, 0]], atol=1e-12)
    assert np.allclose(down.rotation, [[1, 0, 0], [0, -1, 0], [0, 0, -1]], atol=1e-12)
    assert np.allclose(down.centre, [1, 2, 3], atol=1e-12)
    assert down.lens == Lens(*SIZE, 160.0, 160.0, 80.0, 60.0, (0.0,) * 4)


def test_realityscan_saved_by_a_spreadsheet_is_the_same(tmp_path):
    """UTF-16; semicolons or tabs; decimal commas if semicolons separate."""
    root = Capture(tmp_path).form("realityscan")
    file = root / "parameters.csv"
    text = file.read_text()
    wanted = read_photo_set(root)
    german = text.replace(",", ";").replace(".", ",").replace(",png", ".png")
    for other, encoding in (
        (text, "utf-16"),
        (text, "utf-8-sig"),
        (text.replace(",", "\t").replace("\t", " \t "), "utf-16"),
        (text.replace(",", ";"), "utf-8"),
        (german, "utf-8"),
    ):
        file.write_text(other, encoding=encoding)
        found = read_photo_set(root)
        for one, same in zip(found.train + found.test, wanted.train + wanted.test, strict=True):
            assert (one.path, one.lens) == (same.path, same.lens)
            assert np.array_equal(one.rotation, same.rotation)
            assert np.array_equal(one.translation, same.translation)
    file.write_bytes(text.encode("utf-16")[:-1])
    with pytest.raises(DataError, match="neither UTF-8 nor UTF-16; export the camera parameters"):
        read_photo_set(root)
    file.write_text(text + "x" * 200_000)
    with pytest.raises(DataError, match=r"field larger than field limit .*; export the camera"):
        read_photo_set(root)


def test_other_tables_and_documents_are_no_cameras(tmp_path):
    root = Capture(tmp_path).form("colmap")
    shutil.rmtree(root / "sparse")
    (root / "points.csv").write_text("name,x,y\na,1,2\n")
    (root / "notes.xml").write_text("<notes/>")
    (root / "metadata.json").write_text('{"poses": []}')
    with pytest.raises(DataError, match="photos without poses; run: clgs prepare"):
        read_photo_set(root)
