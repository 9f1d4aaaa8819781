"""Sphinx configuration. The pages need no network when built and none when read."""

from __future__ import annotations

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent / "_extensions"))

project = "hexapod-hil"
project_copyright = "the hexapod-hil authors, Apache-2.0"
extensions = ["myst_parser", "mathml", "columns"]
source_suffix = {".md": "markdown"}
exclude_patterns = ["_extensions"]
myst_enable_extensions = ["dollarmath", "colon_fence", "deflist"]
myst_heading_anchors = 3
html_theme = "furo"
html_title = "hexapod-hil"
html_copy_source = False
nitpicky = True
