"""Communication steps of an FMU in one compiled call: inputs, step, outputs.

Other threads run meanwhile: one of them ends a child process whose FMU hangs.
"""

from typing import Any

import numpy as np

from drivers.arrays import Array, Ints
from drivers.compiled.compiler import (
    INTEGER,
    INTEGERS,
    OUT_INTEGERS,
    OUT_VECTOR,
    REAL,
    foreign,
    helper,
    kernel,
    record,
)
from drivers.compiled.pointed import bytes_at, integers_at, pointed, reals_at
from drivers.signals import LEGS

INSTANCE, COUNTED, SET, GET, STEP, FLAGS, LAST = range(7)
"""Places in `call`: the component; 1 for FMI 3, which counts values; addresses of the functions, of DoStep's
three flags and of its last time;"""
INPUTS, OUTPUTS = 7, 9
"""of the value references and how many they are;"""
SLOTS = 11
"""where force, brake and wrench stand among the inputs, -1 for what the FMU does not have."""
CALL = SLOTS + 3

DONE, NOT_FINITE, INPUTS_REFUSED, STEP_REFUSED, OUTPUTS_REFUSED, INTERRUPTED, OUTPUT_NOT_FINITE = range(7)
"""How an exchange ended."""
CLOSED = 7
"""There was none: the FMU is not initialised."""
MEASURED = 2 * LEGS
"""The first outputs: lengths and rates."""
APPLIED = MEASURED + 18
"""Where the applied forces stand among the outputs, as far as they are known: behind pose and twist."""
FMU = np.dtype(
    [
        *((name, "<i8") for name in ("call", "inputs", "input_count", "held", "outputs", "output_count")),
        *((name, "<i8") for name in ("flags", "ready", "ticks", "known", "status")),
        ("step_s", "<f8"),
    ]
)
"""One FMU: addresses of `call`, of inputs, of the bits that the FMU holds of them, of outputs and DoStep's
flags; whether it is initialised, internal steps since then, whether the applied forces are known; the FMU's
last status; s, its internal step."""
_WARNING = 1
"""The worst status of both standards that still is a success."""
_TERMINATED, _EARLY = 1, 2


@helper
def succeeded(status: int) -> bool:
    """Tell whether a status of either standard is a success: no number that neither has."""
    return 0 <= status <= _WARNING


@helper
def _transfer(call: Ints, function: int, references: int, values: Array) -> int:
    where, count = call[references], call[references + 1]
    if call[COUNTED]:
        arguments = (call[INSTANCE], where, count, np.int64(values.ctypes.data), np.int64(values.size))
        return int(foreign(call[function], arguments))
    return int(foreign(call[function], (call[INSTANCE], where, count, np.int64(values.ctypes.data))))


@kernel(INTEGERS, OUT_VECTOR, OUT_INTEGERS, unlocked=True)
def put(call: Ints, inputs: Array, held: Ints) -> int:
    """Set the FMU's inputs; return its status. `held` becomes their bits, or something else if it refuses."""
    bits = inputs.view(np.int64)
    held[:] = ~bits
    status = _transfer(call, SET, INPUTS, inputs)
    if succeeded(status):
        held[:] = bits
    return status


@kernel(INTEGERS, OUT_VECTOR, unlocked=True)
def fetch(call: Ints, outputs: Array) -> tuple[int, int]:
    """Get the FMU's outputs; return how that ended and the FMU's status.

    Lengths and rates have to be finite.
    """
    status = _transfer(call, GET, OUTPUTS, outputs)
    if not succeeded(status):
        return OUTPUTS_REFUSED, status
    for y in outputs[:MEASURED]:
        if not np.isfinite(y):
            return OUTPUT_NOT_FINITE, status
    return DONE, status


@kernel(INTEGERS, REAL, REAL, unlocked=True)
def do_step(call: Ints, t_s: float, dt_s: float) -> int:
    """Step from `t_s` by `dt_s` and return the FMU's status."""
    never_back, at = np.int32(1), call[FLAGS]
    if call[COUNTED]:
        arguments = (call[INSTANCE], t_s, dt_s, never_back, at, at + 1, at + 2, call[LAST])
        return int(foreign(call[STEP], arguments))
    return int(foreign(call[STEP], (call[INSTANCE], t_s, dt_s, never_back)))


@pointed(record(FMU), INTEGER, INTEGER, INTEGER, INTEGER, INTEGER)
def move(fmu: Any, force: int, brake: int, wrench: int, steps: int, measured: int) -> int:
    """Set what changed of the inputs, go some internal steps, and fill lengths and rates `measured` (12,).

    force, brake, wrench (6,) and `measured` are addresses. Returns how the exchange ended. The communication
    time is a multiple of the internal step, not a sum.
    """
    if not fmu.ready:
        return CLOSED
    call, inputs = integers_at(fmu.call, CALL), reals_at(fmu.inputs, fmu.input_count)
    held, outputs = integers_at(fmu.held, fmu.input_count), reals_at(fmu.outputs, fmu.output_count)
    for n, given in enumerate((force, brake, wrench)):
        if call[SLOTS + n] >= 0:
            inputs[call[SLOTS + n] : call[SLOTS + n] + LEGS] = reals_at(given, LEGS)
    bits = inputs.view(np.int64)
    changed = False
    for i in range(bits.size):
        changed = changed or bits[i] != held[i]
    fmu.status = 0
    if changed:  # an FMU holds its inputs until they are set again
        for u in inputs:
            if not np.isfinite(u):
                return NOT_FINITE
        fmu.status = put(call, inputs, held)
        if not succeeded(fmu.status):
            return INPUTS_REFUSED
    fmu.status = do_step(call, fmu.ticks * fmu.step_s, steps * fmu.step_s)
    if not succeeded(fmu.status):
        return STEP_REFUSED
    flags = bytes_at(fmu.flags, 3)
    if flags[_TERMINATED] or flags[_EARLY]:
        return INTERRUPTED
    ended, fmu.status = fetch(call, outputs)
    fmu.ticks += steps
    if ended == DONE:
        reals_at(measured, MEASURED)[:] = outputs[:MEASURED]
    return int(ended)


@pointed(record(FMU), INTEGER)
def applied(fmu: Any, force: int) -> int:
    """Fill in the applied forces (6,) N at an address; return 1, or 0 where they are not known."""
    if not fmu.known:
        return 0
    reals_at(force, LEGS)[:] = reals_at(fmu.outputs, fmu.output_count)[APPLIED : APPLIED + LEGS]
    return 1
