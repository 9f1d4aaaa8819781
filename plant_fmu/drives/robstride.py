"""Emulated RobStride drives: the run mode is their only register."""

import struct
from typing import Any

from drivers.compiled.compiler import helper
from drivers.compiled.pointed import FAILED
from drivers.frame_pointers import begin_sent
from drivers.mit import robstride as k
from drivers.mit.fields import TURN
from drivers.protocol import EXTENDED, Frame
from drivers.signals import Reaction
from plant_fmu.drives import motors as drives
from plant_fmu.drives.codec import CONFIGURE, REJECTED, SYNC
from plant_fmu.drives.mit import CODES, scaled


@drives.obeying
def obey(d: Any, leg: int, frame: Any, messages: int) -> int:
    """Execute a command as MESSAGEs, with an answer of feedback; result: see `plant_fmu.drives.motors`."""
    identifier = int(frame.id)
    kind, count = identifier >> 24, 0
    if not frame.flags & EXTENDED or frame.flags & k.STRANGE:
        return 0
    if kind not in (k.WHO, k.CONTROL, k.ENABLE, k.STOP, k.READ, k.WRITE):
        return 0
    if kind != k.WHO and frame.length != 8:
        return drives.rejects(leg, messages)
    if kind in (k.WHO, k.READ, k.WRITE):
        return FAILED
    if kind == k.ENABLE:
        if not d.enabled[leg]:
            count = drives.configures(d, leg, d.watchdog_ns, messages, 0)
            count = drives.enables(d, leg, 0.0, messages, count)
    elif kind == k.STOP:
        mode = drives.RESET if frame.data[0] == 1 else drives.OFF
        count = drives.commands(d, leg, mode, 0.0, messages, 0)
    elif d.enabled[leg]:
        end = drives.ear_at(d.ear).torque
        torque = (identifier >> 8 & 0xFFFF) * 2.0 * end / 0xFFFF - end
        count = drives.commands(d, leg, drives.RUN, torque, messages, 0)
    return drives.answers(leg, messages, count)


@helper
def _put(data: Any, at: int, number: int) -> None:
    data[at], data[at + 1] = number >> 8, number & 0xFF


@drives.encoding
def encode(d: Any, said: Any, frame: Any) -> int:
    """Fill in a feedback frame; values out of range saturate, a lost encoder reads the lower end."""
    ear, leg = drives.ear_at(d.ear), said.leg
    mode = k.RUNNING if said.runs else k.RESETTING
    identifier = k.FEEDBACK << 24 | mode << 22 | said.code << 16 | d.nodes[leg] << 8 | ear.host
    begin_sent(frame, identifier, 8, EXTENDED, d.bus_of[leg])
    position = -ear.position if said.lost else said.turns * TURN
    _put(frame.data, 0, scaled(position, ear.position, 16, True))
    _put(frame.data, 2, scaled(said.speed * TURN, ear.velocity, 16, True))
    _put(frame.data, 4, scaled(said.torque, ear.torque, 16, True))
    _put(frame.data, 6, 250)
    return 0


class RobStrideDrives(drives.MotorDrives):
    """The drives' end of six RobStride drives."""

    obey, encode = obey, encode
    codes, otherwise = CODES["robstride"], 4

    def request(self, leg: int | None, frame: Frame) -> None:
        """Process a request for serial number or register; feedback answers only the write of a register."""
        identifier, data, _ = frame
        assert leg is not None
        kind, node = identifier >> 24, self.family.nodes[leg]
        if kind == k.WHO:
            self.say(leg, Frame(k.WHO << 24 | node << 8 | k.ASKED_WHO, node.to_bytes(8, "little"), EXTENDED))
            return
        (register, number), held = struct.unpack("<HxxI", data), self.record["registers"]
        if register != k.RUN_MODE:
            self.put(REJECTED)
        elif kind == k.WRITE:
            held[leg, 0] = number
            self.put(CONFIGURE, (leg,), Reaction.BRAKE, round(self.family.delivered_s * 1e9))
            self.put(SYNC, (leg,))
        else:
            said = struct.pack("<HxxI", register, int(held[leg, 0]))
            self.say(leg, Frame(k.READ << 24 | node << 8 | self.family.host, said, EXTENDED))
