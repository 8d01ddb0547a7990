"""The command line: help, version, exit codes, one line an error."""

import argparse
import os
import re
import signal
import subprocess
import sys
import types
from itertools import takewhile
from pathlib import Path
from unittest.mock import Mock

import pytest

from clgs import __version__
from clgs.cli import main as cli
from clgs.cli.parser import EXAMPLES
from clgs.errors import ClgsError, CodecError, DataError, DeviceError
from tests.terminal import python


@pytest.fixture
def run_raising(monkeypatch):
    """Call it with an error: the command ``fail`` then raises it; returns main's exit code."""

    def run(error):
        module = types.SimpleNamespace(register=lambda parser: None, run=Mock(side_effect=error))
        monkeypatch.setitem(sys.modules, "clgs.cli.commands.fail", module)
        monkeypatch.setattr(cli, "COMMANDS", {"fail": "fails"})
        return cli.main(["fail"])

    return run


def cl_error(name):
    return type(name, (Exception,), {"__module__": "pyopencl._cl"})


@pytest.mark.parametrize(
    ("error", "code", "line"),
    [
        (ClgsError("loss is not finite at step 7"), 1, "loss is not finite at step 7"),
        (DataError("x.json: no frames"), 3, "x.json: no frames"),
        (CodecError("ANCH: bad CRC"), 3, "ANCH: bad CRC"),
        (DeviceError("no device\n\tfound"), 4, "no device found"),
        (
            OSError(28, "No space left on device", "/x"),
            1,
            "/x: No space left on device; free space and",
        ),
        (PermissionError(13, "Permission denied", "/x"), 1, "/x: Permission denied"),
        (MemoryError(), 1, "out of memory"),
        (cl_error("MemoryError")("clCreateBuffer failed:\nX"), 4, "out of memory (clCreateBuffer"),
        (cl_error("LogicError")("clSetKernelArg failed:\nX"), 4, "LogicError: clSetKernelArg"),
        (
            cl_error("RuntimeError")("clFinish failed: OUT_OF_RESOURCES\nX"),
            4,
            "OUT_OF_RESOURCES), and this process cannot use it any more; start another one",
        ),
        (ModuleNotFoundError("No module", name="pyopencl"), 4, "pip install pyopencl"),
        (ImportError("libOpenCL.so.1", name="pyopencl._cl"), 4, "libOpenCL.so.1"),
        (ModuleNotFoundError("No module", name="rich"), 1, "rich cannot be loaded"),
        (KeyError("oops"), 1, "KeyError: 'oops' (this is a bug"),
        (KeyboardInterrupt(), 130, "clgs: interrupted"),
        (KeyboardInterrupt("; go on"), 130, "clgs: interrupted; go on"),
    ],
)
def test_an_error_is_one_line_and_a_code(run_raising, monkeypatch, capsys, error, code, line):
    monkeypatch.delenv("CLGS_DEBUG", raising=False)
    assert run_raising(error) == code
    out, err = capsys.readouterr()
    assert out == ""
    assert err.count("\n") == 1
    assert line in err
    assert err.startswith("clgs: ")
    assert "Traceback" not in err


@pytest.mark.parametrize("place", ["build_parser", "_run"])
def test_an_early_interruption_is_one_line(monkeypatch, capsys, place):
    monkeypatch.setattr(cli, place, Mock(side_effect=KeyboardInterrupt))
    assert cli.main(["devices"]) == 130
    assert capsys.readouterr().err == "clgs: interrupted\n"


def test_warnings_are_one_line_each():
    code = """
import logging, sys, types, warnings
from clgs.cli import main as cli
def run(args):
    warnings.warn("x.npz: damaged,\\n skipped")
    logging.getLogger("clgs.data").warning("3 photos are missing")
    return 0
module = types.SimpleNamespace(run=run, register=lambda parser: None)
sys.modules["clgs.cli.commands.warn"], cli.COMMANDS = module, {"warn": "warns"}
sys.exit(cli.main(["warn"]))
"""
    result = python("-c", code)
    assert (result.returncode, result.stderr.splitlines()) == (
        0,
        ["clgs: warning: x.npz: damaged, skipped", "clgs: warning: 3 photos are missing"],
    )


def test_debug_shows_the_traceback(run_raising, monkeypatch, capsys):
    monkeypatch.setenv("CLGS_DEBUG", "1")
    assert run_raising(DataError("x.json: no frames")) == 3
    err = capsys.readouterr().err
    assert "Traceback" in err
    assert err.endswith("clgs: error: x.json: no frames\n")


def test_version():
    done = python("-m", "clgs", "--version")
    assert (done.returncode, done.stdout) == (0, f"clgs {__version__}\n")


def test_help_names_every_command():
    result = python("-m", "clgs", "--help")
    assert result.returncode == 0
    for command in cli.COMMANDS:
        assert command in result.stdout.split()


@pytest.mark.parametrize("command", cli.COMMANDS)
def test_every_command_has_help_with_examples_within_80_columns(command, monkeypatch, output_of):
    monkeypatch.setenv("COLUMNS", "80")
    out = output_of(command, "--help")
    assert f"usage: clgs {command}" in out
    assert f"\nexamples:\n  clgs {command}" in out
    assert max(map(len, out.splitlines())) <= 80


