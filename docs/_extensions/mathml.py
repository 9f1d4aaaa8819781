"""Equations as MathML: browsers draw it themselves, so no script is fetched when a page is read.

docutils translates; its output is corrected here: an accent belongs to its letter with the index next to
both, and brackets around tall content grow with it.
"""

from __future__ import annotations

import re
import xml.etree.ElementTree as ET
from collections.abc import Callable
from html import unescape
from typing import Any

from docutils import nodes
from docutils.utils.math import MathError
from docutils.utils.math.latex2mathml import accents, over, tex2mathml
from sphinx.application import Sphinx
from sphinx.util import logging

logger = logging.getLogger(__name__)
NAMESPACE = "http://www.w3.org/1998/Math/MathML"
ACCENTS = frozenset({*accents.values(), over["overline"][0]})
PAIRS = {"(": ")", "[": "]", "{": "}", "|": "|", "‖": "‖"}
"""Opening brackets -> closing brackets."""
SHORT = re.compile(r"(\\[td]?frac)\s*(\d)\s*(\d)")
"""A fraction of two digits without braces, which docutils reads as one number."""
ENTITY = re.compile(r"&(?!amp;|lt;|gt;|quot;|apos;|#)\w+;")
"""Named characters that HTML has and XML has not."""
TALL = frozenset({"mfrac", "mtable", "munder", "mover", "munderover"})
"""Elements with which brackets around them grow, except a single accent."""


def mathml(node: nodes.Element, *, block: bool) -> str:
    """Translate the equation of a node to MathML; an equation that cannot be translated is a warning."""
    text = node.astext()
    try:
        return corrected(str(tex2mathml(SHORT.sub(r"\1{\2}{\3}", text), as_block=block)))
    except MathError as error:
        logger.warning("equation %r: %s", text, error, location=node)
        return ""


def corrected(text: str) -> str:
    """Correct MathML: accents on their letters, and brackets that grow."""
    plain = ENTITY.sub(lambda found: unescape(found[0]), text.replace(f' xmlns="{NAMESPACE}"', ""))
    root = ET.fromstring(plain)  # noqa: S314 - from our own pages
    _each_child(root, _side_scripts)
    _each_child(root, _one_script)
    for row in list(root.iter()):
        if row.tag in {"math", "mrow", "mtd", "msqrt"}:
            _grow(row)
    root.set("xmlns", NAMESPACE)
    return ET.tostring(root, encoding="unicode")


def _each_child(root: ET.Element, change: Callable[[ET.Element], ET.Element]) -> None:
    for parent in list(root.iter()):
        for place, child in enumerate(list(parent)):
            parent[place] = change(child)


def _is_accent(element: ET.Element) -> bool:
    return element.tag == "mo" and element.text in ACCENTS


def _element(tag: str, *content: ET.Element, **attributes: str) -> ET.Element:
    found = ET.Element(tag, attributes)
    found.extend(content)
    return found


def _side_scripts(element: ET.Element) -> ET.Element:
    """Move the index of an accented letter next to it: docutils puts index and accent around the letter."""
    if element.tag != "munderover" or not _is_accent(element[2]):
        return element
    base, index, accent = element
    return _element("msub", _element("mover", base, accent, accent="true"), index)


def _one_script(element: ET.Element) -> ET.Element:
    """Put index and exponent above each other: after an accent docutils puts one behind the other."""
    if element.tag != "msup" or element[0].tag != "msub":
        return element
    return _element("msubsup", element[0][0], element[0][1], element[1])


def _grow(row: ET.Element) -> None:
    """Make each pair of brackets of a row as tall as its content."""
    opened: list[int] = []
    place = 0
    while place < len(row):
        ends = opened and _bracket(row[place], closing=True) == PAIRS[_bracket(row[opened[-1]])]
        if ends:
            first = opened.pop()
            _group(row, first, place)
            place = first
        elif _bracket(row[place]) in PAIRS:
            opened.append(place)
        place += 1


def _group(row: ET.Element, first: int, last: int) -> None:
    """Put a pair of brackets and its content into a row of its own."""
    inner = row[first : last + 1]
    tall = str(any(map(_is_tall, inner[1:-1]))).lower()
    for fence, form in ((inner[0], "prefix"), (inner[-1], "postfix")):
        bracket = fence if fence.tag == "mo" else fence[0]
        for name, value in (("stretchy", tall), ("fence", "true"), ("form", form)):
            bracket.set(name, value)
    row[first : last + 1] = [_element("mrow", *inner)]


def _bracket(element: ET.Element, *, closing: bool = False) -> str:
    """Bracket of an element, for closing ones also with index or exponent; empty for other elements."""
    if closing and element.tag in {"msub", "msup", "msubsup"}:
        element = element[0]
    return (element.text or "") if element.tag == "mo" else ""


def _is_tall(element: ET.Element) -> bool:
    return any(e.tag in TALL and not (e.tag == "mover" and _is_accent(e[-1])) for e in element.iter())


def visit_inline(translator: Any, node: nodes.math) -> None:
    """Write an equation within a line."""
    translator.body.append(mathml(node, block=False))
    raise nodes.SkipNode


def visit_block(translator: Any, node: nodes.math_block) -> None:
    """Write an equation on a line of its own."""
    translator.body.append(translator.starttag(node, "div", CLASS="math"))
    translator.body.append(mathml(node, block=True))
    translator.body.append("</div>")
    raise nodes.SkipNode


def setup(app: Sphinx) -> dict[str, bool]:
    """Register the renderer."""
    app.add_html_math_renderer("mathml", (visit_inline, None), (visit_block, None))
    app.config["html_math_renderer"] = "mathml"
    return {"parallel_read_safe": True, "parallel_write_safe": True}
