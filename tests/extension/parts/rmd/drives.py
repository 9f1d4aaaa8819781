"""Emulated RMD motors."""

from typing import Any

from drivers.frame_pointers import begin_sent, signed, whole
from drivers.protocol import STRANGE
from plant_fmu.drives import motors as drives
from rmd import codec as c


@drives.obeying
def obey(d: Any, leg: int, frame: Any, messages: int) -> int:
    """Answer STATUS; accept a torque while enabled."""
    if frame.flags & STRANGE:
        return 0
    command, count = int(frame.data[0]), 0
    if frame.length != 8 or command not in (c.STATUS, c.TORQUE, c.SHUTDOWN, c.RELEASE_BRAKE):
        return drives.rejects(leg, messages)
    if command == c.STATUS:
        return drives.answers(leg, messages, 0)
    if command == c.SHUTDOWN:
        count = drives.commands(d, leg, drives.OFF, 0.0, messages, 0)
        return drives.configures(d, leg, d.watchdog_ns, messages, count)
    if command == c.RELEASE_BRAKE:
        if not d.enabled[leg]:
            count = drives.configures(d, leg, d.watchdog_ns, messages, 0)
            count = drives.enables(d, leg, 0.0, messages, count)
    elif d.enabled[leg]:
        torque = signed(whole(frame.data, 4, 2), 16) * drives.ear_at(d.ear).torque / 32768.0
        count = drives.commands(d, leg, drives.RUN, torque, messages, 0)
    return count


@drives.encoding
def encode(d: Any, said: Any, frame: Any) -> int:
    """Fill in current, speed and angle; a lost encoder reads the lower end."""
    end = drives.ear_at(d.ear).torque
    begin_sent(frame, d.nodes[said.leg] + c.ANSWER_ID - c.REQUEST_ID, 8, 0, d.bus_of[said.leg])
    degrees = -32768.0 if said.lost else said.turns / c.DEGREE
    frame.data[0], frame.data[1] = c.STATUS, 25
    for k, value in enumerate((said.torque / end * 32768.0, said.speed / c.DEGREE, degrees)):
        number = int(min(max(value, -32768.0), 32767.0)) & 0xFFFF
        frame.data[2 + 2 * k], frame.data[3 + 2 * k] = number & 0xFF, number >> 8
    return 0


class RmdDrives(drives.MotorDrives):
    """Six motors."""

    obey, encode = obey, encode
