"""The messages of legs.dbc that a run uses: those of its layout, their forces in newtons.

The short force fields, of the classic command and the fd feedback, count in per cent of the drives' rated
force. That is said once, in `drives.force_limit_N`; both ends, the log's copy of the DBC and the checksum of
a drive's set-up take it from there.
"""

import re
from typing import NamedTuple

from drivers.errors import ConfigurationError
from drivers.legs.codec import Codec, Layout, compile_message, layout_of, parsed, read_dbc
from drivers.legs.crc import crc16, identifier_state
from drivers.signals import LEGS

COMMANDS = {
    "classic": ("COMMAND_CLASSIC_A", "COMMAND_CLASSIC_B"),
    "fd": ("COMMAND_FD",),
    "ideal": ("COMMAND_IDEAL",),
}
SHORT_COMMANDS = {
    "classic": ("COMMAND_CLASSIC_A",),
    "fd": ("COMMAND_FD_SHORT",),
    "ideal": ("COMMAND_IDEAL",),
}
"""Of a bus with SHORT legs or fewer."""
SHORT = 3
LAYOUTS = tuple(COMMANDS)
RATED_N = 0.001, 4294967.295
"""Least and largest rated force that the checksum of a set-up can carry, N."""
_SHARE = re.compile(r'\(([\d.]+),0\) \[(-[\d.]+)\|([\d.]+)\] "%"')


class CommandFrame(NamedTuple):
    """One command frame of the layout."""

    layout: Layout
    legs: tuple[int, ...]
    register: int
    """Of its check, after the identifier."""


class Messages(NamedTuple):
    """The messages of one layout."""

    text: str
    """legs.dbc with these forces in N."""
    version: int
    """Of the protocol."""
    estop: Codec
    sync: Codec
    config: Codec
    status: Codec
    feedback: Layout
    commands: tuple[CommandFrame, ...]
    command_ids: tuple[int, ...]
    """Of the commands of all layouts."""


def read_messages(layout: str, rated_force_N: float, places: int = LEGS) -> Messages:
    """Return the messages of a layout for drives of a rated force; commands with room for `places` forces.

    Raises ConfigurationError if the checksum of a set-up cannot carry that.
    """
    if not RATED_N[0] <= rated_force_N <= RATED_N[1]:
        raise ConfigurationError(
            f"drives.force_limit_N: out of range for protocol legs, allowed: {RATED_N[0]:g} to "
            f"{RATED_N[1]:.12g}, given: {rated_force_N:g}"
        )
    text = read_dbc("drivers.legs", "legs.dbc")
    database = parsed(text)
    get = database.get_message_by_name
    quantities = ("Length", "Rate") if layout == "classic" else ("Length", "Rate", "Force")
    feedback = layout_of(
        get(f"FEEDBACK_{layout.upper()}_1"), *quantities, "Counter", "State", "Invalid", "CRC"
    )
    trailer = ("Mode", "Counter", "CRC") if layout == "classic" else ("Counter", "Mode", "CRC")
    commands: list[CommandFrame] = []
    names = (SHORT_COMMANDS if places <= SHORT else COMMANDS)[layout]
    for name in names:
        share = sum(signal.name.startswith("Force") for signal in get(name).signals)
        addressed = tuple(range(len(commands) * share, (len(commands) + 1) * share))
        of = layout_of(get(name), *(f"Force{leg + 1}" for leg in addressed), *trailer)
        wide = of.place("CRC").size == 16
        register = crc16(of.id.to_bytes(2, "little")) if wide else identifier_state(of.id)
        commands.append(CommandFrame(_in_newtons(of, rated_force_N), addressed, register))
    return Messages(
        text=_text_in_newtons(text, rated_force_N),
        version=int((database.version or "").partition(".")[0]),
        estop=compile_message(get("ESTOP"), "Source"),
        sync=compile_message(get("SYNC"), "Cycle", "CRC"),
        config=compile_message(get("CONFIG_1"), "Watchdog", "Reaction", "Leg", "Version", "CRC"),
        status=compile_message(get("STATUS_1"), "State", "Fault", "SetUp", "CRC"),
        feedback=_in_newtons(feedback, rated_force_N),
        commands=tuple(commands),
        command_ids=tuple(
            dict.fromkeys(
                get(name).frame_id
                for layouts in (COMMANDS, SHORT_COMMANDS)
                for names in layouts.values()
                for name in names
            )
        ),
    )


def _in_newtons(of: Layout, rated_force_N: float) -> Layout:
    units = [rated_force_N / 100.0 if unit == "%" else 1.0 for unit in of.units]

    def times(values: tuple[float, ...]) -> tuple[float, ...]:
        return tuple(value * unit for value, unit in zip(values, units, strict=True))

    return of._replace(scale=times(of.scale), low=times(of.low), high=times(of.high))


def _text_in_newtons(text: str, rated_force_N: float) -> str:
    def newtons(found: re.Match[str]) -> str:
        scale, low, high = (float(number) * (rated_force_N / 100.0) for number in found.groups())
        return f'({scale!r},0) [{low!r}|{high!r}] "N"'

    return _SHARE.sub(newtons, text)


def set_up_checksum(identifier: int, config: bytes, rated_force_N: float) -> int:
    """Return what a status says of a set-up: of its CONFIG without the CRC and the drive's rated force."""
    rated_mN = round(rated_force_N * 1e3)
    return crc16(identifier.to_bytes(2, "little") + config + rated_mN.to_bytes(4, "little"))
