"""A push in either direction, slow or fast, shows the leg that gives way and its rate."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from hil.lab.bringup.context import Context, Request
from hil.lab.bringup.steps import brakes, encoder
from hil.lab.bringup.steps.brakes import Steps
from tests.hil.lab.bringup.rehearsals import Rehearsal


class Pushed:
    """A bench on which some legs move by `way_m` when the operator does one action."""

    def __init__(self, act: str, way_m: float, legs: tuple[int, ...]) -> None:
        self.machine = SimpleNamespace(rated_N=30_000.0)
        self.drives = SimpleNamespace(ticks=lambda _: 3)
        self.driven: list[int] = []
        self.asked: list[str] = []
        self._act, self._way_m, self._legs = act, way_m, legs
        self._q = np.full(6, 1.5)

    def ask(self, request: Request, keep: Any = lambda: None) -> float:
        self.asked.append(request.act)
        if request.act == self._act:
            self._q[list(self._legs)] += self._way_m
        keep()
        return 0.0 if request.within is None else 700.0

    def lengths(self) -> Any:
        return self._q.copy()

    def travelled(self, since: Any) -> dict[int, float]:
        return dict(enumerate(self._q - since))

    def drive(self, drive: int) -> None:
        self.driven.append(drive)

    def rest(self, _: float) -> None:
        pass


def pushed(act: str, way_m: float, *legs: int) -> Context:
    return cast("Context", Pushed(act, way_m, legs))


@pytest.mark.parametrize("leg", range(6))
@pytest.mark.parametrize("way_m", [2e-3, -2e-3], ids=["longer", "shorter"])
@pytest.mark.parametrize("act", ["push", "read_held"])
def test_shut_brake_that_slips_in_either_direction_does_not_hold(leg: int, way_m: float, act: str) -> None:
    c = pushed(act, way_m, leg)
    read = [] if act == "push" else ["read_held"]
    assert brakes.holds(c, leg) == {"moved": True, "hand_N": 700.0 if read else None}
    assert c.asked == ["push", *read, "let_go"], "no force is read if the leg gives way"  # type: ignore[attr-defined]
    assert not brakes.holds(pushed(act, way_m / 4.0, leg), leg)["moved"], "elastic deformation is not motion"


@pytest.mark.parametrize("leg", range(6))
@pytest.mark.parametrize("way_m", [2e-3, -2e-3], ids=["longer", "shorter"])
def test_push_by_hand_on_a_leg_detects_an_open_brake_in_either_direction(leg: int, way_m: float) -> None:
    assert brakes.gives_way(pushed("push", way_m, leg), leg, lambda: None) == (True, 700.0)
    assert brakes.gives_way(pushed("push", way_m / 4.0, leg), leg, lambda: None) == (False, 0.0)


@pytest.mark.parametrize("leg", range(6))
@pytest.mark.parametrize("way_m", [2e-3, -2e-3], ids=["longer", "shorter"])
def test_push_by_hand_detects_every_other_leg_whose_brake_a_drive_opens(leg: int, way_m: float) -> None:
    others = [other for other in range(6) if other != leg]
    for freed in ([], others[:1], others[-1:], others[1:4], others):
        c = pushed("push_others", way_m, *freed)
        assert brakes.give_way_too(c, leg, leg, others) == freed
        assert set(c.driven) == {leg}  # type: ignore[attr-defined]
    assert brakes.give_way_too(pushed("push_others", way_m / 4.0, *others), leg, leg, others) == []


def taped(ends: dict[int, tuple[float, float]]) -> list[tuple[str, tuple[int, ...]]]:
    """Findings if some legs end this far, m, before their configured ends (0.75 and 2.2 m)."""
    machine = SimpleNamespace(length_min=0.75, length_max=2.2, stroke=1.45)
    facts = {}
    for leg in range(6):
        low, high = ends.get(leg, (-0.01, -0.01))
        tape = [0.75 + low, 2.2 - high]
        facts[leg] = {"drive": leg, "tape_m": tape, "scale": 1.0, "offset_m": 0.0, "bent_m": 0.0}
    c = SimpleNamespace(machine=machine, table=lambda _: facts)
    return [(found.name, found.legs) for found in encoder.judge(cast("Context", c))]


@pytest.mark.parametrize("ends", [(3e-3, 0.0), (0.0, 3e-3), (3e-3, 3e-3), (0.2, -0.01)])
def test_leg_that_stops_before_its_stroke_end_is_an_end_stop_finding(ends: tuple[float, float]) -> None:
    for leg in range(6):
        assert taped({leg: ends}) == [("end_stop", (leg,))]
    assert taped({1: ends, 4: ends[::-1]}) == [("end_stop", (1,)), ("end_stop", (4,))]
    assert taped(dict.fromkeys(range(6), ends)) == [("stroke", (0, 1, 2, 3, 4, 5))]
    assert taped({}) == taped(dict.fromkeys(range(6), (1e-3, 1e-3))) == []


TICK_NS = 2_000_000


def share_of(motion, rate=lambda v: v):
    """Share for drive 2 after ticks with these speeds, m/s, and reported rates."""
    c = Rehearsal("virtual").context
    record, length = c.drives.record, 1.5
    steps = Steps(c, 2, lambda: None)
    for n, speed in enumerate(motion):
        length += 1e-9 * TICK_NS * speed
        record["t_ns"], record["age"][2] = n * TICK_NS, 0
        record["length"][2], record["rate"][2] = length, rate(speed)
        steps.keep()
    return steps.share()


@pytest.mark.parametrize("speed", [2e-3, 0.015, 0.1, -0.1, 0.8])
@pytest.mark.parametrize("factor", [1.0, -1.0, 2.0, 0.0])
def test_scale_of_the_reported_rate_is_found_from_slow_and_fast_pushes(speed, factor):
    ticks = max(8, round(1.2e-3 / abs(speed) / (1e-9 * TICK_NS)))
    assert share_of([speed] * ticks, lambda v: factor * v) == pytest.approx(factor, abs=1e-9)
