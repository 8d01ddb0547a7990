"""The workflow files: pinned actions, no secrets, the least permissions, and what was run."""

import re
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
FILES = sorted((ROOT / ".github" / "workflows").glob("*.yml"))


@pytest.fixture(params=FILES, ids=lambda path: path.name)
def text(request):
    return request.param.read_text(encoding="utf-8")


def test_actions_and_tools_are_pinned_by_version(text):
    used = re.findall(r"uses: (\S+)", text)
    assert used
    assert [
        name for name in used if not re.fullmatch(r"[\w.-]+/[\w.-]+@v\d+\.\d+\.\d+", name)
    ] == []
    installed = re.findall(r"pip install (.+)", text)
    names = [name for line in installed for name in line.split() if not name.startswith(("-", '"'))]
    assert [name for name in names if "==" not in name] == []
    assert re.findall(r"\S*-latest", text) == []


def test_permissions_are_to_read_alone(text):
    assert re.findall(r"^( *)permissions:\n +(.+)$", text, flags=re.M) == [("", "contents: read")]
    assert text.count("actions/checkout@") == text.count("persist-credentials: false")
    assert "secrets." not in text
    assert "pull_request_target" not in text


def test_what_was_never_run_is_said_at_the_top(text):
    head = " ".join(re.findall(r"^#(.*)", text.split("\nname:", 1)[0], flags=re.M))
    assert "Only " in head
    assert re.search(r"macOS and Windows were\s+never", head)


def test_scripts_that_they_call_exist(text):
    called = re.findall(r"(?:\./)?((?:scripts/|\.ci/)[\w/.]+)", text)
    assert [name for name in called if not (ROOT / name).is_file()] == []
