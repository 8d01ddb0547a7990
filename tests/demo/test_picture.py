import numpy as np
import pytest
from picture import CAPTION, GAP, MIN_HEIGHT, WIDTH, draw_showcase
from PIL import Image
from run import draw_comparison

from clgs.codec.scene_encoder import encode
from clgs.errors import DataError
from tests.codec.scenes import random_scene

RED, BLUE = (200, 30, 40), (30, 40, 200)
SECTIONS = {"features": 600, "offsets": 300, "header": 5}


def flat(color, width=200, height=150):
    return np.full((height, width, 3), color, np.uint8)


@pytest.mark.parametrize(("width", "height"), [(200, 150), (300, 40), (90, 160)])
def test_panels_show_photo_and_render_whatever_their_shape(width, height):
    page = draw_showcase(flat(RED, width, height), flat(BLUE, width, height), 30, {"a": 1})
    high = round(WIDTH * height / width)
    assert page.shape == (max(MIN_HEIGHT, high) + CAPTION, 3 * WIDTH + 2 * GAP, 3)
    assert (page[:high, :WIDTH] == RED).all()
    assert (page[:high, WIDTH + GAP : 2 * WIDTH + GAP] == BLUE).all()
    assert (page[:, WIDTH : WIDTH + GAP] == 255).all()


def test_captions_stay_below_their_panels():
    most = dict.fromkeys(("one", "two"), 10**11)
    page = draw_showcase(flat(RED), flat(BLUE), -100.0, most)
    inked = (page[-CAPTION:] < 128).any(axis=(0, 2))
    for panel in range(3):
        left = panel * (WIDTH + GAP)
        assert inked[left : left + WIDTH].any()
        assert not inked[left + WIDTH - 2 : left + WIDTH + GAP].any()


def test_bars_are_as_long_as_the_bytes():
    page = draw_showcase(flat(RED), flat(BLUE), 30, SECTIONS)
    blue = (page[..., 0] < 80) & (page[..., 2] > 150)
    lengths = blue[:-CAPTION, 2 * (WIDTH + GAP) :].sum(axis=1)
    assert sorted(set(lengths[lengths > 0])) == [4, 185, 369]  # 5 and 300 of 600, both ends drawn


def test_view_of_median_score_is_shown(tmp_path):
    colors = [(10, 0, 0), (90, 0, 0), (170, 0, 0)]
    per_view = []
    for index, color in enumerate(colors):
        name = f"photo_{index}.png"
        for kind in ("gt", "renders"):
            folder = tmp_path / "test" / "ours_1" / kind
            folder.mkdir(parents=True, exist_ok=True)
            Image.fromarray(flat(color)).save(folder / name)
        per_view.append({"name": name, "psnr": [31.0, 25.0, 28.0][index], "ssim": 0.9})
    scene = random_scene(np.random.default_rng(0), 20)
    (tmp_path / "scene.clgs").write_bytes(encode(scene))
    draw_comparison(tmp_path / "out.png", tmp_path, per_view)
    page = np.array(Image.open(tmp_path / "out.png"))
    assert tuple(page[100, 100]) == colors[2]


def test_lost_picture_is_named(tmp_path):
    with pytest.raises(DataError, match=r"no picture a\.png; run the demo again"):
        draw_comparison(tmp_path / "out.png", tmp_path, [{"name": "a.png", "psnr": 1.0}])
