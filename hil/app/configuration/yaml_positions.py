"""YAML text as plain data, with the line and column of every key and value.

Scalars follow the core schema of YAML 1.2 (https://yaml.org/spec/1.2.2/#103-core-schema), not PyYAML's YAML
1.1: ``1e3`` is a number, ``010`` is ten, ``no`` and ``12:30`` are text. Features that PyYAML accepts silently
but a reader does not expect (two equal keys, aliases, tags) are problems.
"""

import copy
import functools
import re
from collections.abc import Callable, Iterable
from contextlib import suppress
from typing import Any, NamedTuple

import yaml

Path = tuple[str | int, ...]
"""Keys and indices from the root to a value."""

MOST_VALUES = 200_000
"""Most keys, values, lists and mappings in a text; the longest path of way-points has 130,000."""

Value = None | bool | int | float | str | list["Value"] | dict[str, "Value"]


class Position(NamedTuple):
    """Position in a YAML text; line and column count from one."""

    line: int
    column: int


class Problem(NamedTuple):
    """Problem at one position of a YAML text."""

    position: Position
    path: Path
    message: str

    def line(self, source: str) -> str:
        """The problem as text, `file:line:column: path: message`."""
        place = f"{source}:{self.position.line}:{self.position.column}: "
        return f"{place}{path_text(self.path)}: {self.message}" if self.path else place + self.message


def lines(problems: Iterable[Problem], source: str) -> list[str]:
    """Text line of each problem, without duplicates, in the order of the YAML text."""
    return [p.line(source) for p in sorted(set(problems), key=lambda p: (p.position, p.message))]


class Document(NamedTuple):
    """A parsed YAML text. `value` is None if the text has no usable root."""

    value: dict[str, Value] | None
    keys: dict[Path, Position]
    """Position of the key (or list item) at each path."""
    values: dict[Path, Position]
    """Position of the value at each path."""
    problems: tuple[Problem, ...]

    def key_position(self, path: Path) -> Position:
        """Position of the key at `path`, or of its nearest ancestor in the text."""
        while path and path not in self.keys:
            path = path[:-1]
        return self.keys.get(path, Position(1, 1))

    def value_position(self, path: Path) -> Position:
        """Position of the value at `path`, or of the key of its nearest ancestor in the text."""
        return self.values[path] if path in self.values else self.key_position(path)

    def at(self, path: Path) -> Value:
        """Value at `path`, which must be in the text."""
        value: Any = self.value
        for item in path:
            value = value[item]
        return value  # type: ignore[no-any-return]


def path_text(path: Path) -> str:
    """Key path as text: `platform.base_joints_m[2]` for ("platform", "base_joints_m", 2)."""
    text = ""
    for item in path:
        text += f"[{item}]" if isinstance(item, int) else f".{item}" if text else item
    return text


def parse(text: str) -> Document:
    """Parse one YAML document whose root is a mapping; the result includes all problems."""
    document = _parsed(text)
    return document._replace(value=copy.deepcopy(document.value))


@functools.lru_cache(maxsize=32)
def _parsed(text: str) -> Document:
    """Parse a text once: a run, its replay and `hil compare` read the same text several times."""
    try:
        loader = _Loader(text)
        try:
            root = loader.get_single_node()
        finally:
            loader.dispose()  # breaks PyYAML's reference cycles
    except yaml.MarkedYAMLError as error:
        return _unread(*_syntax_problem(error))
    except yaml.reader.ReaderError as error:
        before = text[: error.position]
        position = Position(before.count("\n") + 1, len(before) - before.rfind("\n"))
        return _unread(f"character U+{ord(text[error.position]):04X} is not allowed in YAML", position)
    except RecursionError:
        return _unread("nested too deeply")
    if root is None:
        return _unread("the file is empty")
    if not isinstance(root, yaml.MappingNode):
        return _unread("expected sections (`platform:`, `bus:`, ...) at the top of the file", _position(root))
    walk = _Walk()
    value = walk.mapping(root, ())
    return Document(value, walk.keys, walk.values, tuple(walk.problems))


def _unread(message: str, at: tuple[int, int] = (1, 1)) -> Document:
    return Document(None, {}, {}, (Problem(Position(*at), (), message),))


class _Loader(yaml.BaseLoader):
    """PyYAML up to its node tree; we resolve and construct ourselves."""

    composed = 0

    def compose_node(self, parent: yaml.Node | None, index: int) -> yaml.Node | None:
        self.composed += 1
        event = self.peek_event()  # type: ignore[no-untyped-call]
        if self.composed <= MOST_VALUES and not isinstance(event, yaml.AliasEvent):
            return super().compose_node(parent, index)
        message = f"allowed: {MOST_VALUES} values in a file"
        if isinstance(event, yaml.AliasEvent):
            message = f"alias *{event.anchor} is not supported: write the value out"
        raise yaml.composer.ComposerError(None, None, message, event.start_mark)


