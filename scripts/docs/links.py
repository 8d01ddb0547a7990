"""Check links: of the repository's Markdown files, and of the built pages in a folder.

python scripts/docs/links.py [FOLDER]. Files and anchors must exist; addresses elsewhere must be
well-formed, and are not visited. Exit code 1 if a link is broken.
"""

from __future__ import annotations

import re
import sys
from collections.abc import Callable, Container, Iterable
from functools import cache
from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote, urlsplit

ROOT = Path(__file__).resolve().parents[2]
CODE = re.compile(r"^```.*?^```$|`[^`\n]*`", re.MULTILINE | re.DOTALL)
LINK = re.compile(r"\[[^\]]*\]\(([^)\s]+)\)")
HEADING = re.compile(r"^#{1,6} +(.+?) *#*$", re.MULTILINE)
SCRIPT = re.compile(r"\bscripts/[\w/]+\.(?:sh|py)\b")
GENERATED = "<!-- generated: "
LOADED = {("img", "src"), ("script", "src"), ("link", "href")}
"""Attributes whose address a browser loads without being asked."""


class Anything:
    """Contains every anchor: those of pages made from the code are checked once they are built."""

    def __contains__(self, anchor: object) -> bool:
        return True


class Page(HTMLParser):
    """The anchors of a page, its links, and the addresses that it loads."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.anchors: set[str] = set()
        self.links: list[str] = []
        self.loads: list[str] = []
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        """Call the base class."""
        for name, value in attrs:
            if name == "id" and value:
                self.anchors.add(value)
            elif name in ("href", "src") and value:
                self.links.append(value)
                if (tag, name) in LOADED:
                    self.loads.append(value)


@cache
def page(path: Path) -> Page:
    """The parsed HTML file."""
    return Page(path.read_text(encoding="utf-8"))


@cache
def headings(path: Path) -> Container[str]:
    """Anchors that GitHub gives the headings of a Markdown file; any, if some are made later."""
    text = path.read_text(encoding="utf-8")
    if GENERATED in text:
        return Anything()
    text = re.sub(r"^```.*?^```$", "", text, flags=re.MULTILINE | re.DOTALL)
    found: set[str] = set()
    for title in HEADING.findall(text):
        plain = LINK.sub(lambda link: link[0][1 : link[0].index("]")], title)
        slug = re.sub(r"[^\w\- ]", "", plain.lower()).replace(" ", "-")
        number = next(n for n in range(len(found) + 1) if _numbered(slug, n) not in found)
        found.add(_numbered(slug, number))
    return found


def _numbered(slug: str, number: int) -> str:
    return f"{slug}-{number}" if number else slug


def problem(link: str, source: Path, anchors: Callable[[Path], Container[str]]) -> str | None:
    """What is wrong with a link in the file ``source``, or None; ``anchors`` of a file."""
    parts = urlsplit(link)
    if parts.scheme:
        if parts.scheme in ("http", "https") and "." not in parts.netloc:
            return "not a well-formed address"
        return None if parts.scheme in ("http", "https", "mailto", "data") else "unknown scheme"
    target = (source.parent / unquote(parts.path)).resolve() if parts.path else source
    if not target.exists():
        return "no such file"
    if not parts.fragment or target.suffix not in (".md", ".html"):
        return None
    return None if unquote(parts.fragment) in anchors(target) else "no such anchor"


def markdown_problems(files: Iterable[Path]) -> list[str]:
    """A line for each broken link of Markdown files, and for each script that is not there."""
    found = []
    for file in files:
        text = file.read_text(encoding="utf-8")
        for link in LINK.findall(CODE.sub("", text)):
            if wrong := problem(link, file, headings):
                found.append(f"{file}: {link}: {wrong}")
        scripts = sorted(set(SCRIPT.findall(text)))
        found += [f"{file}: {name}: no such file" for name in scripts if not (ROOT / name).exists()]
    return found


def html_problems(folder: Path) -> list[str]:
    """A line for each broken link of the pages in ``folder``, and for each that needs a network."""
    found = []
    for file in sorted(folder.rglob("*.html")):
        for link in page(file).links:
            if wrong := problem(link, file, lambda path: page(path).anchors):
                found.append(f"{file}: {link}: {wrong}")
        loads = page(file).loads
        found += [f"{file}: {link}: loaded from elsewhere" for link in loads if "//" in link]
    return found


def markdown_files() -> list[Path]:
    """Files of the repository, without built and installed ones."""
    tops = ("docs", "codec_c", "kernels_cl", ".github")
    return sorted([*ROOT.glob("*.md"), *(p for top in tops for p in (ROOT / top).rglob("*.md"))])


def main(folders: list[str]) -> int:
    """Check the Markdown files, and the pages in the folders; the exit code."""
    found = markdown_problems(markdown_files())
    for folder in folders:
        if not list(Path(folder).rglob("*.html")):
            found.append(f"{folder}: no pages")
        found += html_problems(Path(folder))
    for line in found:
        print(f"docs: broken link: {line}", file=sys.stderr)
    return 1 if found else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
