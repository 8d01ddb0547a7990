"""`clgs train --from RUN`: its settings, and what its options say of them."""

from dataclasses import replace

import pytest

from clgs.cli.main import build_parser
from clgs.cli.options import make_config
from clgs.train.config import preset


@pytest.mark.parametrize(
    ("words", "steps", "lambda_", "downscale"),
    [
        ("", 600, 0.7, 2),
        ("--steps 450 --lambda 0.2", 450, 0.2, 2),
        ("--set steps=450 --max-size 800", 450, 0.7, 0),
        ("--config {config}", 900, 0.3, 2),
        ("--preset default", 600, 0.7, 2),
    ],
)
def test_settings_are_those_of_the_run(tmp_path, words, steps, lambda_, downscale):
    old = replace(preset("quick").scaled(300), size_lambda=0.7, downscale=2, seed=5)
    (tmp_path / "config.toml").write_text(old.to_toml())
    (tmp_path / "results.json").write_text("{}")
    (tmp_path / "other.toml").write_text("steps = 900\nsize_lambda = 0.3\n")
    given = ["train", "data", "-o", "new", "--from", str(tmp_path)]
    given += words.format(config=tmp_path / "other.toml").split()
    config = make_config(vars(build_parser(["train"]).parse_args(given)))
    assert (config.steps, config.size_lambda) == (steps, lambda_)
    assert (config.downscale, config.seed) == (downscale, 5)
    assert config.switch_step == steps // 2
