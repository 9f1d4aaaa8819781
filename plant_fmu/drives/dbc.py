"""Emulated drives by the mapping of a DBC."""

from typing import Any

import numpy as np

from drivers import dbc as o
from drivers.compiled.compiler import helper
from drivers.compiled.pointed import address_of
from drivers.frame_array import FRAME
from drivers.frame_pointers import begin_sent, frame_at
from drivers.protocol import ERROR, EXTENDED, FD, REMOTE
from drivers.sensing.kernels import put_field, put_real, real_of, rows_at, selected
from drivers.signals import DriveFault
from plant_fmu.drives import motors as drives

_FRAME = FRAME.itemsize


@drives.obeying
def obey(d: Any, leg: int, frame: Any, messages: int) -> int:
    """Execute a command, or answer the poll; result: see `plant_fmu.drives.motors`."""
    table = o.table_at(drives.ear_at(d.ear).table)
    row, data = rows_at(table.rows, table.size)[o.COMMAND], frame.data
    if frame.flags & (FD | REMOTE | ERROR) or frame.flags & EXTENDED != row.flags:
        return 0
    kind, cycles = o.kind_of(table, frame, d.nodes[leg]), table.frames[o.ENABLE, 2] >= 0
    if kind == o.POLL:
        return drives.answers(leg, messages, 0)
    if kind == o.DISABLE:
        count = drives.commands(d, leg, drives.OFF, 0.0, messages, 0)
        return drives.configures(d, leg, d.watchdog_ns, messages, count)
    if kind == o.CLEAR:
        return drives.commands(d, leg, drives.RESET, 0.0, messages, 0)
    if kind == o.ENABLE:
        count = drives.configures(d, leg, d.watchdog_ns, messages, 0)
        return count if d.enabled[leg] else drives.enables(d, leg, 0.0, messages, count)
    if frame.id != row.id + d.nodes[leg]:
        return 0
    if frame.length != row.length or not selected(row, data)[0]:
        return drives.rejects(leg, messages)
    torque = real_of(row, 0, data, np.zeros(1, np.int64)) * row.scale[0] + row.offset[0]
    if not np.isfinite(torque):
        return drives.rejects(leg, messages)
    if d.enabled[leg]:
        return drives.commands(d, leg, drives.RUN, torque, messages, 0)
    if cycles:
        return 0
    count = drives.configures(d, leg, d.watchdog_ns, messages, 0)
    return drives.enables(d, leg, torque, messages, count)


@helper
def _fill(row: Any, said: Any, data: Any) -> None:
    for c in range(row.conditions):
        put_field(row.equals[c], data, row.at[c], row.wide[c], row.from_top[c])
    for k in range(row.fields):
        to = row.to[k]
        if to == o.POSITION:
            put_real(row, k, 0.0 if said.lost else said.turns, data)
        elif to == o.VELOCITY:
            put_real(row, k, 0.0 if said.lost else said.speed, data)
        elif to == o.TORQUE:
            put_real(row, k, said.torque, data)
        else:
            number = said.code if to == o.FAULT else said.runs
            put_field(number, data, row.start[k], row.bits[k], row.big[k])


@drives.encoding
def encode(d: Any, said: Any, frame: Any) -> int:
    """Fill in the messages of one drive; a lost encoder repeats position 0."""
    table, leg = o.table_at(drives.ear_at(d.ear).table), said.leg
    rows, at = rows_at(table.rows, table.size), address_of(frame)
    for k in range(o.ANSWER, table.size):
        into, row = frame_at(at + (k - o.ANSWER) * _FRAME), rows[k]
        begin_sent(into, row.id + d.nodes[leg], row.length, row.flags, d.bus_of[leg])
        _fill(row, said, into.data)
    return int(table.size - o.ANSWER - 1)


class DbcDrives(drives.MotorDrives):
    """The drives' end of six drives by the mapping of a DBC."""

    obey, encode = obey, encode
    codes = {DriveFault.OVERFORCE: 1}
    otherwise = 1
