"""Words of the search: of a name like `watchdog_ms` its parts, too, so that `watchdog` finds its page."""

from __future__ import annotations

import re

from sphinx.application import Sphinx
from sphinx.search.en import SearchEnglish

_PART = re.compile(r"[^\W_]+")


class SearchNames(SearchEnglish):
    """English, and names taken apart at their underscores."""

    def split(self, input: str) -> list[str]:  # noqa: A002 - Sphinx's name
        """Return the words of a text: each as it stands, and the parts of names."""
        words = super().split(input)
        return [*words, *(part for word in words if "_" in word for part in _PART.findall(word))]


def setup(app: Sphinx) -> dict[str, bool]:
    """Take the place of English."""
    app.add_search_language(SearchNames)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
