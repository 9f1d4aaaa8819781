"""One tick as one row of the log.

The order is that of `hil.signals.ROW`.
"""

from __future__ import annotations

import struct
import zlib

import numpy as np

from drivers.arrays import Array, Flags, Ints, Rows
from drivers.compiled.compiler import OUT_VECTOR, REAL, VECTOR, direct, helper
from drivers.signals import LEGS, Command, Measurement
from hil.loop.steering import Counts
from hil.signal_types import MEASUREMENT, REFERENCE, STATE
from hil.signals import (
    ROW,
    ROW_FLOATS,
    ROW_INTEGERS,
    Estimate,
    Fault,
    Mode,
    Reference,
    TickInput,
    Verdict,
    Warn,
)

_SIZE = ROW_INTEGERS + ROW_FLOATS
_PER_LEG = ROW_INTEGERS - 3 * LEGS
"""Where the integers of the single legs begin."""
_pack_into = struct.Struct(f"<{_PER_LEG}q").pack_into


def make_row(
    inp: TickInput,
    run: bytes,
    mode: Mode,
    faults: Fault,
    measurement: Measurement,
    estimate: Estimate,
    time: float,
    reference: Reference,
    own: Array,
    command: Command,
    verdict: Verdict,
    setpoints: Counts,
    wrench_sensor: Array,
) -> Rows:
    """Return one element of ROW.

    run: the received frames as `drivers.protocol.run_of` joins them; time: s along the present motion; own
    (6,) N: the law's own forces; wrench_sensor (6,) N, N m: as it last said, base frame.
    """
    state, fusion = estimate.state, estimate.fusion
    warnings = verdict.warnings | Warn.SETPOINT if setpoints.refusal else verdict.warnings
    cells = np.empty(_SIZE)
    _pack_into(
        cells.data, 0,
        inp.tick, inp.t_ns, inp.lateness_ns, inp.skipped, inp.sends_failed,
        inp.bus_errors, inp.bus_off, inp.bus_overflow, inp.recorder_alive, inp.recorder_dropped,
        inp.compute_ns, len(inp.frames), zlib.crc32(run), mode, faults, warnings,
        measurement.rejected, command.mode, state.iterations, *setpoints,
        fusion.used, fusion.lost, fusion.slipped, fusion.tracker,
    )  # fmt: skip
    forces = (own, command.force, fusion.figures, wrench_sensor)
    values = (*measurement, *state, estimate.condition, *reference, *forces)
    _fill(cells, time, *values, *verdict.certificate)
    return np.ndarray((), ROW, cells)


@helper
def _put(values: Array, cells: Array, at: int) -> int:
    """Copy values, of any shape, to `at` and on; return where they end."""
    for value in values.flat:
        cells[at] = value
        at += 1
    return at


@direct(
    OUT_VECTOR, REAL, *MEASUREMENT, *STATE, REAL, *REFERENCE, VECTOR, VECTOR, VECTOR, VECTOR,
    REAL, REAL, REAL, REAL,
)  # fmt: skip
def _fill(
    cells: Array, time: float,
    _length: Array, _rate: Array, force: Array, drive_state: Ints, fault: Ints, age: Ints,
    _rejected: int, _tick: int, _blind: Flags,
    q: Array, dq: Array, p: Array, R: Array, twist: Array, _J: Array, _iterations: int, residual: float,
    wrench: Array, condition: float,
    p_d: Array, R_d: Array, twist_d: Array, dtwist_d: Array, q_d: Array, dq_d: Array, ddq_d: Array, _t: float,
    own: Array, tau: Array, figures: Array, wrench_sensor: Array,
    V: float, dV: float, bound: float, share: float,
) -> None:  # fmt: skip
    """Put what follows the integers of the whole tick into the row."""
    words = cells.view(np.int64)
    for leg in range(LEGS):
        words[_PER_LEG + leg] = drive_state[leg]
        words[_PER_LEG + LEGS + leg] = fault[leg]
        words[_PER_LEG + 2 * LEGS + leg] = age[leg]
    at = _put(force, cells, _put(dq, cells, _put(q, cells, ROW_INTEGERS)))
    at = _put(twist, cells, _put(R, cells, _put(p, cells, at)))
    at = _put(dtwist_d, cells, _put(twist_d, cells, _put(R_d, cells, _put(p_d, cells, at))))
    at = _put(ddq_d, cells, _put(dq_d, cells, _put(q_d, cells, at)))
    at = _put(wrench, cells, _put(tau, cells, _put(own, cells, at)))
    cells[at] = residual
    cells[at + 1] = condition
    cells[at + 2] = time
    at = _put(wrench_sensor, cells, _put(figures, cells, at + 3))
    cells[at] = V
    cells[at + 1] = dV
    cells[at + 2] = bound
    cells[at + 3] = share
