from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest

from clgs.errors import ClgsError, DataError
from clgs.train.quality.lpips import Lpips, read_lpips_weights, require_onnx
from tests.train.quality import lpips_reference as reference
from tests.train.quality.test_scores import pictures

BOUND = 1e-5
"""Relative: 13 layers and the differences of their unit vectors round in float32. Roundings of
2^-24 of each activation's sum of terms add up at random, to some 2^-20 (1e-6) of the differences
of pictures that differ plainly; ten times that."""


@pytest.fixture(scope="module", params=["random", "published"])
def weights_file(request, tmp_path_factory):
    pytest.importorskip("onnxruntime", reason='pip install "clgs[lpips]"')
    if request.param == "random":
        path = tmp_path_factory.mktemp("lpips") / "weights.npz"
        np.savez(path, **reference.random_weights())
        return Path(path)
    path = request.getfixturevalue("shared_data").parent / "lpips" / "vgg16_lpips.npz"
    if not path.exists():
        pytest.skip(f"no published weights of LPIPS: {path} is missing")
    return Path(path)


@pytest.fixture(scope="module")
def network(weights_file):
    return Lpips(read_lpips_weights(weights_file))


def test_agrees_with_float64(network, weights_file):
    arrays = reference.load_arrays(weights_file)
    for size in ((16, 16), (19, 37)):  # odd sizes lose a row or column when halved
        x, y = pictures(*size, seed=size[0])
        expected = reference.lpips(arrays, x, y)
        assert expected > 1e-3
        assert abs(network(x, y) / expected - 1) <= BOUND


def test_is_a_symmetric_distance_that_grows_with_noise(network):
    x, y = pictures()
    assert network(x, x.copy()) == 0.0
    assert network(x, y) == network(y, x)
    little = (x + (y.astype(int) - x) / 4).astype(np.uint8)
    assert 0 < network(x, little) < network(x, y)


def test_small_and_other_pictures_are_errors(network):
    x, y = pictures(15, 40)
    with pytest.raises(DataError, match="photo of 40x15: LPIPS needs 16x16"):
        network(x, y)
    x, y = pictures()
    with pytest.raises(ValueError, match="photo: shape"):
        network(x, y[:, :-1])
    with pytest.raises(TypeError, match="render: dtype"):
        network(x / 255.0, y)  # type: ignore[arg-type]  # what is refused


KERNEL = "VGG16_0/Conv_0/kernel"


@pytest.mark.parametrize(
    ("arrays", "said"),
    [
        ({}, f"array {KERNEL} is missing"),
        ({KERNEL: np.zeros((64, 3, 3, 3), np.float32)}, r"\(64, 3, 3, 3\), expected \(3, 3, 3, 6"),
        ({KERNEL: np.zeros((3, 3, 3, 64), np.int8)}, "dtype is int8, expected float16 or float32"),
        ({KERNEL: np.full((3, 3, 3, 64), np.nan, np.float16)}, f"{KERNEL}: a number is not fin"),
        ({KERNEL: np.full((3, 3, 3, 64), None)}, "dtype is object"),
        ({KERNEL: np.zeros((3, 3, 3, 64), np.float32)}, "array VGG16_0/Conv_0/bias is missing"),
    ],
)
def test_a_wrong_archive_is_named(tmp_path, arrays, said):
    np.savez(tmp_path / "w.npz", **arrays)
    with pytest.raises(DataError, match=f"w.npz: not the weights of LPIPS with VGG-16.*{said}"):
        read_lpips_weights(tmp_path / "w.npz")


def test_what_is_no_archive_is_named(tmp_path):
    with pytest.raises(DataError, match=r"w.npz: no such file; name the .npz"):
        read_lpips_weights(tmp_path / "w.npz")
    with pytest.raises(DataError, match="not the weights of LPIPS"):
        read_lpips_weights(tmp_path)
    for content in (b"", b"text", b"PK\x03\x04" + bytes(40)):
        (tmp_path / "w.npz").write_bytes(content)
        with pytest.raises(DataError, match="not the weights of LPIPS"):
            read_lpips_weights(tmp_path / "w.npz")


def test_a_missing_library_is_named(monkeypatch):
    monkeypatch.setitem(sys.modules, "onnxruntime", None)
    with pytest.raises(ClgsError, match=r'LPIPS needs onnx and .*pip install "clgs\[lpips\]"'):
        require_onnx()
