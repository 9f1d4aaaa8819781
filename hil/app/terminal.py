"""Makes untrusted text safe for a terminal: control and reordering characters are shown as escapes."""

import unicodedata

_STEERING = {"Cc", "Cf", "Cs", "Zl", "Zp"}
"""Unicode categories: control, format (reordering among them), surrogates, line and paragraph separators."""


LONGEST = 4000
"""Most characters of a text in one line: a page of a book."""


def visible(text: str) -> str:
    r"""Text with control characters escaped, as \x1b or \u202e; line feeds stay."""
    if text.isprintable():
        return text
    return "".join(
        sign
        if sign == "\n" or unicodedata.category(sign) not in _STEERING
        else sign.encode("unicode_escape", "surrogatepass").decode("ascii")
        for sign in text
    )


def one_line(text: str) -> str:
    """Text with control characters escaped, in one line of limited length."""
    more = len(text) - LONGEST
    end = f" ... and {more} more characters" if more > 0 else ""
    return visible(text[:LONGEST].replace("\n", "\\n")) + end
