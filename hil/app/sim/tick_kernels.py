"""Compiled simulation ticks of both ends of the buses: as many as need no work in Python."""

from typing import Any

import numpy as np

from drivers.compiled.compiler import helper, kernel, record
from drivers.compiled.pointed import record_at
from drivers.frame_pointers import frames_at
from hil.app.sim import wire_kernels
from hil.app.sim.wire_kernels import WIRES
from hil.loop import tick_row as part
from plant_fmu.drives.compiled_pass import NODES_RECORD, live

HEAR, PASS, SYNC, LIVE, ANSWER = range(part.START + 1, part.OBSERVE)
"""Stages of a tick: drives that send unrequested frames receive earlier ones; their frames are queued; SYNC
or polls are sent; the drives receive them and the plant moves; their answers arrive.

Each stops with the status of its kernel, HEAR and LIVE also where the drives run in Python.
"""
LOCKSTEP = np.dtype(
    [
        *part.ROW_OF_TICKS,
        *((name, "<i8") for name in ("wires", "nodes", "period_ns", "window_ns", "compute_ns", "unasked")),
        *((name, "<i8") for name in ("tick", "replies", "replied", "early", "bus_off", "bus_state")),
    ]
)
"""Both ends of the buses, and a row of ticks.

Addresses of the records WIRES and NODES (0 where the drives run in Python). Times in ns. `unasked`: the
drives send unrequested frames. `tick`: its number. `replies`, `replied`: address and number of the drives'
frames. `early`: frames received before the tick. `bus_off`, `bus_state`: state of the buses.
"""
_wires_at, _nodes_at = record_at(record(WIRES)), record_at(NODES_RECORD)


@helper
def _lives(s: Any, until_ns: int, heard: int) -> int:
    """Advance the drives to an instant, with the first `heard` frames received; return the status."""
    if s.nodes == 0:
        return 1
    nodes, wires = _nodes_at(s.nodes), _wires_at(s.wires)
    status = int(live(nodes, frames_at(wires.commands_at, heard), until_ns, False))
    s.replies, s.replied = nodes.out, nodes.sent
    return status


@helper
def _observes(s: Any, wires: Any, t_ns: int) -> int:
    s.heard_at, s.heard = wires.late_at, wires.taken
    if not part.has_room(s):
        return part.NO_ROOM
    tick = part.begin_tick(s)
    tick.tick, tick.t_ns, tick.sync_skew_ns = s.tick, t_ns, wires.skew_ns
    tick.bus_off, tick.bus_state = s.bus_off, s.bus_state
    tick.latch_ns[:] = wires.latch_ns
    return part.observe(s, tick)


@helper
def _commands(s: Any, wires: Any, t_ns: int) -> int:
    frames = frames_at(s.frames + s.used * part.BYTES, s.sent)
    status = int(wire_kernels.command(wires, frames, wires.step_ns + s.compute_ns, t_ns + s.period_ns - 1))
    if status == 0:
        part.end_tick(s)
        s.tick += 1
    return status


@helper
def _go_through(s: Any) -> int:
    """Run one stage of the tick; return 0, or the reason to stop."""
    t_ns, stage, wires = s.tick * s.period_ns, s.stage, _wires_at(s.wires)
    deadline_ns = t_ns + s.window_ns
    if stage == part.START:
        return part.start(s, s.tick)
    if stage in (HEAR, PASS) and not s.unasked:
        return 0
    if stage == HEAR:
        s.early = wire_kernels.heard_by(wires, t_ns)
        return _lives(s, t_ns, s.early)
    if stage == PASS:
        return int(wire_kernels.pass_on(wires, frames_at(s.replies, s.replied), t_ns, s.early))
    if stage == SYNC:
        return int(wire_kernels.begin(wires, frames_at(s.starts, s.begins), t_ns, deadline_ns))
    if stage == LIVE:
        return _lives(s, wires.synced_ns, wires.commands)
    if stage == ANSWER:
        return int(wire_kernels.answer(wires, frames_at(s.replies, s.replied), s.tick, t_ns, deadline_ns))
    if stage == part.OBSERVE:
        return _observes(s, wires, t_ns)
    return part.act(s) if stage == part.ACT else _commands(s, wires, t_ns)


@kernel(record(LOCKSTEP), unlocked=True)
def advance(s: Any) -> int:
    """Simulate until `count` ticks are done; return 0, or the reason to stop earlier, within a stage."""
    while s.done < s.count:
        status = _go_through(s)
        if status != 0:
            return status
        s.stage = (s.stage + 1) % (part.COMMAND + 1)
    return 0
