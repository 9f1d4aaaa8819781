"""A law as a C function: compiled code calls its address with its gains, its model and the tick.

The laws of this project are compiled functions (`PointedLaw`). A law in plain Python needs `reset` and
`effort` only, and no compiler: `called_by_pointer` wraps it in a callback of the same signature.
"""

from __future__ import annotations

import ctypes
from math import nan
from typing import Any, ClassVar, NamedTuple

import numpy as np

from drivers.arrays import Array
from drivers.compiled.compiler import INTEGER, helper, record
from drivers.compiled.pointed import FAILED, Pointed, call, data_at, of_python, record_at
from drivers.tick_columns import TICK, Record, part
from hil.control.law import Law
from hil.robot.dynamics import Model

LAW_COLUMNS = part("estimate", "reference", "effort")
"""Columns of a tick that a law reads."""
SEEN = record(TICK, *LAW_COLUMNS)
"""Type of the tick, last argument of a law's function after gains, address of model constants, variant."""
_seen_at: Any = record_at(SEEN)


@helper
def ask(law: int, gains: int, constants: int, code: int, tick: int) -> None:
    """Call a law's function to fill tau_law of a tick; nan where the law is undefined or fails.

    All arguments except `code` are addresses. tau_law is nan before the call: Ctrl-C at a callback's first
    instruction ends the callback without a status.
    """
    seen = _seen_at(tick)
    seen.tau_law[:] = np.nan
    if call(law, (gains, constants, code, tick)) < 0:
        seen.tau_law[:] = np.nan


class Pointer(NamedTuple):
    """Address of a law's C function and its first three arguments; the fourth is the tick's address."""

    address: int
    gains: int
    """Address of the record of gains and state."""
    constants: int
    """Address of the model's constants (SIZE,); 0 without a model."""
    code: int
    """Variant of the model, as a number."""
    keeps: PointedLaw | PythonLaw
    """Owner of the memory at these addresses; its `raised` is the law's exception."""


def gains(dtype: np.dtype[np.void], *values: Array | float) -> Record:
    """Record of `dtype` with a law's gains in the order of its fields; remaining fields are zero."""
    filled = np.zeros((), dtype)
    for name, value in zip((dtype.names or ())[: len(values)], values, strict=True):
        filled[name] = value
    return filled


class PointedLaw:
    """A law that is one compiled function of its gains, its model and the tick.

    A subclass defines the record of the gains and the function. A law's mutable state, if any, is in the
    record.
    """

    dtype: ClassVar[np.dtype[np.void]]
    fill: ClassVar[Pointed]
    """Function that fills tau_law (6,) N of a tick; NaN where the law is undefined."""
    raised: None = None
    """Compiled laws raise no exception."""

    def __init__(self, model: Model | None, *values: Array | float) -> None:
        """Store the gains, given in the order of the fields of `dtype`."""
        self.gains = gains(self.dtype, *values)
        self._model = model
        constants, code = (0, 0) if model is None else (data_at(model.constants), model.code)
        self._called_with = data_at(self.gains), constants, code

    @property
    def model(self) -> Model:
        """Robot model that the law computes with. Raises AttributeError for a law without a model."""
        if self._model is None:
            raise AttributeError(f"{type(self).__name__} has no model")
        return self._model

    @property
    def pointer(self) -> Pointer:
        """Address of the law's function and its first three arguments, for compiled code."""
        return Pointer(self.fill.address, *self._called_with, self)

    def reset(self) -> None:
        """Do nothing: the law has no state."""

    def effort(self, tick: Record) -> None:
        """Fill tau_law (6,) N of the tick by the same function that compiled code calls."""
        self.fill(*self._called_with, tick)


_effort = PointedLaw.effort
_COLUMNS = TICK.itemsize // 8
_Buffer = ctypes.c_double * _COLUMNS
_fields: Any = TICK.fields
_TAU_LAW = slice(_fields["tau_law"][1] // 8, _fields["tau_law"][1] // 8 + 6)


class PythonLaw:
    """A callback that runs a law in plain Python, with the signature of a compiled law.

    The law receives a copy of the tick; only tau_law is copied back.

    Mutable state: the exception of the last call.
    """

    def __init__(self, law: Law) -> None:
        self.law = law
        self.raised: BaseException | None = None
        """Exception of the last call, or None."""
        self._address, self._callback = of_python(self._called, INTEGER, INTEGER, INTEGER, INTEGER)

    @property
    def pointer(self) -> Pointer:
        """Address of the callback, for compiled code; gains, constants and variant are 0."""
        return Pointer(self._address, 0, 0, 0, self)

    def reset(self) -> None:
        """Set the state of the wrapped law to its initial value."""
        self.law.reset()

    def effort(self, tick: Record) -> None:
        """Fill tau_law (6,) N of the tick; an earlier exception stays stored if this call succeeds."""
        before = self.raised
        tick["tau_law"] = nan
        self._called(0, 0, 0, data_at(tick))
        self.raised = self.raised or before

    def _called(self, _gains: int, _constants: int, _code: int, tick: int) -> int:
        try:
            buffer: Any = _Buffer.from_address(tick)
            values = np.frombuffer(buffer, np.float64)
            own = values.copy()
            self.raised = None
            self.law.effort(np.ndarray((), TICK, own))
            values[_TAU_LAW] = own[_TAU_LAW]
        except BaseException as error:  # noqa: BLE001 - nothing may leave a callback, Ctrl-C neither
            self.raised = error
            return FAILED
        return 0


def called_by_pointer(law: Law) -> Pointer:
    """Pointer with which compiled code calls a law: its compiled function, or a callback of its `effort`."""
    if isinstance(law, PointedLaw) and getattr(law.effort, "__func__", None) is _effort:
        return law.pointer
    return PythonLaw(law).pointer
