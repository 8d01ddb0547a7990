"""PLY tables: all forms read alike, and every lie in a header refused."""

import os
import struct

import numpy as np
import pytest

from clgs.data.splats.ply import PlyTable, narrowest, pack_ply, parse_ply, read_ply
from clgs.errors import DataError


@pytest.fixture
def table():
    columns = {
        "x": np.array([0.5, -1.25, 3e7], np.float32),
        "wide": np.array([1 / 3, 2.0, -0.0]),
        "red": np.array([0, 255, 7], np.uint8),
        "id": np.array([-(2**31), 5, 2**31 - 1], np.int32),
    }
    return PlyTable(columns, ["made by hand"])


def other_form(data: bytes, order: str) -> bytes:
    """The same table in another format."""
    table = parse_ply(data)
    head, _, _ = data.partition(b"end_header\n")
    head = head.replace(b"binary_little_endian", order.encode()) + b"end_header\n"
    rows = zip(*table.columns.values(), strict=True)
    if order == "ascii":
        return head + "\n".join(" ".join(repr(v.item()) for v in row) for row in rows).encode()
    kinds = [(name, column.dtype.newbyteorder(">")) for name, column in table.columns.items()]
    return head + np.array(list(rows), kinds).tobytes()


@pytest.mark.parametrize("order", ["binary_big_endian", "ascii"])
def test_every_form_holds_the_same(table, order):
    data = pack_ply(table)
    for form in (data, other_form(data, order), other_form(data, order).replace(b"x\n", b"x\r\n")):
        found = parse_ply(form)
        assert found.comments == table.comments
        assert list(found.columns) == list(table.columns)
        for name, column in table.columns.items():
            assert found.columns[name].dtype == column.dtype
            np.testing.assert_array_equal(found.columns[name], column)


def test_elements_behind_the_table_are_skipped(table):
    data = pack_ply(table).replace(
        b"end_header", b"element face 9\nproperty list uchar int vertex_indices\nend_header"
    )
    np.testing.assert_array_equal(parse_ply(data + b"rest").columns["x"], table.columns["x"])


@pytest.mark.parametrize(
    ("old", "new"),
    [
        (b"ply\n", b"plz\n"),
        (b"end_header", b"end_of_it!"),
        (b"binary_little_endian", b"binary_middle_endian"),
        (b"1.0\n", b"2.0\n"),
        (b"vertex 3", b"vertex 4"),
        (b"vertex 3", b"vertex 2"),
        (b"vertex 3", b"vertex -3"),
        (b"vertex 3", b"vertex 4000000000000000000"),
        (b"vertex 3", b"vertex 99999999999999999999999"),
        (b"element vertex", b"element corner"),
        (b"property uchar red", b"property list uchar int red"),
        (b"property uchar red", b"property uchar x"),
        (b"property uchar red", b"property half red"),
        (b"property uchar red", b"proprety uchar red"),
        (b"format", b"format binary_little_endian 1.0\nformat"),
    ],
)
def test_malformed_headers_are_refused(table, old, new):
    data = pack_ply(table)
    assert old in data
    with pytest.raises(ValueError, match=r"header|PLY"):
        parse_ply(data.replace(old, new, 1))


def test_a_line_that_is_not_read_is_shown(table):
    data = pack_ply(table).replace(b"element vertex", b"elements chunk 5\r\nelement vertex")
    with pytest.raises(ValueError, match=r"^line 4 of the header, 'elements chunk 5', is not"):
        parse_ply(data)


def test_a_property_that_comes_twice_is_told(table):
    data = pack_ply(table).replace(b"property uchar red", b"property float x")
    with pytest.raises(ValueError, match=r"'property float x', is not read: there are two prop"):
        parse_ply(data)


@pytest.mark.parametrize("order", ["binary_little_endian", "binary_big_endian", "ascii"])
def test_elements_before_the_table_are_skipped(table, order):
    before = b"element camera 2\nproperty float fov\nproperty list uchar short seen\n"
    before += b"element empty 3\nelement two 2\nproperty int n\n"
    data = (
        pack_ply(table) if order == "binary_little_endian" else other_form(pack_ply(table), order)
    )
    head, end, body = data.replace(b"element vertex", before + b"element vertex").partition(
        b"end_header\n"
    )
    if order == "ascii":
        body = b"0.5 3 1 2 -3\n0.7 0\n7 8\n" + body
    else:
        at = ">" if order == "binary_big_endian" else "<"
        rows = struct.pack(at + "fB3hfB", 0.5, 3, 1, 2, -3, 0.7, 0)
        body = rows + struct.pack(at + "2i", 7, 8) + body
    found = parse_ply(head + end + body)
    for name, column in table.columns.items():
        np.testing.assert_array_equal(found.columns[name], column)
    for length in range(0, len(body) - 12, 3):
        with pytest.raises(ValueError, match=r"."):
            parse_ply(head + end + body[:length])


