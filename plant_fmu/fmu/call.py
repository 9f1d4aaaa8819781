"""Communication steps of an FMU in one compiled call: inputs, step, outputs.

Other threads run meanwhile: one of them ends a child process whose FMU hangs.
"""

from typing import Any

import numpy as np

from drivers.compiled.compiler import INTEGER, REAL, helper, record
from drivers.compiled.pointed import call, integers_at, pointed, reals_at
from drivers.signals import LEGS

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
        *((name, "<i8") for name in ("instance", "counted", "set", "get", "step")),
        *((name, "<i8") for name in ("set_references", "set_count", "get_references", "get_count")),
        *((name, "<i8") for name in ("inputs", "input_count", "held", "outputs", "output_count")),
        ("slots", "<i8", (3,)),
        *((name, "<i8") for name in ("ready", "ticks", "known", "status")),
        ("flags", "u1", (8,)),
        ("last", "<f8", (1,)),
        ("step_s", "<f8"),
    ]
)
"""One FMU: the component; 1 for FMI 3, which counts values; addresses of its functions, and of the value
references that they take with their numbers; addresses of inputs, of the bits that the FMU holds of them,
and of outputs; where force, brake and wrench stand among the inputs, -1 for what the FMU does not have;
whether it is initialised, internal steps since then, whether the applied forces are known; the FMU's last
status; DoStep's three flags and its last time; s, its internal step."""
_WARNING = 1
"""The worst status of both standards that still is a success."""
_TERMINATED, _EARLY = 1, 2


@helper
def succeeded(status: int) -> bool:
    """Tell whether a status of either standard is a success: no number that neither has."""
    return 0 <= status <= _WARNING


@helper
def _called(fmu: Any, function: int, given: Any, counted: Any) -> int:
    """Call a function of the FMU, one of FMI 3 with some arguments more; return its status."""
    if fmu.counted:
        return int(call(function, (fmu.instance, *given, *counted)))
    return int(call(function, (fmu.instance, *given)))


@helper
def _put(fmu: Any) -> int:
    """Set the FMU's inputs; return its status. `held` becomes their bits, or something else if it refuses."""
    bits, held = integers_at(fmu.inputs, fmu.input_count), integers_at(fmu.held, fmu.input_count)
    held[:] = ~bits
    status = _called(fmu, fmu.set, (fmu.set_references, fmu.set_count, fmu.inputs), (fmu.input_count,))
    if succeeded(status):
        held[:] = bits
    return status


@helper
def _fetch(fmu: Any) -> int:
    """Get the FMU's outputs; return how that ended. Lengths and rates have to be finite."""
    given = (fmu.get_references, fmu.get_count, fmu.outputs)
    fmu.status = _called(fmu, fmu.get, given, (fmu.output_count,))
    if not succeeded(fmu.status):
        return OUTPUTS_REFUSED
    for y in reals_at(fmu.outputs, MEASURED):
        if not np.isfinite(y):
            return OUTPUT_NOT_FINITE
    return DONE


@helper
def _do_step(fmu: Any, t_s: float, dt_s: float) -> int:
    at = np.int64(fmu.flags.ctypes.data)
    counted = (at, at + 1, at + 2, np.int64(fmu.last.ctypes.data))
    return _called(fmu, fmu.step, (t_s, dt_s, np.int32(1)), counted)  # 1: no step is ever taken back


put, fetch = pointed(record(FMU))(_put), pointed(record(FMU))(_fetch)
do_step = pointed(record(FMU), REAL, REAL)(_do_step)
"""The same for Python."""


@pointed(record(FMU), INTEGER, INTEGER, INTEGER, INTEGER, INTEGER)
def move(fmu: Any, force: int, brake: int, wrench: int, steps: int, measured: int) -> int:
    """Set what changed of the inputs, go some internal steps, and fill lengths and rates `measured` (12,).

    force, brake, wrench (6,) and `measured` are addresses. Returns how the exchange ended. The communication
    time is a multiple of the internal step, not a sum.
    """
    if not fmu.ready:
        return CLOSED
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
        reals_at(measured, MEASURED)[:] = reals_at(fmu.outputs, MEASURED)
    return int(ended)


@pointed(record(FMU), INTEGER)
def applied(fmu: Any, force: int) -> int:
    """Fill in the applied forces (6,) N at an address; return 1, or 0 where they are not known."""
    if not fmu.known:
        return 0
    reals_at(force, LEGS)[:] = reals_at(fmu.outputs, fmu.output_count)[APPLIED : APPLIED + LEGS]
    return 1
