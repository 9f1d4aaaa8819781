"""HTML from texts: whatever goes in is escaped; only what `tag` has made stays as it is."""

from collections.abc import Iterable
from html import escape


class Html(str):
    """HTML that is whole: no text of a log."""

    __slots__ = ()


def tag(name: str, *content: object, **attributes: object) -> Html:
    """Return an element. Content that is not Html is escaped; `class_` is class, `data_x` is data-x."""
    given = "".join(
        f' {key.rstrip("_").replace("_", "-")}="{escape(str(value), quote=True)}"'
        for key, value in attributes.items()
        if value is not None
    )
    return Html(f"<{name}{given}>{joined(content)}</{name}>")


def joined(content: Iterable[object]) -> Html:
    """Return what follows each other."""
    return Html("".join(x if isinstance(x, Html) else escape(str(x), quote=True) for x in content))


def prose(text: str) -> Html:
    """Return a text; what stands between two backticks is code."""
    parts = text.split("`")
    if len(parts) % 2 == 0:
        return joined([text])
    return joined(tag("code", part) if k % 2 else part for k, part in enumerate(parts))


def table(head: Iterable[object], rows: Iterable[Iterable[object]], caption: str = "") -> Html:
    """Return a table in a box that scrolls; the first cell of each row is its heading."""
    lines = [
        tag("tr", tag("th", first, scope="row"), *(tag("td", cell) for cell in rest)) for first, *rest in rows
    ]
    top = tag("thead", tag("tr", *(tag("th", cell, scope="col") for cell in head)))
    title = [tag("caption", caption)] if caption else []
    return tag("div", tag("table", *title, top, tag("tbody", *lines)), class_="scroll", tabindex=0)
