"""SPZ, SOG and compressed PLY files, read by what their descriptions say."""

import gzip
import io
import json
import struct
import zipfile
from dataclasses import replace

import numpy as np
import pytest
import zstandard
from PIL import Image

from clgs.data.splats.gaussians import load_splats, read_splat_table
from clgs.data.splats.ply import PlyTable, pack_ply
from clgs.errors import DataError
from clgs.exports.splats.ply import encode_ply
from clgs.exports.splats.sog import encode_sog
from clgs.exports.splats.spz import encode_spz
from clgs.workflow.scenes import read_drawable
from tests.exports.splats.cases import differences, gaussians

HEAD = struct.Struct("<4sIIBBBB")


def parts_of(data, degree):
    """Header and bytes by attribute of an .spz file of version 3."""
    data = gzip.decompress(data)
    head, at, parts = HEAD.unpack_from(data), HEAD.size, []
    for width in (9, 1, 3, 3, 4, 3 * ((degree + 1) ** 2 - 1)):
        parts.append(data[at : at + width * head[2]])
        at += width * head[2]
    return head, [part for part in parts if part]


def as_version_4(data, degree, extra=b""):
    """The same file in version 4, with something between header and table."""
    head, parts = parts_of(data, degree)
    packed = [zstandard.compress(part) for part in parts]
    start = HEAD.pack(head[0], 4, *head[2:6], len(parts))
    table = b"".join(struct.pack("<QQ", len(a), len(b)) for a, b in zip(packed, parts, strict=True))
    return start + struct.pack("<I12x", 32 + len(extra)) + extra + table + b"".join(packed)


def as_version_2(data, degree, version=2):
    """The same file in version 2: x, y and z of the quaternion are a byte each.

    In version 1 positions are halves as well.
    """
    head, parts = parts_of(data, degree)
    turned = gaussians(degree).rotation.astype(np.float64)
    turned /= np.linalg.norm(turned, axis=1, keepdims=True)
    turned *= np.where(turned[:, :1] < 0, -1, 1)
    parts[4] = np.rint((turned[:, 1:] + 1) * 127.5).astype(np.uint8).tobytes()
    if version == 1:
        parts[0] = gaussians(degree).mean.astype("<f2").tobytes()
    return gzip.compress(HEAD.pack(head[0], version, *head[2:]) + b"".join(parts))


def loaded(path, data):
    """The splats of a file of these bytes."""
    path.write_bytes(data)
    return load_splats(path).gaussians


@pytest.mark.parametrize("degree", range(4))
@pytest.mark.parametrize("form", ["1", "2", "3", "3 and more", "4", "4 and more", "sog"])
def test_what_was_written_is_read(tmp_path, degree, form):
    encoded = (encode_sog if form == "sog" else encode_spz)(gaussians(degree))
    data = encoded.data
    if form[0] == "4":
        data = as_version_4(data, degree, b"extension" if "more" in form else b"")
    elif form in "12":
        data = as_version_2(data, degree, int(form))
    elif form == "3 and more":
        inside, more = gzip.decompress(data), b"\x02\x00\xbe\xad\x04" + bytes(7)  # as a flag says
        data = gzip.compress(inside[:14] + b"\x02" + inside[15:] + more)
    found = loaded(tmp_path / "s.bin", data)
    assert found.degree == degree
    apart = differences(found, encoded.gaussians)
    assert apart.pop("rotation") <= (0.01 if form in "12" else 1e-6)
    assert apart.pop("mean") <= (0.005 if form == "1" else 1e-6)
    assert max(apart.values()) <= 1e-6
    assert not found.antialiased


def refusal(path, data):
    """What is said of a file of these bytes: one line."""
    with pytest.raises(DataError, match=r"^[^\n]*s\.spz: [^\n]*$") as caught:
        loaded(path, data)
    return str(caught.value)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda inside: inside[:8] + b"\xff" * 4 + inside[12:], "that declare arrays of"),
        (lambda inside: inside[:4] + b"\x09" + inside[5:], "version 9; 1 to 4 are read"),
        (lambda inside: b"something else, and no splats", "but no .spz file"),
        (lambda inside: inside[:12] + b"\x05" + inside[13:], "with colors of degree 5"),
        (lambda inside: inside[:13] + b"\x19" + inside[14:], "have 25 bits after the point"),
        (lambda inside: inside[:10], "ends in its header"),
        (lambda inside: inside[:-5], "lacks the last of its 500 splats"),
        (lambda inside: inside + b"more", "does not end with its splats"),
        (lambda inside: inside[:8] + bytes(4) + inside[12:16], "holds no splats that can be drawn"),
    ],
)
def test_damaged_spz_is_one_line(tmp_path, change, said):
    inside = gzip.decompress(encode_spz(gaussians(1)).data)
    assert said in refusal(tmp_path / "s.spz", gzip.compress(change(inside)))


