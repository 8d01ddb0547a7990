"""The settings of training: declared once, read from files and command lines, described."""

from clgs.train.config.option import MAX_WEIGHT, options_of
from clgs.train.config.run_settings import LearningRates
from clgs.train.config.settings import TrainConfig
from clgs.train.config.sources import from_toml, layered, parse_word, preset, read_settings

__all__ = [
    "MAX_WEIGHT",
    "LearningRates",
    "TrainConfig",
    "from_toml",
    "layered",
    "options_of",
    "parse_word",
    "preset",
    "read_settings",
]
