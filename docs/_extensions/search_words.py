"""Search words: a name like `watchdog_ms` is also found by its parts, so that `watchdog` finds its page."""

from __future__ import annotations

import re

from sphinx.application import Sphinx
from sphinx.search.en import SearchEnglish

_PART = re.compile(r"[^\W_]+")


class SearchNames(SearchEnglish):
    """English, and names split at their underscores."""

    def split(self, input: str) -> list[str]:  # noqa: A002 - Sphinx's name
        """Split a text into words: each word itself, and the parts of names."""
        words = super().split(input)
        return [*words, *(part for word in words if "_" in word for part in _PART.findall(word))]


def setup(app: Sphinx) -> dict[str, bool]:
    """Replace Sphinx's English."""
    app.add_search_language(SearchNames)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