def in_members(data, first):
    """The same content, compressed as two members of which one has the ``first`` bytes."""
    inside = gzip.decompress(data)
    return gzip.compress(inside[:first]) + gzip.compress(inside[first:])


@pytest.mark.parametrize(
    ("version", "change", "said"),
    [
        (3, lambda data: data[:-8] + bytes(4) + data[-4:], "gzip cannot read"),
        (3, lambda data: data[:-6], "does not end with its splats"),
        (3, lambda data: in_members(data, 99), "several gzip members"),
        (4, lambda data: data[:-5], "stream 6 is not as long as it must be"),
        (4, lambda data: data[:30], "ends in its header"),
        (4, lambda data: data[:16] + b"\xff" * 4 + data[20:], "table of streams is damaged"),
        (4, lambda data: data[:15] + b"\x05" + data[16:], "table of streams is damaged"),
        (4, lambda data: data[:128] + bytes(4) + data[132:], "zstd cannot read"),
    ],
)
def test_damaged_bytes_of_spz_are_one_line(tmp_path, version, change, said):
    data = encode_spz(gaussians(1)).data
    whole = data if version == 3 else as_version_4(data, 1)
    assert said in refusal(tmp_path / "s.spz", change(whole))


def unzipped(data, change=lambda meta: meta):
    """The files of a .sog file by name; meta.json is changed."""
    archive = zipfile.ZipFile(io.BytesIO(data))
    files = {name: archive.read(name) for name in archive.namelist()}
    files["meta.json"] = json.dumps(change(json.loads(files["meta.json"]))).encode()
    return files


def zipped(files, before=""):
    """A zip archive of files by name."""
    out = io.BytesIO()
    with zipfile.ZipFile(out, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, content in files.items():
            archive.writestr(before + name, content)
    return out.getvalue()


def as_version_1(meta):
    """The description of the same images in version 1, and the extremes of its tables."""
    parts = {part: {"files": meta[part]["files"]} for part in ("means", "scales", "quats", "sh0")}
    parts["means"] |= meta["means"] | {"shape": [meta["count"], 3]}
    parts["scales"] |= {"mins": [-6, -5, -4], "maxs": [0, 1, 2]}
    parts["sh0"] |= {"mins": [-2, -1, 0, -7], "maxs": [2, 1, 3, 7]}
    if "shN" in meta:
        parts["shN"] = {"files": meta["shN"]["files"], "mins": -0.5, "maxs": 0.75}
    return parts


@pytest.mark.parametrize("degree", [0, 1, 3])
def test_sog_of_version_1_has_even_steps(tmp_path, degree):
    data = encode_sog(gaussians(degree)).data
    old = loaded(tmp_path / "s.sog", zipped(unzipped(data, as_version_1)))
    new = loaded(tmp_path / "s.sog", data)
    assert old.degree == degree
    assert np.array_equal(old.mean, new.mean)
    assert np.array_equal(old.rotation, new.rotation)

    def bytes_of(name):
        image = Image.open(io.BytesIO(unzipped(data)[name])).convert("RGBA")
        return np.asarray(image).reshape(-1, 4)[: len(old)] / 255.0

    size, first = bytes_of("scales.webp")[:, :3], bytes_of("sh0.webp")
    assert np.allclose(old.log_scale, [-6, -5, -4] + 6 * size, atol=1e-6)
    assert np.allclose(old.sh[:, 0], [-2, -1, 0] + [4, 2, 3] * first[:, :3], atol=1e-6)
    assert np.allclose(old.opacity, -7 + 14 * first[:, 3], atol=1e-5)
    if degree:
        # An order-preserving table: equal coefficients stay equal, larger ones larger.
        steps = (old.sh[:, 1:] + 0.5) / 1.25 * 255
        assert np.allclose(steps, np.rint(steps), atol=1e-3)
        assert np.corrcoef(steps.ravel(), new.sh[:, 1:].ravel())[0, 1] > 0.9


@pytest.mark.parametrize("form", ["folder", "zipped folder"])
def test_sog_is_read_from_folders(tmp_path, form):
    encoded = encode_sog(gaussians(1))
    if form == "folder":
        for name, content in unzipped(encoded.data).items():
            (tmp_path / name).write_bytes(content)
        path = tmp_path / "meta.json"
    else:
        path = tmp_path / "s.sog"
        path.write_bytes(zipped(unzipped(encoded.data), "scene/"))
    scene, size = read_drawable(path)
    assert max(differences(scene.gaussians, encoded.gaussians).values()) < 1e-6
    assert size == sum(file.stat().st_size for file in tmp_path.iterdir())


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ('{"frames": []}', "a JSON file that describes no splats; write the file again"),
        ('{"means": {"shape": [2, 3], "files": ["../a", "b"]}}', "'../a', which is no file next"),
        ('{"means": {"shape": [2, 3], "files": ["a.webp", "b"]}}', "'a.webp', which is no file"),
        ('{"version": 2, "count": 1e300, "means": {}}', "that declare arrays of"),
        ('{"version": 2, "count": Infinity, "means": {}}', "meta.json is damaged"),
        ('{"version": 2, "count"', "Expecting"),
    ],
)
def test_other_json_is_one_line(tmp_path, text, said):
    (tmp_path / "meta.json").write_text(text)
    with pytest.raises(DataError, match=r"^[^\n]*meta\.json: [^\n]*$") as caught:
        read_drawable(tmp_path / "meta.json")
    assert said in str(caught.value)


