"""The commands of the operator channel: one short line of text each, and its meaning.

No socket, no clock. A line is `[#tag] word [numbers]`; the answer repeats the tag.
"""

import math
from collections.abc import Sequence
from typing import NamedTuple

from hil.signals import JOG_NAMES, Operator, Order, SetPoint

LONGEST = 512
"""Largest number of bytes in a line."""
SETPOINT_FORM = "six numbers, x y z in m and the rotation vector rx ry rz in deg"


class ParsedLine(NamedTuple):
    """Meaning of a line: one of the three fields; a `status` line has none of them."""

    operator: Operator | None = None
    """A command without numbers, for the loop."""
    order: Order | None = None
    """A command for the motion."""
    setpoint: SetPoint | None = None


def _numbers(words: Sequence[str], form: str) -> list[float]:
    text = " ".join(words)
    try:
        numbers = [float(word) for word in words]
    except ValueError:
        numbers = []
    if not numbers or not text.isascii() or "_" in text:  # Python reads 1_0 and other scripts' digits
        raise ValueError(f"{text!r} is not {form}")
    if not all(map(math.isfinite, numbers)):
        raise ValueError(f"{text!r} has a number that is not finite")
    return numbers


def _setpoint(words: Sequence[str]) -> ParsedLine:
    if len(words) not in {3, 6}:
        raise ValueError(f"{len(words)} words; allowed: {SETPOINT_FORM} (or x y z alone)")
    x, y, z, rx, ry, rz = [*_numbers(words, SETPOINT_FORM), 0.0, 0.0, 0.0][:6]
    return ParsedLine(setpoint=SetPoint(x, y, z, math.radians(rx), math.radians(ry), math.radians(rz)))


def _speed(words: Sequence[str]) -> ParsedLine:
    form = "one number of percent, 0 .. 100"
    if len(words) != 1:
        raise ValueError(f"speed: {len(words)} words; allowed: {form}")
    (percent,) = _numbers([words[0].removesuffix("%")], form)
    if not 0.0 <= percent <= 100.0:
        raise ValueError(f"speed: {percent:g} %; allowed: 0 .. 100, as the path was checked at 100 %")
    return ParsedLine(order=Order(Operator.SPEED, (percent / 100.0,)))


def _jog(words: Sequence[str]) -> ParsedLine:
    form = "an axis or leg and a fraction of the set-up speed, -1 .. 1, for example `jog x 0.5`"
    if len(words) != 2:
        raise ValueError(f"jog: {len(words)} words; allowed: {form}")
    if words[0] not in JOG_NAMES:
        raise ValueError(f"jog: {words[0][:40]!r} is not an axis or leg; allowed: {', '.join(JOG_NAMES)}")
    (fraction,) = _numbers(words[1:], form)
    if not -1.0 <= fraction <= 1.0:
        raise ValueError(f"jog: {fraction:g}; allowed: -1 .. 1 of the set-up speed")
    return ParsedLine(order=Order(Operator.JOG, (float(JOG_NAMES.index(words[0])), fraction)))


_COMMANDS = {
    "arm": Operator.ENGAGE,
    "stop": Operator.STOP,
    "reset": Operator.RESET,
    "estop": Operator.ESTOP,
    "release": Operator.RELEASE,
    "end": Operator.END,
}
_ORDERS = {"start": Operator.START, "hold": Operator.HOLD, "park": Operator.PARK, "key": Operator.KEY}
_ALONE: dict[str, ParsedLine] = {
    **{name: ParsedLine(operator=operator) for name, operator in _COMMANDS.items()},
    **{name: ParsedLine(order=Order(operator)) for name, operator in _ORDERS.items()},
    "status": ParsedLine(),
}
"""Commands without numbers."""
_NUMBERED = {"speed": _speed, "jog": _jog, "setpoint": _setpoint}
"""Command with numbers -> parser of the words after it."""


def split(line: str) -> tuple[str, str]:
    """(tag with a space after it, rest of the line); the tag is empty if the line has none."""
    if not line.startswith("#"):
        return "", line
    tag, _, rest = line.partition(" ")
    return f"{tag[:16]} ", rest


def parse(text: str) -> ParsedLine:
    """Meaning of a line without its tag. Raises ValueError with the mistake and the allowed values."""
    if len(text) > LONGEST:  # what has been cut off could change what it means
        raise ValueError(f"longer than {LONGEST} bytes")
    word, *rest = text.replace(",", " ").split() or [""]
    if word in _NUMBERED:
        return _NUMBERED[word](rest)
    if word not in _ALONE:
        raise ValueError(
            f"{word[:40]!r} is not an operator command; allowed: {', '.join([*_ALONE, *_NUMBERED])}"
        )
    if rest:
        raise ValueError(f"{word} takes no arguments, given: {' '.join(rest)!r}")
    return _ALONE[word]
