"""Drives' end of the protocol: emulated drives for simulations and tests."""

from typing import Any

from cheetah import codec as c
from drivers.frame_pointers import begin_sent, code, value, whole
from drivers.protocol import STRANGE
from plant_fmu.drives import motors as drives


@drives.obeying
def obey(d: Any, leg: int, frame: Any, messages: int) -> int:
    """Execute a command frame; the drive answers every command."""
    if frame.flags & STRANGE:
        return 0
    if frame.length != 8:
        return drives.rejects(leg, messages)
    data, count = frame.data, 0
    is_special = whole(data, 0, 7) == (1 << 56) - 1
    if is_special and data[7] == c.ENABLE[7]:
        if not d.enabled[leg]:
            count = drives.configures(d, leg, d.watchdog_ns, messages, 0)
            count = drives.enables(d, leg, 0.0, messages, count)
    elif is_special and data[7] == c.DISABLE[7]:
        count = drives.commands(d, leg, drives.OFF, 0.0, messages, 0)
        count = drives.configures(d, leg, d.watchdog_ns, messages, count)
    elif d.enabled[leg]:
        number, end = (int(data[6]) & 0xF) << 8 | int(data[7]), drives.ear_at(d.ear).torque
        count = drives.commands(d, leg, drives.RUN, value(number, -end, end, 12), messages, 0)
    return drives.answers(leg, messages, count)


@drives.encoding
def encode(d: Any, said: Any, frame: Any) -> int:
    """Fill the frame of an answer; a lost encoder reports the lower end of the position range."""
    ear, data = drives.ear_at(d.ear), frame.data
    begin_sent(frame, c.ANSWER_ID, 6, 0, d.bus_of[said.leg])
    position = -ear.position if said.lost else said.turns * c.TURN
    p = code(position, -ear.position, ear.position, 16)
    v = code(said.speed * c.TURN, -ear.velocity, ear.velocity, 12)
    t = code(said.torque, -ear.torque, ear.torque, 12)
    data[0], data[1], data[2] = d.nodes[said.leg], p >> 8, p & 0xFF
    data[3], data[4], data[5] = v >> 4, (v & 0xF) << 4 | t >> 8, t & 0xFF
    return 0


class CheetahDrives(drives.MotorDrives):
    """Drives' end for six motors."""

    obey, encode = obey, encode
