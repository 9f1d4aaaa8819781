"""One step of an FMU through the functions of either standard: what they are given, and when."""

from __future__ import annotations

import ctypes as ct
from typing import Any

import numpy as np
import pytest

from plant_fmu.fmu import call as fmu_call
from plant_fmu.fmu.call import (
    DONE,
    INPUTS_REFUSED,
    INTERRUPTED,
    NOT_FINITE,
    OUTPUT_NOT_FINITE,
    OUTPUTS_REFUSED,
    STEP_REFUSED,
)

INSTANCE = 0x1234
ERROR = 3


class Functions:
    """The functions of an FMU that has 12 inputs, force and wrench unless others are said, and 12 outputs."""

    def __init__(self, *, counted: bool, slots: tuple[int, int, int] = (0, -1, 6)) -> None:
        size_in = 6 * sum(place >= 0 for place in slots)
        self.sets: list[list[float]] = []
        self.steps: list[tuple[float, float]] = []
        self.set_status = self.get_status = self.step_status = 0
        self.measured: list[ct.c_double | float] = [float(k) for k in range(1, 13)]
        self.flagged: int | None = None
        """Which of DoStep's flags the next steps set."""
        self.given: set[tuple[int, ...]] = set()
        """What was given besides the values."""
        self.references = np.arange(12, dtype=np.uint32) + 40
        self.inputs, self.held = np.zeros(size_in), np.zeros(size_in, np.int64)
        self.outputs = np.zeros(12)
        place = size = ct.c_int64
        moved: tuple[Any, ...] = (place, place, size, place, *([size] if counted else []))
        stepped: tuple[Any, ...] = (
            place,
            ct.c_double,
            ct.c_double,
            ct.c_int32,
            *([place] * 4 if counted else []),
        )
        self._kept: Any = (
            ct.CFUNCTYPE(ct.c_int32, *moved)(self._set),
            ct.CFUNCTYPE(ct.c_int32, *moved)(self._get),
            ct.CFUNCTYPE(ct.c_int32, *stepped)(self._step),
        )
        self.fmu: Any = np.zeros((), fmu_call.FMU)
        for name, each in zip(("set", "get", "step"), self._kept, strict=True):
            self.fmu[name] = ct.cast(each, ct.c_void_p).value or 0
        for name in ("set", "get"):
            self.fmu[f"{name}_references"], self.fmu[f"{name}_count"] = self.references.ctypes.data, 12
        self.fmu["instance"], self.fmu["counted"], self.fmu["slots"] = INSTANCE, counted, slots

    def _set(self, instance: int, references: int, count: int, values: int, *sizes: int) -> int:
        self.given.add((instance, references, count, *sizes))
        self.sets.append(list((ct.c_double * self.inputs.size).from_address(values)))
        return self.set_status

    def _get(self, instance: int, references: int, count: int, values: int, *sizes: int) -> int:
        self.given.add((instance, references, count, *sizes))
        (ct.c_double * 12).from_address(values)[:] = self.measured
        return self.get_status

    def _step(self, instance: int, t_s: float, dt_s: float, never_back: int, *places: int) -> int:
        self.given.add((instance, never_back, *places))
        self.steps.append((t_s, dt_s))
        for k, place in enumerate(places[:3]):
            ct.c_uint8.from_address(place).value = k == self.flagged
        return self.step_status

    def move(self, force: Any, brake: Any, wrench: Any, t_s: float = 0.0) -> tuple[int, int]:
        """Return how a step of 0.25 s from t_s on ended, and the last status."""
        fmu, kept = self.fmu, [np.ascontiguousarray(each) for each in (force, brake, wrench)]
        measured = np.zeros(12)
        for name in ("inputs", "held", "outputs"):
            fmu[name] = getattr(self, name).ctypes.data
        fmu["input_count"], fmu["output_count"] = self.inputs.size, self.outputs.size
        fmu["ready"], fmu["ticks"], fmu["step_s"] = 1, round(t_s / 0.25), 0.25
        ended = fmu_call.move(fmu, *(each.ctypes.data for each in kept), 1, measured.ctypes.data)
        assert ended != DONE or measured.tolist() == self.outputs.tolist()
        return int(ended), int(fmu["status"])

    def exchange(self, force: float, wrench: float, t_s: float = 0.0) -> int:
        six = np.arange(6.0)
        return self.move(force + six, 9.0 + six, wrench - six, t_s)[0]


def given(force: float, wrench: float) -> list[float]:
    return [*(force + k for k in range(6)), *(wrench - k for k in range(6))]


