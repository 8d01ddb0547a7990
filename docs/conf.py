"""Settings of the documentation's build by Sphinx; ./scripts/docs.sh runs it."""

import os
import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "scripts" / "docs"))

from clgs import __version__

os.environ["COLUMNS"] = "84"  # of the usage lines of commands

project = "clgs"
author = "The clgs authors"
version = release = __version__

extensions = ["myst_parser", "sphinx.ext.autodoc", "sphinx.ext.napoleon", "pages"]
exclude_patterns = ["benchmarks/*.json"]
suppress_warnings = ["config.cache"]
smartquotes = False  # two hyphens begin an option

myst_heading_anchors = 4
autodoc_member_order = "bysource"
autodoc_typehints_format = "short"
autodoc_preserve_defaults = True
python_use_unqualified_type_names = True
maximum_signature_line_length = 80
napoleon_google_docstring = True

html_theme = "furo"
html_title = f"clgs {version}"
html_copy_source = False
html_show_copyright = False
