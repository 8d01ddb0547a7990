"""Sphinx extension: pages that are made from the code, and pages that are files of the repository.

A page holds ``<!-- generated: commands -->`` where generated text belongs. A page that is
nothing but a link to a Markdown file outside of docs/ becomes that file. Both read well unbuilt.
"""

from __future__ import annotations

import posixpath
import re
from pathlib import Path
from typing import TYPE_CHECKING, Any

import generated
import notebook

if TYPE_CHECKING:
    from sphinx.application import Sphinx

ROOT = Path(__file__).resolve().parents[2]
MADE = {
    "commands": generated.commands,
    "notebook": notebook.page,
    "training options": generated.training_options,
}
MARK = re.compile(r"<!-- generated: ([a-z ]+) -->")
LONE_LINK = re.compile(r"\s*\[[^\]]*\]\(((?:\.\./)+[^)#]+\.md)\)\s*")
LINK = re.compile(r"(!?)\[([^\]]*)\]\(([^)\s]+)\)")
ARRAY = re.compile(r"~?(?:numpy\.)?ndarray\[~?tuple\[[^\]]*\], ~?(?:numpy\.)?dtype\[([^\]]*)\]\]")
FENCED = re.compile(r"(^```.*?^```$|`[^`\n]*`)", re.MULTILINE | re.DOTALL)


def setup(app: Sphinx) -> dict[str, Any]:
    """Register the extension."""
    app.connect("source-read", read_page)
    app.connect("autodoc-process-signature", shorten_signature)
    return {"parallel_read_safe": True}


def read_page(app: Sphinx, docname: str, source: list[str]) -> None:
    """Change the text of a page, ``source[0]``, before it is parsed."""
    text, home = source[0], posixpath.dirname(f"docs/{docname}")
    if lone := LONE_LINK.fullmatch(text):
        name = posixpath.normpath(posixpath.join(home, lone[1]))
        text, home = (ROOT / name).read_text(encoding="utf-8"), posixpath.dirname(name)
    text = MARK.sub(lambda mark: MADE[mark[1]](), text)
    source[0] = link_within_site(text, home, files_as_pages())


def shorten_signature(
    app: Sphinx, what: str, name: str, item: object, options: object, words: str, result: str
) -> tuple[str, str]:
    """The signature and result of ``name`` with NumPy's arrays as people write them."""
    short = [ARRAY.sub(r"NDArray[\1]", text) if text else text for text in (words, result)]
    return short[0], short[1]


def files_as_pages() -> dict[str, str]:
    """Page of each file outside of docs/ that is one, both as paths from the root."""
    found = {"README.md": "docs/index.md"}
    for page in sorted((ROOT / "docs").rglob("*.md")):
        if lone := LONE_LINK.fullmatch(page.read_text(encoding="utf-8")):
            name = page.relative_to(ROOT).as_posix()
            found[posixpath.normpath(posixpath.join(posixpath.dirname(name), lone[1]))] = name
    return found


def link_within_site(text: str, home: str, pages: dict[str, str]) -> str:
    """Markdown of a file in folder ``home`` with links as the site needs them.

    Links to pages become absolute, those to other files of the repository their label alone.
    """

    def replace(link: re.Match[str]) -> str:
        mark, label, target = link.groups()
        path, hash_sign, anchor = target.partition("#")
        if not path or re.match(r"[a-z]+:", path):
            return link[0]
        name = posixpath.normpath(posixpath.join(home, path))
        name = pages.get(name, name)
        if not name.startswith("docs/"):
            return f"{mark}{label}"
        return f"{mark}[{label}](/{name.removeprefix('docs/')}{hash_sign}{anchor})"

    parts = FENCED.split(text)
    return "".join(p if p.startswith("`") else LINK.sub(replace, p) for p in parts)