def parsers(parser):
    yield parser
    for action in parser._actions:
        if isinstance(action, argparse._SubParsersAction):
            for one in action.choices.values():
                yield from parsers(one)


def test_help_tells_each_default_once():
    for parser in parsers(cli.build_parser()):
        text = " ".join(parser.format_help().split())
        assert not re.search(r"\(default[^()]*\) \(default|\(default: None", text), parser.prog


@pytest.mark.parametrize("command", cli.COMMANDS)
def test_examples_are_understood(command, capsys):
    for line in EXAMPLES[command]:
        words = line.split()[1:]
        if "--help" not in words:
            assert cli.build_parser([command]).parse_args(words).command == command


@pytest.mark.parametrize(
    ("words", "usage"),
    [(["help"], "usage: clgs "), (["help", "bench", "ops"], "usage: clgs bench ops")],
)
def test_help_is_a_command_too(words, usage, output_of):
    assert output_of(*words).startswith(usage)


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["tran"], "COMMAND 'tran' is unknown (did you mean train?); see clgs --help"),
        (["xyzzy"], "COMMAND 'xyzzy' is unknown; see clgs --help"),
        (
            ["--versoin"],
            "unrecognized arguments: --versoin (did you mean --version?); see clgs --help",
        ),
        (
            ["train", "--stepz=9"],
            "unrecognized arguments: --stepz=9 (did you mean --steps?); see clgs train --help",
        ),
        (["bench", "stp"], "WHAT 'stp' is unknown (did you mean step?); see clgs bench --help"),
    ],
)
def test_a_mistyped_command_is_answered_by_the_nearest(words, said, refusal):
    assert refusal(2, *words) == f"{said}\n"


def test_a_file_that_looks_like_an_option_is_named(tmp_path, monkeypatch, refusal):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "-x.mp4").touch()
    said = refusal(2, "prepare", "-x.mp4", "-o", "data")
    assert "PHOTOS; the file -x.mp4 is written ./-x.mp4; see" in said


@pytest.mark.parametrize(
    "arguments",
    [
        (),
        ("nonsense",),
        ("info",),
        ("info", "x", "--nonsense"),
        ("train", "x"),
        ("bench", "step", "--nonsense"),
        ("bench", "accuracy", "--size", "0"),
    ],
)
def test_wrong_usage_exits_2(arguments, refusal):
    command = " ".join(takewhile(cli.COMMANDS.__contains__, arguments))
    kind = " ".join(arguments[1:2]) if command == "bench" else ""
    name = " ".join(word for word in ("clgs", command, kind) if word)
    assert re.fullmatch(rf".+; see {name} --help\n", refusal(2, *arguments))


@pytest.mark.parametrize(
    "arguments",
    [
        ("bench", "step", "--seed", "-1"),
        ("bench", "ops", "--size", "0"),
        ("train", "x", "--output", ""),
        ("train", "x", "-o", "y", "--steps", "0"),
        ("render", "x", "--data", "y", "--output", ""),
        ("prepare", "x", "--output", " "),
        ("prepare", "x", "-o", "y", "--seed", "-1"),
        ("encode", "x", "--output", ""),
        ("decode", "x", "--output", ""),
        ("pack", "x", "--output", ""),
        ("unpack", "x", "--output", " "),
        ("train", "x", "-o", "y", "--smallest-anchor", "-1"),
        ("train", "x", "-o", "y", "--smallest-anchor", "nan"),
        ("train", "x", "-o", "y", "--smallest-anchor", "inf"),
        ("train", "x", "-o", "y", "--smallest-anchor", "x"),
        ("encode", "x", "-o", "y", "--target-size", "much"),
        ("encode", "x", "-o", "y", "--threads", "1.5"),
        ("encode", "x", "-o", "y", "--threads"),
        ("pack", "x", "-o", "y", "--step", "scale=0"),
    ],
)
def test_a_wrong_value_is_one_line(arguments, refusal):
    option = next(word for word in reversed(arguments) if word.startswith("--"))
    assert refusal(2, *arguments).split(": ")[0].endswith(option)


def test_a_termination_is_one_line_from_the_first_moment_on(monkeypatch, capsys):
    before = signal.getsignal(signal.SIGTERM)
    monkeypatch.setattr(cli, "_run", lambda argv: os.kill(os.getpid(), signal.SIGTERM))
    assert cli.main(["devices"]) == 130
    assert capsys.readouterr().err == "clgs: interrupted\n"
    assert signal.getsignal(signal.SIGTERM) == before


def test_a_specialisation_that_there_is_not_is_wrong_usage(monkeypatch, refusal):
    monkeypatch.setenv("CLGS_SPECIALISATION", "bogus")
    for command in ("selftest", "conformance"):
        assert "CLGS_SPECIALISATION=bogus: is not cpu or gpu" in refusal(2, command)


