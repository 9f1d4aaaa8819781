"""Emulated drives by the mapping of a DBC."""

from typing import Any

import numpy as np

from drivers import dbc as o
from drivers.frame_pointers import begin_sent
from drivers.protocol import ERROR, EXTENDED, FD, REMOTE
from drivers.sensing.kernels import put_field, put_real, real_of, rows_at, selected
from drivers.signals import DriveFault
from plant_fmu.drives import motors as drives


@drives.obeying
def obey(d: Any, leg: int, frame: Any, messages: int) -> int:
    """Execute a command, or answer the poll; result: see `plant_fmu.drives.motors`."""
    table = o.table_at(drives.ear_at(d.ear).table)
    row, data = rows_at(table.rows, 2)[o.COMMAND], frame.data
    if frame.flags & (FD | REMOTE | ERROR) or frame.flags & EXTENDED != row.flags:
        return 0
    if frame.length != row.length:
        return drives.rejects(leg, messages)
    if o.is_frame(data, table.poll):
        return drives.answers(leg, messages, 0)
    if o.is_frame(data, table.disable):
        count = drives.commands(d, leg, drives.OFF, 0.0, messages, 0)
        return drives.configures(d, leg, d.watchdog_ns, messages, count)
    if table.clear and o.is_frame(data, table.clear):
        return drives.commands(d, leg, drives.RESET, 0.0, messages, 0)
    if table.cycles and o.is_frame(data, table.enable):
        count = drives.configures(d, leg, d.watchdog_ns, messages, 0)
        return count if d.enabled[leg] else drives.enables(d, leg, 0.0, messages, count)
    if not selected(row, data)[0]:
        return drives.rejects(leg, messages)
    torque = real_of(row, 0, data, np.zeros(1, np.int64)) * row.scale[0] + row.offset[0]
    if not np.isfinite(torque):
        return drives.rejects(leg, messages)
    if d.enabled[leg]:
        return drives.commands(d, leg, drives.RUN, torque, messages, 0)
    if table.cycles:
        return 0
    count = drives.configures(d, leg, d.watchdog_ns, messages, 0)
    return drives.enables(d, leg, torque, messages, count)


@drives.encoding
def encode(d: Any, said: Any, frame: Any) -> int:
    """Fill in the answer of one drive; a lost encoder repeats position 0."""
    ear = drives.ear_at(d.ear)
    row = rows_at(o.table_at(ear.table).rows, 2)[o.ANSWER]
    begin_sent(frame, ear.replies[said.leg], row.length, row.flags, d.bus_of[said.leg])
    for c in range(row.conditions):
        put_field(row.equals[c], frame.data, row.at[c], row.wide[c], row.from_top[c])
    for k in range(row.fields):
        to = row.to[k]
        if to == o.POSITION:
            put_real(row, k, 0.0 if said.lost else said.turns, frame.data)
        elif to == o.VELOCITY:
            put_real(row, k, 0.0 if said.lost else said.speed, frame.data)
        elif to == o.TORQUE:
            put_real(row, k, said.torque, frame.data)
        else:
            number = said.code if to == o.FAULT else said.runs
            put_field(number, frame.data, row.start[k], row.bits[k], row.big[k])
    return 0


class DbcDrives(drives.MotorDrives):
    """The drives' end of six drives by the mapping of a DBC."""

    obey, encode = obey, encode
    codes = {DriveFault.OVERFORCE: 1}
    otherwise = 1