def test_a_list_of_less_than_no_items_is_refused(table):
    before = b"element camera 1\nproperty list char int seen\nelement vertex"
    head, end, body = pack_ply(table).replace(b"element vertex", before).partition(b"end_header\n")
    with pytest.raises(ValueError, match="element camera is longer than the file"):
        parse_ply(head + end + b"\xff" + body)


def test_every_cut_is_refused(table):
    for data in (pack_ply(table), other_form(pack_ply(table), "ascii")):
        last = len(data) if b"ascii" not in data else data.rindex(b" ")
        for length in range(last):
            with pytest.raises(ValueError, match=r"."):
                parse_ply(data[:length])


def test_text_that_is_no_number_is_refused(table):
    data = other_form(pack_ply(table), "ascii")
    for old, new in ((b"255", b"2.5"), (b"255", b"red"), (b"255", b"25 5")):
        with pytest.raises(ValueError, match=r"red|convert|numbers"):
            parse_ply(data.replace(old, new))


def test_comments_may_hold_anything(table):
    words = ["Ångström … 测试 \x85 \x1c", "the end_header", "end_header", "latin-1 \xe9"]
    lines = [f"comment {word}".encode() for word in words[:3]]
    lines.append(b"comment " + words[3].encode("latin-1"))
    for end in (b"\n", b"\r\n"):
        data = pack_ply(table).replace(b"element", end.join([*lines, b""]) + b"element", 1)
        found = parse_ply(data)
        assert found.comments[0] == "made by hand"
        assert found.comments[1:4] == [" ".join(word.split()) for word in words[:3]]
        np.testing.assert_array_equal(found.columns["wide"], table.columns["wide"])
    unicode = parse_ply(pack_ply(PlyTable(table.columns, ["测试"])))
    assert unicode.comments == ["测试"]


@pytest.mark.parametrize("body", [b"", b"\n", b"\r\n \n"])
def test_text_without_rows(body):
    head = (
        b"ply\nformat ascii 1.0\nelement vertex 0\nproperty float x\nproperty int n\nend_header\n"
    )
    found = parse_ply(head + body)
    assert [(name, len(column)) for name, column in found.columns.items()] == [("x", 0), ("n", 0)]
    with pytest.raises(ValueError, match="1 numbers follow the header, which promises 0"):
        parse_ply(head + body + b"7")


@pytest.mark.parametrize(
    ("integers", "kind"),
    [([0, -5, 2**24], "f4"), ([2**24 + 1], "f8"), ([2**31 - 1, 1], "f8"), ([], "f4")],
)
def test_columns_are_as_narrow_as_they_can_be(integers, kind):
    column = np.array(integers, np.int32)
    found = narrowest(column, lambda n: n / np.float64(1), lambda v: v)
    assert found.dtype == np.dtype(kind)
    np.testing.assert_array_equal(found, column)


def test_errors_name_the_file(tmp_path):
    with pytest.raises(DataError, match=r"none\.ply: no such file"):
        read_ply(tmp_path / "none.ply")
    with pytest.raises(DataError, match="folder"):
        read_ply(tmp_path)
    (tmp_path / "x.ply").write_bytes(b"")
    with pytest.raises(DataError, match=r"x\.ply: not a PLY file; name one$"):
        read_ply(tmp_path / "x.ply")


@pytest.mark.parametrize("value", ["300", "-1", "1.5", "inf"])
def test_text_holds_what_its_type_holds(tmp_path, value):
    path = tmp_path / "a.ply"
    head = "ply\nformat ascii 1.0\nelement vertex 1\nproperty uchar red\nend_header\n"
    path.write_text(f"{head}{value}\n")
    with pytest.raises(DataError, match="red is of type uchar, which cannot hold"):
        read_ply(path)


def test_numbers_have_no_underscores():
    head = b"ply\nformat ascii 1.0\nelement vertex 1\nproperty float x\nend_header\n"
    with pytest.raises(ValueError, match="a number has an underscore"):
        parse_ply(head + b"1_0")


def test_text_beyond_a_float_is_infinite():
    head = b"ply\nformat ascii 1.0\nelement vertex 2\nproperty float x\nend_header\n"
    assert parse_ply(head + b"1e300 -1e300").columns["x"].tolist() == [np.inf, -np.inf]


def test_a_pipe_is_refused(tmp_path):
    os.mkfifo(tmp_path / "pipe")
    with pytest.raises(DataError, match="not a regular file"):
        read_ply(tmp_path / "pipe")
