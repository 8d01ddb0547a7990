"""Scripts by which shells complete what is typed."""

from __future__ import annotations

import shutil
import subprocess

import pytest

from clgs.cli import main as cli
from clgs.cli.completion import SHELLS, options_by_command


@pytest.mark.parametrize("shell", SHELLS)
def test_scripts_name_every_command_and_its_options(shell, capsys):
    with pytest.raises(SystemExit) as done:
        cli.main(["--completion", shell])
    assert done.value.code == 0
    script = capsys.readouterr().out
    options = options_by_command(cli.build_parser())
    assert list(options) == list(cli.COMMANDS)
    assert "--preset" in options["train"]
    for name, words in options.items():
        assert name in script
        assert all(word.removeprefix("--") in script for word in words)


@pytest.mark.skipif(shutil.which("bash") is None, reason="no bash")
@pytest.mark.parametrize(
    ("typed", "offered"),
    [
        ("clgs tr", ["train"]),
        ("clgs train --down", ["--downscale"]),
        ("clgs train fo", []),
        ("clgs train fox --preset q", ["quick"]),
        ("clgs export scene --units s", ["scene"]),
        ("clgs render scene --preset q", []),
    ],
)
def test_bash_completes(typed, offered, capsys):
    with pytest.raises(SystemExit):
        cli.main(["--completion", "bash"])
    script = capsys.readouterr().out
    words = typed.split()
    line = f"COMP_WORDS=({typed}); COMP_CWORD={len(words) - 1}; _clgs; echo ${{COMPREPLY[@]}}"
    found = subprocess.run(
        ["bash", "-c", script + line], capture_output=True, text=True, check=True
    )
    assert found.stdout.split() == offered
