"""Completion of what is typed in a shell."""

import os
import shutil
import subprocess
import sys

import pytest

from clgs.cli.parser import SHELLS


@pytest.mark.parametrize("shell", SHELLS)
def test_the_script_is_one_that_the_shell_reads(shell, output_of):
    script = output_of("--completion", shell)
    assert "clgs" in script
    if shutil.which(shell):
        subprocess.run([shell, "-n"], input=script, text=True, check=True)


@pytest.mark.parametrize(
    ("typed", "offered"),
    [
        ("clgs tr", ["train"]),
        ("clgs train --downsc", ["--downscale"]),
        ("clgs train fo", []),
        ("clgs train fox --preset q", ["quick"]),
        ("clgs export scene --units s", ["scene"]),
        ("clgs bench st", ["step"]),
        ("clgs render scene --preset q", []),
    ],
)
def test_commands_options_and_values_are_completed(typed, offered, tmp_path):
    answer = tmp_path / "answer"
    asked = {
        **os.environ,
        "_ARGCOMPLETE": "1",
        "_ARGCOMPLETE_IFS": "\n",
        "_ARGCOMPLETE_SUPPRESS_SPACE": "1",
        "_ARGCOMPLETE_STDOUT_FILENAME": str(answer),
        "COMP_LINE": typed,
        "COMP_POINT": str(len(typed)),
    }
    command = [sys.executable, "-m", "clgs"]
    subprocess.run(command, env=asked, cwd=tmp_path, check=True, stderr=subprocess.DEVNULL)
    assert answer.read_text().split() == offered
