"""Communication steps of an FMU in one compiled call: inputs, step, outputs.

The call releases the GIL: another thread can end a child process whose FMU hangs.
"""

from typing import Any

import numpy as np

from drivers.compiled.compiler import INTEGER, REAL, helper, record
from drivers.compiled.pointed import call, integers_at, pointed, reals_at
from drivers.signals import LEGS
from plant_fmu.plant import MEASURED

DONE, NOT_FINITE, INPUTS_REFUSED, STEP_REFUSED, OUTPUTS_REFUSED, INTERRUPTED, OUTPUT_NOT_FINITE = range(7)
"""Results of a communication step."""
CLOSED = 7
"""There was no step: the FMU is not initialised."""
LENGTHS_RATES = 2 * LEGS
"""Number of lengths and rates, which are the first outputs."""
APPLIED = LENGTHS_RATES + 18
"""Index of the applied forces in the outputs, behind pose and twist, if they are known."""
FMU = np.dtype(
    [
        *((name, "<i8") for name in ("instance", "counted", "set", "get", "step", "set_brake")),
        *((name, "<i8") for name in ("set_references", "set_count", "get_references", "get_count")),
        *((name, "<i8") for name in ("inputs", "input_count", "held", "outputs", "output_count")),
        *((name, "<i8") for name in ("brake_references", "brake_count", "brakes", "brake_bytes")),
        ("slots", "<i8", (3,)),
        *((name, "<i8") for name in ("ready", "stepped", "ticks", "known", "status")),
        ("flags", "u1", (8,)),
        ("last", "<f8", (1,)),
        ("step_s", "<f8"),
        ("offset", "<f8", (LEGS,)),
    ]
)
"""One FMU. The component; 1 for FMI 3, whose calls count values; addresses of its functions, set_brake 0 if
the brakes are real numbers. Addresses and numbers of the value references that set and get take. Addresses of
inputs, of the bits of the inputs that the FMU has, and of outputs. For set_brake: address and number of its
value references, address of its values, bytes of a value. Indices of force, brake and wrench in the inputs,
-1 if the FMU lacks them. True if it is initialised; true if a step was requested since then; internal steps
since then; true if applied forces are known; last status of the FMU. The three flags of DoStep and its last
time; internal step in s; leg lengths m at the FMU's length 0."""
WARNING = 1
"""The worst status of both standards that is still a success."""
_TERMINATED, _EARLY = 1, 2


@helper
def succeeded(status: int) -> bool:
    """True if an FMI status is OK or Warning (FMI 2 and 3); False for any other number."""
    return 0 <= status <= WARNING


@helper
def _called(fmu: Any, function: int, given: Any, counted: Any) -> int:
    """Call an FMI function; FMI 3 has the extra arguments `counted`. Returns the FMI status."""
    if fmu.counted:
        return int(call(function, (fmu.instance, *given, *counted)))
    return int(call(function, (fmu.instance, *given)))


@helper
def _put(fmu: Any) -> int:
    """Set the FMU's inputs; returns the FMI status. `held` becomes their bits, or differs after failure."""
    bits, held = integers_at(fmu.inputs, fmu.input_count), integers_at(fmu.held, fmu.input_count)
    held[:] = ~bits
    reals = fmu.input_count - LEGS if fmu.set_brake else fmu.input_count
    status = _called(fmu, fmu.set, (fmu.set_references, fmu.set_count, fmu.inputs), (reals,))
    if fmu.set_brake and succeeded(status):
        brake, values = reals_at(fmu.inputs, fmu.input_count), integers_at(fmu.brakes, LEGS).view(np.uint8)
        for leg in range(LEGS):  # the lowest byte of each integer
            values[fmu.brake_bytes * leg] = brake[reals + leg] > 0.5
        given = (fmu.brake_references, fmu.brake_count, fmu.brakes)
        status = _called(fmu, fmu.set_brake, given, (np.int64(LEGS),))
    if succeeded(status):
        held[:] = bits
    return status


@helper
def _fetch(fmu: Any) -> int:
    """Get the FMU's outputs; returns DONE or the failure. Lengths and rates have to be finite."""
    given = (fmu.get_references, fmu.get_count, fmu.outputs)
    fmu.status = _called(fmu, fmu.get, given, (fmu.output_count,))
    if not succeeded(fmu.status):
        return OUTPUTS_REFUSED
    for y in reals_at(fmu.outputs, LENGTHS_RATES):
        if not np.isfinite(y):
            return OUTPUT_NOT_FINITE
    return DONE


@helper
def _do_step(fmu: Any, t_s: float, dt_s: float) -> int:
    at = np.int64(fmu.flags.ctypes.data)
    counted = (at, at + 1, at + 2, np.int64(fmu.last.ctypes.data))
    return _called(fmu, fmu.step, (t_s, dt_s, np.int32(1)), counted)  # 1: no step is ever repeated


put, fetch = pointed(record(FMU))(_put), pointed(record(FMU))(_fetch)
do_step = pointed(record(FMU), REAL, REAL)(_do_step)
"""The same functions, callable from Python."""


@pointed(record(FMU), INTEGER, INTEGER, INTEGER, INTEGER, INTEGER)
def move(fmu: Any, force: int, brake: int, wrench: int, steps: int, measured: int) -> int:
    """Set the inputs if they changed, do `steps` internal steps, and fill in what `Moved.move` does.

    force (N), brake, wrench (N, N m), each (6,), and `measured` (18,) are addresses. Returns DONE or the
    failure. The communication time is a multiple of the internal step, not a sum of steps.
    """
    if not fmu.ready:
        return CLOSED
    fmu.stepped = True
    inputs, held = reals_at(fmu.inputs, fmu.input_count), integers_at(fmu.held, fmu.input_count)
    for n, given in enumerate((force, brake, wrench)):
        if fmu.slots[n] >= 0:
            inputs[fmu.slots[n] : fmu.slots[n] + LEGS] = reals_at(given, LEGS)
    bits = inputs.view(np.int64)
    changed = False
    for i in range(bits.size):
        changed = changed or bits[i] != held[i]
    fmu.status = 0
    if changed:  # an FMU holds its inputs until they are set again
        for u in inputs:
            if not np.isfinite(u):
                return NOT_FINITE
        fmu.status = _put(fmu)
        if not succeeded(fmu.status):
            return INPUTS_REFUSED
    fmu.status = _do_step(fmu, fmu.ticks * fmu.step_s, steps * fmu.step_s)
    if not succeeded(fmu.status):
        return STEP_REFUSED
    if fmu.flags[_TERMINATED] or fmu.flags[_EARLY]:
        return INTERRUPTED
    ended = _fetch(fmu)
    fmu.ticks += steps
    if ended == DONE:
        y, outputs = reals_at(measured, MEASURED), reals_at(fmu.outputs, fmu.output_count)
        for leg in range(LEGS):
            y[leg] = outputs[leg] + fmu.offset[leg]
            y[LEGS + leg] = outputs[LEGS + leg]
            y[LENGTHS_RATES + leg] = outputs[APPLIED + leg] if fmu.known else np.nan
    return int(ended)