def test_an_image_that_unpacks_to_gigabytes_is_refused(tmp_path):
    """A WebP file of 34 bytes may have 2^28 pixels."""
    files, out = unzipped(encode_sog(gaussians(0)).data), io.BytesIO()
    Image.new("RGBA", (4096, 4096)).save(out, "WEBP", lossless=True, quality=0, method=0)
    files["scales.webp"] = out.getvalue()
    with pytest.raises(DataError, match=r"scales\.webp in a \.sog file is 4096x4096, too large"):
        loaded(tmp_path / "s.sog", zipped(files))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("place", "value", "said"),
    [
        ("scales", {"files": ["scales.webp"]}, "meta.json is damaged: 'codebook'"),
        ("scales", {"files": ["scales.webp"], "codebook": []}, "without a codebook of scales"),
        ("version", 3, "of version 3; 1 and 2 are read"),
        ("count", 10**12, "bytes that declare arrays of 24,000,000,000,000 bytes"),
        ("count", 10**5, "splats, of which means holds"),
        ("quats", {"files": ["meta.json"]}, "meta.json in a .sog file is damaged"),
        ("quats", {"files": ["none.webp"]}, "meta.json is damaged"),
        ("means", None, "meta.json is damaged"),
    ],
)
def test_damaged_sog_is_one_line(tmp_path, place, value, said):
    data = encode_sog(gaussians(1)).data
    changed = zipped(unzipped(data, lambda meta: meta | {place: value}))
    assert said in refusal(tmp_path / "s.spz", changed)
    assert "a .sog file that is damaged" in refusal(tmp_path / "s.spz", changed[:900])