@pytest.mark.parametrize("counted", [False, True], ids=["2.0", "3.0"])
def test_inputs_are_set_only_when_one_has_changed(counted):
    fmu = Functions(counted=counted)
    pairs = [(1.0, 2.0), (1.0, 2.0), (1.0, 2.5), (1.5, 2.5), (1.5, 2.5)]
    ended = [fmu.exchange(*pair, t_s=0.25 * k) for k, pair in enumerate(pairs)]
    assert ended == [DONE] * 5
    assert fmu.sets == [given(1.0, 2.0), given(1.0, 2.5), given(1.5, 2.5)]
    assert fmu.steps == [(0.25 * k, 0.25) for k in range(5)]
    assert fmu.outputs.tolist() == [float(k) for k in range(1, 13)]
    moved = (INSTANCE, fmu.references.ctypes.data, 12, *([12] if counted else []))
    at = fmu.fmu["flags"].ctypes.data
    assert fmu.given == {
        moved,
        (INSTANCE, 1, *([at, at + 1, at + 2, fmu.fmu["last"].ctypes.data] if counted else [])),
    }


@pytest.mark.parametrize("counted", [False, True], ids=["2.0", "3.0"])
def test_refused_inputs_are_set_again_and_no_step_is_taken_with_them(counted):
    """The FMU may have taken a part of them."""
    fmu = Functions(counted=counted)
    assert fmu.exchange(1.0, 2.0) == DONE
    fmu.set_status = ERROR
    assert [fmu.exchange(3.0, 2.0), fmu.exchange(3.0, 2.0)] == [INPUTS_REFUSED] * 2
    assert fmu.exchange(np.nan, 2.0) == NOT_FINITE
    assert (len(fmu.sets), len(fmu.steps)) == (3, 1)
    fmu.set_status = 0
    assert fmu.exchange(1.0, 2.0) == DONE
    assert fmu.sets == [given(1.0, 2.0), given(3.0, 2.0), given(3.0, 2.0), given(1.0, 2.0)]
    fmu.step_status = ERROR
    assert fmu.exchange(1.0, 2.0) == STEP_REFUSED
    assert len(fmu.sets) == 4, "the FMU has them"


@pytest.mark.parametrize("slots", [(0, 6, 12), (6, 12, 0), (12, 0, 6), (-1, 0, -1)])
def test_force_brake_and_wrench_stand_at_their_own_places(slots):
    fmu = Functions(counted=True, slots=slots)
    given = np.arange(6.0) + 10.0, np.arange(6.0) / 8.0, np.arange(6.0) - 30.0
    assert fmu.move(*given) == (DONE, 0)
    there = sorted((place, values.tolist()) for place, values in zip(slots, given, strict=True) if place >= 0)
    assert fmu.sets == [[x for _, values in there for x in values]]


@pytest.mark.parametrize(("flag", "ended"), [(0, DONE), (1, INTERRUPTED), (2, INTERRUPTED)])
def test_a_step_is_interrupted_by_termination_and_early_return_not_by_an_event(flag, ended):
    fmu = Functions(counted=True)
    assert fmu.exchange(1.0, 2.0) == DONE
    fmu.flagged = flag
    assert fmu.exchange(1.0, 2.0) == ended
    assert fmu.fmu["flags"][:3].tolist() == [k == flag for k in range(3)]


@pytest.mark.parametrize("counted", [False, True], ids=["2.0", "3.0"])
@pytest.mark.parametrize(
    ("name", "refused", "ticks"),
    [
        ("set_status", INPUTS_REFUSED, 0),
        ("step_status", STEP_REFUSED, 0),
        ("get_status", OUTPUTS_REFUSED, 1),
    ],
)
def test_a_warning_is_a_success_and_time_goes_on_only_after_a_step(counted, name, refused, ticks):
    for status, ended in ((1, DONE), (2, refused), (5, refused), (-1, refused), (-(2**31), refused)):
        fmu = Functions(counted=counted)
        setattr(fmu, name, status)
        assert fmu.exchange(1.0, 2.0) == ended, status
        assert fmu.fmu["ticks"] == (1 if ended == DONE else ticks), status


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
def test_each_length_rate_and_input_must_be_finite(value):
    for place in range(12):
        fmu = Functions(counted=True)
        fmu.measured[place] = value
        assert fmu.exchange(1.0, 2.0) == OUTPUT_NOT_FINITE
        given, six = [np.ones(6), np.ones(6)], np.ones(6)
        given[place // 6][place % 6] = value
        assert fmu.move(given[0], six, given[1]) == (NOT_FINITE, 0), "the FMU was not asked"
