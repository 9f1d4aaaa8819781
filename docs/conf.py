"""Sphinx configuration. The pages need no network when built and none when read."""

from __future__ import annotations

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent / "_extensions"))

project = "hexapod-hil"
project_copyright = "the hexapod-hil authors, Apache-2.0"
extensions = ["myst_nb", "sphinx.ext.autodoc", "sphinx.ext.napoleon", "mathml", "columns", "search_words"]
source_suffix = {".md": "myst-nb", ".ipynb": "myst-nb"}
exclude_patterns = ["_extensions"]
myst_enable_extensions = ["dollarmath", "colon_fence", "deflist"]
myst_heading_anchors = 3
html_theme = "furo"
html_title = "hexapod-hil"
html_copy_source = False
html_static_path = ["_static"]
html_css_files = ["mathematics.css"]
html_show_search_summary = False  # it fetches each page found, which no browser allows for files of a disk
nitpicky = True
nitpick_ignore_regex = [("py:.*", r"(?!hil\.\w+$).*")]  # what is no name of `hil` has no page here
autodoc_typehints = "description"
autodoc_typehints_description_target = "documented"
autodoc_member_order = "bysource"
napoleon_google_docstring = False
default_role = "code"  # of docstrings: Markdown needs none
nb_execution_mode = "force"
nb_execution_in_temp = True
nb_execution_raise_on_error = True
nb_execution_timeout = 300