def test_a_closed_output_is_no_error():
    """The case of ``clgs info scene.clgs >&-``."""
    code = "import os, sys; os.close(1); os.execv(sys.executable, [sys.executable, *sys.argv[1:]])"
    scene = next((Path(__file__).parents[1] / "codec" / "golden").glob("*.clgs"))
    command = [sys.executable, "-c", code, "-m", "clgs", "info", str(scene)]
    bare = [sys.executable, "-c", code, "-c", "import sys; assert sys.stdout is None"]
    assert subprocess.run(bare, check=False).returncode == 0
    found = subprocess.run(command, stderr=subprocess.PIPE, text=True, check=False)
    assert (found.returncode, found.stderr) == (0, "")


@pytest.mark.slow
@pytest.mark.parametrize("commands", ["", "info", *cli.LABORATORY, "COMMANDS"])
def test_help_imports_nothing_heavy_and_no_other_command(commands):
    heavy = ["numpy", "pyopencl", "skimage", "pycolmap", "rich", "trimesh", "PIL", "asyncio"]
    code = f"""
import sys
from clgs.cli.main import COMMANDS, build_parser
build_parser({"COMMANDS" if commands == "COMMANDS" else commands.split()}).format_help()
loaded = [name.split(".")[3] for name in sys.modules if ".commands." in name]
assert {commands!r} == "COMMANDS" or loaded == {commands.split()}, loaded
assert {commands!r} not in ("", "info") or not any("clgs.lab" in name for name in sys.modules)
print([name for name in {heavy} if name in sys.modules], len(sys.modules) < 200)
"""
    result = python("-c", code)
    assert result.stdout.strip() == "[] True", result.stderr


def test_no_device_is_one_line_and_exit_code_4(tmp_path):
    result = python("-m", "clgs", "devices", PYOPENCL_CTX="no-such-platform")
    assert result.returncode == 4
    assert result.stderr.count("\n") == 1
    assert "PYOPENCL_CTX=no-such-platform" in result.stderr


@pytest.mark.skipif(os.name == "nt", reason="no such pipes")
def test_a_reader_that_leaves_is_no_error():
    reading, writing = os.pipe()
    os.close(reading)
    command = [sys.executable, "-m", "clgs", "devices"]
    result = subprocess.run(command, stdout=writing, stderr=subprocess.PIPE, check=False)
    os.close(writing)
    assert (result.returncode, result.stderr) == (0, b"")


def test_a_lack_of_memory_is_distinguished_from_a_bug(run_raising, monkeypatch, capsys):
    """Clean-up may fail after it, as of zipfile; and threads are not started."""
    closed = ValueError("I/O operation on closed file")
    closed.__context__ = MemoryError()
    for error in (closed, RuntimeError("can't start new thread"), MemoryError("Unable")):
        assert run_raising(error) == 1
        assert capsys.readouterr().err == "clgs: error: out of memory; try a larger --downscale\n"
    assert run_raising(ValueError("I/O operation on closed file")) == 1
    assert "this is a bug" in capsys.readouterr().err


@pytest.mark.slow
@pytest.mark.parametrize("command", ["encode", "decode", "pack", "unpack"])
def test_commands_of_the_codec_say_what_needs_less_memory(command, monkeypatch, refusal):
    monkeypatch.setattr(f"clgs.cli.commands.{command}.run", Mock(side_effect=MemoryError))
    said = refusal(1, command, "a", "-o", "b")
    assert said.startswith("out of memory; --threads 1 ")
    shown = python("-m", "clgs", command, "--help")
    assert shown.returncode == 0
    assert all(word in shown.stdout for word in said.split() if word.startswith("--"))


@pytest.mark.skipif(not hasattr(os, "fork"), reason="no limits of memory")
def test_a_process_short_of_memory(tmp_path):
    """A limit between what an empty interpreter needs and what the command does."""
    code = """
import resource, sys
from clgs.cli import main as cli
import clgs.cli.commands.info, clgs.cli.commands.encode
import clgs.codec.splat_packing, clgs.workflow.scenes
size = 2**29
open(sys.argv[1], "wb").truncate(size)
used = int(open("/proc/self/statm").read().split()[0]) * resource.getpagesize()
resource.setrlimit(resource.RLIMIT_AS, (used + size // 2, resource.RLIM_INFINITY))
sys.exit(cli.main(["info", sys.argv[1]]))
"""
    result = python("-c", code, tmp_path / "sparse.clgs")
    remedy = "end other programs, or use a machine that has more"
    assert result.stderr == f"clgs: error: out of memory; {remedy}\n"
    assert result.returncode == 1


@pytest.mark.slow
@pytest.mark.parametrize("command", ["info", "decode", "encode"])
def test_files_are_coded_without_what_only_training_needs(command, tmp_path):
    """Loading SciPy or an OpenCL driver would take longer than the work."""
    code = f"""
import sys
from clgs.cli.main import main
main([{command!r}, "missing.npz", *([] if {command!r} == "info" else ["-o", "out.clgs"])])
print([name for name in ("scipy", "pyopencl") if name in sys.modules])
"""
    done = python("-c", code, cwd=tmp_path)
    assert done.stdout.splitlines()[-1] == "[]", done
