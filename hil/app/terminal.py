"""Text of strangers on a terminal: what would steer it, or reorder what is read, is shown as its number."""

import unicodedata

_STEERING = {"Cc", "Cf", "Cs", "Zl", "Zp"}
"""Unicode categories: control, format (reordering among them), halves of pairs, line and paragraph breaks."""


LONGEST = 4000
"""Signs of a text in one line: a page of a book."""


def visible(text: str) -> str:
    r"""Return a text with what is no sign as \x1b or \u202e; line feeds stay."""
    if text.isprintable():
        return text
    return "".join(
        sign
        if sign == "\n" or unicodedata.category(sign) not in _STEERING
        else sign.encode("unicode_escape", "surrogatepass").decode("ascii")
        for sign in text
    )


def one_line(text: str) -> str:
    """Return a text as `visible`, in one line, and not without end."""
    more = len(text) - LONGEST
    end = f" ... and {more} signs more" if more > 0 else ""
    return visible(text[:LONGEST].replace("\n", "\\n")) + end