def chunked(degree, colors, count=300):
    """A compressed PLY file of two chunks, and the columns that it stands for."""
    rng, chunks = np.random.default_rng(5), -(-count // 256)
    limits, lines = {}, ["ply", "format binary_little_endian 1.0", "comment SplatRenderMode: mip"]
    names = [*"xyz", *(f"scale_{axis}" for axis in "xyz"), *("rgb" if colors else "")]
    for name in names:
        least = rng.uniform(-3, 0, chunks).astype(np.float32)
        limits |= {f"min_{name}": least, f"max_{name}": least + np.float32(2)}
    lines += [f"element chunk {chunks}", *(f"property float {name}" for name in limits)]
    words = rng.integers(0, 2**32, (count, 4), dtype=np.uint32)
    packed = [f"packed_{part}" for part in ("position", "rotation", "scale", "color")]
    lines += [f"element vertex {count}", *(f"property uint {name}" for name in packed)]
    rest = rng.integers(0, 256, (count, 3 * ((degree + 1) ** 2 - 1)), dtype=np.uint8)
    if degree:
        lines += [f"element sh {count}"]
        lines += [f"property uchar f_rest_{i}" for i in range(rest.shape[1])]
    body = np.stack([*limits.values()], 1).tobytes() + words.tobytes() + rest.tobytes()
    chunk = np.arange(count) // 256

    def share(column, shift, bits):
        return (words[:, column] >> np.uint32(shift) & np.uint32(2**bits - 1)) / (2**bits - 1)

    def between(name, part):
        return limits[f"min_{name}"][chunk] + 2 * part

    wanted = {name: between(name, share(0, *field)) for name, field in
              zip("xyz", ((21, 11), (11, 10), (0, 11)), strict=True)}  # fmt: skip
    wanted["scale_1"] = between("scale_y", share(2, 11, 10))
    red = between("r", share(3, 24, 8)) if colors else share(3, 24, 8)
    wanted["f_dc_0"] = (red - 0.5) / 0.28209479177387814
    return ("\n".join([*lines, "end_header\n"])).encode() + body, wanted


@pytest.mark.parametrize(("degree", "colors"), [(0, False), (0, True), (3, True)])
def test_chunks_of_splats_are_read(tmp_path, degree, colors):
    path = tmp_path / "s.compressed.ply"
    data, wanted = chunked(degree, colors)
    found = loaded(path, data)
    assert (len(found), found.degree, found.antialiased) == (300, degree, True)
    assert np.allclose(found.mean, np.stack([wanted[name] for name in "xyz"], 1), atol=1e-5)
    assert np.allclose(found.log_scale[:, 1], wanted["scale_1"], atol=1e-5)
    assert np.allclose(found.sh[:, 0, 0], wanted["f_dc_0"], atol=1e-4)
    assert np.allclose(np.linalg.norm(found.rotation, axis=1), 1, atol=0.6)
    for old, new in ((b"chunk 2", b"chunk 1"), (b"uint packed_scale", b"int packed_scale")):
        with pytest.raises(DataError, match=r"^[^\n]*compressed\.ply: [^\n]*$"):
            loaded(path, data.replace(old, new))


@pytest.mark.parametrize("encode", [encode_ply, encode_spz, encode_sog])
def test_marks_are_kept_by_every_format(tmp_path, encode):
    data = encode(replace(gaussians(), antialiased=True)).data
    assert loaded(tmp_path / "s.bin", data).antialiased


def test_an_element_before_the_splats_is_skipped(tmp_path):
    data = encode_ply(gaussians()).data
    before = b"element camera 1\nproperty list uchar float pose\nelement vertex"
    head, end, body = data.replace(b"element vertex", before, 1).partition(b"end_header\n")
    found = loaded(tmp_path / "s.ply", head + end + b"\x02" + bytes(8) + body)
    assert max(differences(found, gaussians()).values()) < 1e-6


def test_points_keep_their_colors(tmp_path):
    """Points without opacity are no splats: nothing of them is changed."""
    columns = {name: np.arange(4, dtype=np.float32) for name in "xyz"}
    columns |= {name: np.arange(4, dtype=np.uint8) for name in ("red", "green", "blue")}
    (tmp_path / "p.ply").write_bytes(pack_ply(PlyTable(columns)))
    assert list(read_splat_table(tmp_path / "p.ply").columns) == list(columns)


def splat_file(given) -> bytes:
    """The .splat file of Gaussians of degree 0, as viewers' converters write it, splat by splat."""
    rows = []
    for i in range(len(given)):
        unit = given.rotation[i].astype(float) / np.linalg.norm(given.rotation[i])
        alpha = 1 / (1 + np.exp(-float(given.opacity[i])))
        color = [*(0.5 + 0.28209479177387814 * given.sh[i, 0].astype(float)), alpha]
        bytes_ = [round(min(max(one * 255, 0), 255)) for one in color]
        bytes_ += [round(min(max(one * 128 + 128, 0), 255)) for one in unit]
        sizes = np.exp(given.log_scale[i].astype(float))
        rows.append(struct.pack("<3f3f8B", *given.mean[i], *sizes, *bytes_))
    return b"".join(rows)


def test_splat_files_of_web_viewers_are_read(tmp_path):
    given = gaussians(0)
    (tmp_path / "web.SPLAT").write_bytes(splat_file(given))
    scene, size = read_drawable(tmp_path / "web.SPLAT")
    assert size == 32 * len(given)
    off = differences(scene.gaussians, given)
    assert off["mean"] == 0.0
    assert off["log_scale"] <= 1e-6
    assert off["opacity"] <= 0.51 / 255
    assert off["sh"] <= 0.51 / 255 / 0.28209479
    assert off["rotation"] <= 1e-4


@pytest.mark.parametrize(
    ("data", "said"),
    [
        (bytes(33), "33 bytes are no .splat file, which has 32 per splat"),
        (struct.pack("<6f8B", 0, 0, 0, -1, 1, 1, *bytes(8)), "a .splat file with negative scales"),
        (b"", "the file is empty"),
        (struct.pack("<6f8B", 0, 0, 0, 1, 1, 1, *[128] * 8), "holds no splats that can be drawn"),
        (struct.pack("<6f8B", np.nan, 0, 0, 1, 1, 1, *bytes(8)), "holds no splats that can be"),
    ],
)
def test_a_damaged_splat_file_is_one_line(tmp_path, data, said):
    (tmp_path / "s.splat").write_bytes(data)
    with pytest.raises(DataError, match=rf"^[^\n]*s\.splat: {said}[^\n]*$"):
        load_splats(tmp_path / "s.splat")
