"""A plant that is not compiled, by address: a compiled pass calls its methods."""

import ctypes
from functools import cache
from typing import Any

import numpy as np

from drivers.arrays import Array
from drivers.compiled.compiler import INTEGER
from drivers.compiled.pointed import FAILED, of_python
from drivers.signals import LEGS
from plant_fmu.plant import Moved, Plant


def moved(plant: Plant) -> Moved:
    """Return a plant by address: its own functions, or those that call its methods."""
    compiled = getattr(plant, "moved", None)
    return _python(plant) if compiled is None else compiled()


@cache
def _reals(address: int, count: int) -> Array:
    memory: Any = (ctypes.c_double * count).from_address(address)
    return np.frombuffer(memory, np.float64)


def _python(plant: Plant) -> Moved:
    errors: list[BaseException] = []
    step_s = plant.internal_step_s

    def move(_context: int, force: int, brake: int, wrench: int, steps: int, measured: int) -> int:
        try:
            given = [_reals(at, LEGS).copy() for at in (force, brake, wrench)]
            length, rate = plant.step(given[0], given[1], given[2], steps * step_s)
            into = _reals(measured, 2 * LEGS)
            into[:LEGS], into[LEGS:] = length, rate
        except BaseException as error:  # noqa: BLE001 - it is raised again behind the pass
            errors.append(error)
            return FAILED
        return 0

    def applied(_context: int, force: int) -> int:
        try:
            known = plant.applied_force()
            if known is None:
                return 0
            _reals(force, LEGS)[:] = known
        except BaseException as error:  # noqa: BLE001 - as above
            errors.append(error)
            return FAILED
        return 1

    moves, keeps_move = of_python(move, *[INTEGER] * 6)
    applies, keeps_applied = of_python(applied, *[INTEGER] * 2)
    return Moved(moves, applies, 0, lambda *_: errors.pop(), (keeps_move, keeps_applied))
