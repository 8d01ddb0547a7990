"""The documentation: what is made from the code is whole, and the check of links can fail."""

import argparse
import re
import sys
import tomllib
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT / "scripts" / "docs"))

import generated  # noqa: E402 - the folder of the scripts comes first
import links  # noqa: E402
import pages  # noqa: E402

import clgs  # noqa: E402
from clgs.cli.main import COMMANDS  # noqa: E402
from clgs.train.config import TrainConfig  # noqa: E402
from clgs.train.config.option import options_of  # noqa: E402


def test_readme_is_read_in_minutes():
    words = (ROOT / "README.md").read_text(encoding="utf-8").split()
    assert sum(bool(re.search(r"\w", word)) for word in words) <= 500


def test_guides_leave_figures_to_the_benchmarks():
    figure = re.compile(r"^\|.*\d (dB|MiB|ms)\b", re.MULTILINE)
    pages = (ROOT / "docs" / "guide").glob("*.md")
    assert [page.name for page in pages if figure.search(page.read_text(encoding="utf-8"))] == []


def test_no_link_in_the_repository_is_broken():
    files = links.markdown_files()
    assert {"README.md", "FORMAT.md", "faq.md"} <= {file.name for file in files}
    assert links.markdown_problems(files) == []


@pytest.mark.parametrize(
    ("link", "wrong"),
    [
        ("other.md", None),
        ("other.md#the-end-1", None),
        ("#here", None),
        ("https://example.org/a", None),
        ("absent.md", "no such file"),
        ("other.md#the-end-2", "no such anchor"),
        ("#there", "no such anchor"),
        ("https://nowhere", "not a well-formed address"),
        ("ftp://example.org", "unknown scheme"),
    ],
)
def test_broken_links_of_markdown_are_named(tmp_path, link, wrong):
    (tmp_path / "other.md").write_text("# A\n## The end\n```\n## Code\n```\n## The end\n")
    page = tmp_path / "page.md"
    page.write_text(f"# Here\n[text]({link}) and `[code](absent.md)`\n")
    expected = [f"{page}: {link}: {wrong}"] if wrong else []
    assert links.markdown_problems([page]) == expected


def test_scripts_that_are_not_there_are_named(tmp_path):
    page = tmp_path / "page.md"
    page.write_text("`./scripts/demo.sh` and\n```sh\n./scripts/absent.sh\n```\n")
    assert links.markdown_problems([page]) == [f"{page}: scripts/absent.sh: no such file"]


def test_broken_links_of_built_pages_are_named(tmp_path):
    (tmp_path / "b.html").write_text('<h1 id="top">b</h1>')
    body = '<a href="b.html#top">1</a><a href="b.html#end">2</a><img src="https://x.org/a.png">'
    page = tmp_path / "a.html"
    page.write_text(body)
    assert links.html_problems(tmp_path) == [
        f"{page}: b.html#end: no such anchor",
        f"{page}: https://x.org/a.png: loaded from elsewhere",
    ]
    assert links.main([str(tmp_path)]) == 1


def test_every_command_and_option_has_its_line():
    text = generated.commands()
    assert [name for name in COMMANDS if f"## clgs {name}\n" not in text] == []
    for option in ("`--target-size` `BYTES`", "## clgs bench step", "`PHOTOS`"):
        assert option in text


def test_help_becomes_plain_markdown():
    parser = argparse.ArgumentParser("clgs x", description="a_b * <c> | --deep `d_e`")
    parser.add_argument("--many", choices=("p", "q"), required=True, help="%(dest)s of 5 %%")
    text = generated._command(parser, 2)
    assert r"a\_b \* \<c\> \| `--deep` `d_e`" in text
    assert "| `--many` | required; many of 5 %; `p`, `q` |" in text


def test_every_training_option_has_its_row():
    text = generated.training_options()
    rows = {
        name: rest
        for name, *rest in re.findall(r"^\| `([a-z0-9_.]+)` \|(.*)\|(.*)\|$", text, flags=re.M)
    }
    assert set(rows) == set(options_of(TrainConfig))
    assert [name for name, (_, meaning) in rows.items() if not meaning.strip()] == []


def test_every_public_name_is_on_the_python_page():
    text = (ROOT / "docs" / "reference" / "python.md").read_text(encoding="utf-8")
    listed = re.findall(r"^\.\. auto(?:function|class):: (\w+)$", text, flags=re.M)
    assert sorted(listed) == sorted(clgs.__all__)


def test_links_between_files_and_pages_are_rewritten():
    known = {"ARCHITECTURE.md": "docs/architecture.md"}
    text = "[a](../ARCHITECTURE.md#x) [b](faq.md) [c](../clgs/files.py) `[d](../e.md)` [f](https://g.h)"
    assert pages.link_within_site(text, "docs", known) == (
        "[a](/architecture.md#x) [b](/faq.md) c `[d](../e.md)` [f](https://g.h)"
    )
    assert pages.files_as_pages()["codec_c/FORMAT.md"] == "docs/reference/format.md"


def test_version_is_the_same_everywhere():
    with (ROOT / "pyproject.toml").open("rb") as file:
        version = tomllib.load(file)["project"]["version"]
    assert clgs.__version__ == version
    assert f"\nversion: {version}\n" in (ROOT / "CITATION.cff").read_text(encoding="utf-8")
    changes = (ROOT / "CHANGELOG.md").read_text(encoding="utf-8")
    assert re.findall(r"^## \[([\d.]+)\]", changes, flags=re.M)[0] == version
