"""The words of the operator channel: one short line of text each, and what it means.

Pure: no socket, no clock. A line is `[#tag] word [numbers]`; the answer repeats the tag.
"""

import math
from collections.abc import Callable, Sequence
from typing import NamedTuple

from hil.signals import JOG_NAMES, Operator, Order, SetPoint

LONGEST = 512
"""Bytes of a line."""
STATUS = "status"
SETPOINT_FORM = "six numbers, x y z in m and the rotation vector rx ry rz in deg"


class Said(NamedTuple):
    """What a line says: one of the three, or `status`, where all are None."""

    operator: Operator | None = None
    """A command without numbers that the loop knows by itself."""
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


def parse_setpoint(words: Sequence[str]) -> SetPoint:
    """Return the set-point of the words x y z [rx ry rz], m and deg. Raises ValueError with what is wrong."""
    if len(words) not in {3, 6}:
        raise ValueError(f"{len(words)} words; allowed: {SETPOINT_FORM} (or x y z alone)")
    x, y, z, rx, ry, rz = [*_numbers(words, SETPOINT_FORM), 0.0, 0.0, 0.0][:6]
    return SetPoint(x, y, z, math.radians(rx), math.radians(ry), math.radians(rz))


def _setpoint(words: Sequence[str]) -> Said:
    return Said(setpoint=parse_setpoint(words))


def _speed(words: Sequence[str]) -> Said:
    form = "one number of percent, 0 .. 100"
    if len(words) != 1:
        raise ValueError(f"speed: {len(words)} words; allowed: {form}")
    (percent,) = _numbers([words[0].removesuffix("%")], form)
    if not 0.0 <= percent <= 100.0:
        raise ValueError(f"speed: {percent:g} %; allowed: 0 .. 100: no path goes faster than it was checked")
    return Said(order=Order(Operator.SPEED, (percent / 100.0,)))


def _jog(words: Sequence[str]) -> Said:
    form = "an axis or leg and a fraction of the set-up speed, -1 .. 1, as `jog x 0.5`"
    if len(words) != 2:
        raise ValueError(f"jog: {len(words)} words; allowed: {form}")
    if words[0] not in JOG_NAMES:
        raise ValueError(f"jog: {words[0][:40]!r} is no axis and no leg; allowed: {', '.join(JOG_NAMES)}")
    (fraction,) = _numbers(words[1:], form)
    if not -1.0 <= fraction <= 1.0:
        raise ValueError(f"jog: {fraction:g}; allowed: -1 .. 1 of the set-up speed")
    return Said(order=Order(Operator.JOG, (float(JOG_NAMES.index(words[0])), fraction)))


def _alone(name: str, said: Said) -> Callable[[Sequence[str]], Said]:
    def parse(words: Sequence[str]) -> Said:
        if words:
            raise ValueError(f"{name}: takes no further words, given: {' '.join(words)!r}")
        return said

    return parse


_PLAIN = {
    "arm": Operator.ENGAGE,
    "stop": Operator.STOP,
    "reset": Operator.RESET,
    "estop": Operator.ESTOP,
    "release": Operator.RELEASE,
    "end": Operator.END,
}
_ORDERS = {"start": Operator.START, "hold": Operator.HOLD, "park": Operator.PARK, "key": Operator.KEY}
WORDS: dict[str, Callable[[Sequence[str]], Said]] = {
    **{name: _alone(name, Said(operator=operator)) for name, operator in _PLAIN.items()},
    **{name: _alone(name, Said(order=Order(operator))) for name, operator in _ORDERS.items()},
    "speed": _speed,
    "jog": _jog,
    "setpoint": _setpoint,
    STATUS: _alone(STATUS, Said()),
}
"""Word -> what reads the words after it."""


def split(line: str) -> tuple[str, str]:
    """Return the tag of a line, with a space behind it, and the rest; without a tag it is empty."""
    if not line.startswith("#"):
        return "", line
    tag, _, rest = line.partition(" ")
    return f"{tag[:16]} ", rest


def parse(text: str) -> Said:
    """Return what a line without its tag says. Raises ValueError with what is wrong and what is allowed."""
    if len(text) > LONGEST:  # what has been cut off could change what it means
        raise ValueError(f"longer than {LONGEST} bytes")
    words = text.replace(",", " ").split()
    if not words or words[0] not in WORDS:
        given = words[0][:40] if words else ""
        raise ValueError(f"{given!r} is no word of the operator; allowed: {', '.join(WORDS)}")
    return WORDS[words[0]](words[1:])
