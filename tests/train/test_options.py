"""A training option is declared once: its check, files, command line and table follow."""

from __future__ import annotations

import argparse
import re
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import pytest

from clgs.cli import options as training
from clgs.cli.main import build_parser
from clgs.cli.parser import Parser
from clgs.errors import UsageError
from clgs.train.config import (
    TrainConfig,
    from_toml,
    layered,
    parse_word,
    preset,
    read_settings,
)
from clgs.train.config.option import (
    Option,
    Pair,
    Range,
    Text,
    at_least,
    option,
    options_of,
)
from clgs.train.config.sources import PAPER_RATES

ROOT = Path(__file__).parents[2]
DOCUMENTS = sorted([*ROOT.glob("*.md"), *ROOT.glob("docs/**/*.md")])
OPTIONS = list(options_of(TrainConfig).values())
NUMBERS = (int, float, float | None, Pair)


def by_name(one: Option) -> str:
    return one.name


def other_value(one: Option) -> Any:
    """A usable value that is not the default."""
    if one.kind is bool:
        return not one.default
    if isinstance(one.allowed, tuple):
        return next(word for word in one.allowed if word != one.default)
    if isinstance(one.allowed, Text):
        return "-1,-1,-1,1,1,1" if one.name == "box" else "other.ply"
    if one.kind == Pair:
        return tuple(2 * rate for rate in one.default)
    steps = {"growth_end": -1, "target_size": 100_000, "max_anchors": 1000, "start_points": 9}
    steps["fisheye_view"] = 110
    return (one.default or 0) + steps.get(one.name, 1)


def as_text(value: Any) -> str:
    if isinstance(value, bool):
        return str(value).lower()
    return ",".join(map(str, value)) if isinstance(value, tuple) else str(value)


def test_bytes_may_have_a_suffix():
    target = options_of(TrainConfig)["target_size"]
    assert [target.parse(text) for text in ("800k", "1.5M", "700000")] == [
        800_000,
        1_500_000,
        700_000,
    ]
    for text in ("k", "-1k", "5x", "1e400k"):
        with pytest.raises(UsageError, match="target_size"):
            target.parse(text)


def parse_command(*words: str) -> TrainConfig:
    parser = Parser(prog="clgs train")
    training.add_training_options(parser)
    return training.make_config(vars(parser.parse_args(words)))


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (
            "--growth-end 900 --steps 1000",
            "--growth-end: 900 is after --switch-step 500; give at most that, or a later --switch-",
        ),
        ("--target-size 60k --lambda 1", "--lambda: follows from --target-size; give one"),
        ("--target-size 60k --lambda 0", "--lambda: follows from --target-size; give one"),
        (
            "--target-size 60k --preset paper",
            "--target-size: preset paper keeps the published integers per unit",
        ),
        ("--loss-weights 0 0", "--l1-weight, --ssim-weight: both are 0"),
        ("--target-size 20k --mlp float32", "--target-size: 20000 bytes hardly"),
        ("--set max_anchors=3", "--set max_anchors: 3 is out of range; give a whole number, 0 or"),
    ],
)
def test_what_does_not_go_together_is_named_as_it_was_given(words, said):
    with pytest.raises(UsageError) as caught:
        parse_command(*words.split())
    assert str(caught.value).startswith(said)


def value_in(config: TrainConfig, name: str) -> Any:
    table, _, inner = name.rpartition(".")
    return getattr(getattr(config, table) if table else config, inner)


@pytest.mark.parametrize("one", OPTIONS, ids=by_name)
def test_every_option_has_help_range_and_unit(one):
    assert one.help[0].islower()
    assert not one.help.endswith(".")
    assert one.group
    if one.kind in NUMBERS:
        assert isinstance(one.allowed, Range)
        assert one.unit, 'a number without a unit says "none"'
    else:
        assert one.kind in (bool, str)
        assert isinstance(one.allowed, tuple | Text)
        assert bool(one.allowed) == (one.kind is str)
    assert one.check(one.default) == one.default