class _Walk:
    """Turns nodes into values. Mutable state: the tables that it fills."""

    def __init__(self) -> None:
        self.keys: dict[Path, Position] = {}
        self.values: dict[Path, Position] = {}
        self.problems: list[Problem] = []

    def problem(self, node: yaml.Node, path: Path, message: str) -> None:
        self.problems.append(Problem(_position(node), path, message))

    def value(self, node: yaml.Node, path: Path) -> Value:
        self.values[path] = _position(node)
        if node.tag not in _TAGS:
            self.problem(node, path, f"tag {node.tag} is not supported: remove it")
        if isinstance(node, yaml.MappingNode):
            return self.mapping(node, path)
        if isinstance(node, yaml.SequenceNode):
            items: list[Value] = []
            for index, item in enumerate(node.value):
                self.keys[(*path, index)] = _position(item)
                items.append(self.value(item, (*path, index)))
            return items
        assert isinstance(node, yaml.ScalarNode)
        return self._scalar(node, path)

    def mapping(self, node: yaml.MappingNode, path: Path) -> dict[str, Value]:
        result: dict[str, Value] = {}
        for key_node, value_node in node.value:
            if not isinstance(key_node, yaml.ScalarNode):
                self.problem(key_node, path, "a key must be a plain word")
                continue
            key: str = key_node.value
            here = (*path, key)
            if key in result:
                first = self.keys[here].line
                self.problem(key_node, here, f"key given twice, first in line {first}: remove one of them")
            elif key == "<<" and key_node.style is None:
                self.problem(key_node, here, "merging (<<) is not supported: write the keys out")
            else:
                self.keys[here] = _position(key_node)
                result[key] = self.value(value_node, here)
        return result

    def _scalar(self, node: yaml.ScalarNode, path: Path) -> Value:
        text: str = node.value
        if found := _NO_TEXT.search(text):
            self.problem(node, path, f"character U+{ord(found[0]):04X} is not allowed, not even escaped")
            return None
        if node.style is not None or node.tag == "!":
            return text
        for pattern, convert in _SCALARS:
            if pattern.fullmatch(text):
                with suppress(ValueError, OverflowError):  # too many digits for a number
                    return convert(text)
        return text


_TAGS = {"!", *(f"tag:yaml.org,2002:{kind}" for kind in ("map", "seq", "str"))}
_NO_TEXT = re.compile("[\0\ud800-\udfff]")
"""Characters that neither file names nor UTF-8 can hold; escapes in quotes can produce them."""


def _integer(text: str, base: int = 10) -> int:
    """Integer of a text. Raises OverflowError beyond the largest float, whose digits Python cannot print."""
    number = int(text, base)
    float(number)
    return number


def _integral(text: str) -> int | float:
    """Number of a text; an integer if whole and without a point, so that 1e6 equals 1000000."""
    number = float(text)
    return int(number) if number.is_integer() and abs(number) < 2**53 and "." not in text else number


_SCALARS: tuple[tuple[re.Pattern[str], Callable[[str], Value]], ...] = (
    (re.compile(r"null|Null|NULL|~|"), lambda _: None),
    (re.compile(r"true|True|TRUE"), lambda _: True),
    (re.compile(r"false|False|FALSE"), lambda _: False),
    (re.compile(r"[-+]?[0-9]+"), _integer),
    (re.compile(r"0o[0-7]+"), lambda text: _integer(text, 8)),
    (re.compile(r"0x[0-9a-fA-F]+"), lambda text: _integer(text, 16)),
    (re.compile(r"[-+]?(\.[0-9]+|[0-9]+(\.[0-9]*)?)([eE][-+]?[0-9]+)?"), _integral),
    (re.compile(r"[-+]?\.(inf|Inf|INF)"), lambda text: float(text.replace(".", ""))),
    (re.compile(r"\.(nan|NaN|NAN)"), lambda _: float("nan")),
)


def _position(node: yaml.Node) -> Position:
    return Position(node.start_mark.line + 1, node.start_mark.column + 1)


def _syntax_problem(error: yaml.MarkedYAMLError) -> tuple[str, Position]:
    mark = error.problem_mark or error.context_mark
    message = error.problem or "not YAML"
    if "'\\t'" in message:
        message = "tab: YAML indents with spaces only"
    elif "expected a single document" in str(error.context):
        message = "a second document (`---`) is not allowed: one file is one configuration"
    elif error.context:
        message = f"not YAML: {error.context}, {message}"
    elif not message.startswith(("alias", "allowed")):
        message = f"not YAML: {message}"
    return message, Position(mark.line + 1, mark.column + 1) if mark else Position(1, 1)