@pytest.mark.parametrize("one", OPTIONS, ids=by_name)
def test_option_file_and_set_give_the_same(one, tmp_path):
    value = other_value(one)
    flag = one.flag
    word = as_text(value)
    given = (
        [flag, word]
        if one.kind is not bool
        else [flag if value else flag.replace("--", "--no-", 1)]
    )
    wanted = layered({one.name: value})
    assert parse_command(*given) == wanted
    assert parse_command("--set", f"{one.name}={word}") == wanted
    table, _, name = one.name.rpartition(".")
    written = f'"{value}"' if isinstance(value, str) else as_text(value)
    written = f"[{written}]" if one.kind == Pair else written
    (tmp_path / "some.toml").write_text(f"{f'[{table}]' if table else ''}\n{name} = {written}\n")
    assert parse_command("--config", str(tmp_path / "some.toml")) == wanted
    assert value_in(wanted, one.name) == value
    assert from_toml(wanted.to_toml()) == wanted


def test_the_table_lists_the_fields_in_order():
    assert len({one.flag for one in OPTIONS}) == len(OPTIONS)
    by = {one.name: one for one in OPTIONS}
    assert (by["near"].default_text, by["near"].unit, by["near"].range) == (
        "0.2",
        "scene units",
        "above 0",
    )
    assert by["adam"].range == "dense or visible"
    assert by["volume_weight"].default_text == "0.01 on photos, 0 on Blender scenes"
    assert by["learning_rates.offset"].default_text == "0.01,0.0001"
    assert by["switch_step"].help.endswith("moves with steps")
    assert by["normalize"].default_text == "true"
    groups = [one.group for one in OPTIONS]
    assert groups == sorted(groups, key=list(dict.fromkeys(groups)).index), "one is interrupted"


def test_the_help_of_the_command_holds_the_table():
    parser = Parser(prog="clgs train")
    training.add_training_options(parser)
    by_flag = {flag: action for action in parser._actions for flag in action.option_strings}
    for row in OPTIONS:
        said = (by_flag[row.flag].help or "") % {}
        assert row.help in said
        assert f"default: {row.default_text or 'none'}" in said
    known = {row.flag for row in OPTIONS}
    extra = {"-h", "--help", "--config", "--set", "--loss-weights"}
    assert set(by_flag) - known - extra == {
        "--no-normalize",
        "--no-average",
        "--no-coarse-to-fine",
        "--no-exposure",
    }


@pytest.mark.skipif(not DOCUMENTS, reason="needs a checkout")
@pytest.mark.parametrize("path", DOCUMENTS, ids=lambda path: path.name)
def test_documents_name_options_that_exist(path):
    parser = build_parser()
    (commands,) = (one for one in parser._actions if one.dest == "command")
    assert commands.choices is not None
    known = set(commands.choices["train"]._option_string_actions)  # type: ignore[call-overload]
    for words in re.findall(r"clgs train ([^`\n]*)", path.read_text(encoding="utf-8")):
        assert set(re.findall(r"--[a-z][a-z.-]*", words)) <= known, words


def test_what_counts_more(tmp_path):
    file = tmp_path / "some.toml"
    file.write_text(
        'preset = "paper"\nnear = 0.5\nvoxel = 0.25\n[learning_rates]\noffset = [1, 2]\n'
    )
    config = parse_command("--config", str(file), "--near", "0.75", "--set", "adam=visible")
    assert (config.preset, config.proxy, config.normalize) == ("paper", "pooled", False)
    assert (config.near, config.voxel, config.adam) == (0.75, 0.25, "visible")
    assert config.learning_rates == replace(PAPER_RATES, offset=(1.0, 2.0))
    assert parse_command("--preset", "quick", "--config", str(file)).preset == "quick"
    assert parse_command("--near", "1", "--set", "near=2", "--set", "near=3").near == 3.0
    assert parse_command("--loss-weights", "1", "0.5", "--l1-weight", "2") == replace(
        TrainConfig(), l1_weight=2.0, ssim_weight=0.5
    )


def test_steps_scale_what_lies_below():
    assert layered({"steps": 300}) == TrainConfig().scaled(300)
    assert layered({"preset": "quick"}, {"steps": 300}).switch_step == 150
    assert layered({"switch_step": 20_000}, {"steps": 3000}).switch_step == 2000
    assert layered({"steps": 3000}, {"switch_step": 2500}).switch_step == 2500
    assert layered({"steps": 3000, "switch_step": 2500}).switch_step == 2500


def test_values_that_fit_only_together():
    config = layered({"growth_end": 20_000}, {"switch_step": 25_000})
    assert (config.growth_end, config.switch_step) == (20_000, 25_000)


@pytest.mark.parametrize("name", ["default", "quick", "paper"])
def test_the_file_of_a_run_gives_the_same_run(tmp_path, name):
    config = replace(preset(name).scaled(1234), seed=7).for_dataset("colmap")
    (tmp_path / "config.toml").write_text(config.to_toml())
    assert parse_command("--config", str(tmp_path / "config.toml")) == config


@pytest.mark.parametrize(
    ("word", "message"),
    [
        ("steps", "'steps' is not NAME=VALUE"),
        (" =3", "' =3' is not NAME=VALUE"),
        ("learning_rates=1,2", "learning_rates: no such setting; did you mean learning_rates."),
        ("stpes=3", "stpes: no such setting; did you mean steps?"),
        ("offset=1,2", "offset: no such setting; did you mean offset_q?"),
        ("mlp_color=1,2", "mlp_color: no such setting; did you mean learning_rates.mlp_color?"),
        ("zzz=1", "zzz: no such setting; `clgs train --help` lists all"),
        ("steps=3.5", "steps: 3.5 is not a whole number; give a whole number of at least 1"),
        ("steps=many", "steps: 'many' is not a whole number"),
        ("steps=0", "steps: 0 is out of range; give a whole number of at least 1"),
        ("near=nan", "near: nan is not a finite number; give a number above 0"),
        ("near=0", "near: 0 is out of range; give a number above 0"),
        ("smallest-anchor=1e9", "give a number from 0 to 65536"),
        ("normalize=1", "normalize: '1' is not true or false; give true or false"),
        ("adam=sparse", "adam: 'sparse' is not known; give dense or visible"),
        ("learning_rates.offset=1", "is not two finite numbers; give two numbers above 0, such as"),
        ("learning_rates.offset=1,0", "is out of range; give two numbers above 0"),
        (f"steps={'1' * 5000}", "is not a whole number"),
    ],
)
def test_a_wrong_word_is_one_line(word, message):
    with pytest.raises(UsageError) as caught:
        parse_command("--set", word)
    assert message in str(caught.value)
    assert str(caught.value).startswith("--set ")
    assert "\n" not in str(caught.value)
    assert len(str(caught.value)) < 160


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"steps = ", "not a TOML file"),
        (b"stepz = 3", "did you mean steps?"),
        (b"near = true", "near: True is not a finite number; give a number above 0"),
        (b"\xff", "is not UTF-8 text"),
        (b"#" * (2**20 + 1), "has more than 1048576 bytes"),
        (b"near = 0.2\nnear = 0.3", "not a TOML file"),
        (b"x = " + b"[" * 5000, "not a TOML file"),
    ],
)
def test_a_wrong_file_is_one_line_of_wrong_usage(tmp_path, content, message):
    (tmp_path / "some.toml").write_bytes(content)
    with pytest.raises(UsageError) as caught:
        read_settings(tmp_path / "some.toml")
    assert message in str(caught.value)
    assert str(caught.value).startswith(f"{tmp_path / 'some.toml'}: ")
    assert caught.value.exit_code == 2


def test_a_file_that_is_none_is_named(tmp_path):
    for path in (tmp_path, tmp_path / "none.toml"):
        with pytest.raises(UsageError, match=f"{path.name}: .*; name a TOML file of settings"):
            read_settings(path)


@dataclass(frozen=True)
class Newcomer:
    """Settings with a new option."""

    wobble: int = option(3, "waves per step", at_least(0), unit="waves", group="new")


def test_a_new_option_needs_one_place(monkeypatch):
    one = options_of(Newcomer)["wobble"]
    assert Newcomer(wobble=one.parse("4")).wobble == 4
    with pytest.raises(
        UsageError, match="wobble: -1 is out of range; give a whole number of at least 0"
    ):
        one.parse("-1")
    parser = argparse.ArgumentParser()
    training.add_option(parser.add_argument_group("new"), one)
    assert vars(parser.parse_args(["--wobble", "5"])) == {"wobble": 5}
    assert "--wobble N  waves per step (waves; at least 0; default: 3)" in parser.format_help()


def test_a_field_that_is_not_declared_is_named():
    @dataclass(frozen=True)
    class Careless:
        wobble: int = 3

    with pytest.raises(TypeError, match=r"Careless\.wobble: declare it by option"):
        options_of(Careless)


def test_names_may_have_hyphens():
    assert parse_word("learning-rates.mlp-color=1,2") == ("learning_rates.mlp_color", (1.0, 2.0))
