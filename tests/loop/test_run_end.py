"""Start and end of a run: the rules of both loops, on a synthetic cycle."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any, NamedTuple

import numpy as np
import pytest

from drivers.protocol import DriveSetup
from drivers.signals import NEVER, DriveState, Fault, Mode, Reaction, Stop
from drivers.tick_columns import FIRST
from hil.contracts.records import record_of
from hil.loop.modes import Durations
from hil.loop.run_end import Course
from hil.signals import Operator

RATE_Hz = 100.0
SET_UP = SimpleNamespace(
    fault_text=lambda _: "",
    traits=SimpleNamespace(stop_latches=True, force_on_brakes=True, has_watchdog=True),
)
HEARD = {"age": 0, "counted_age": 0, "drive_state": DriveState.OFF}


def cycle(mode, mode_tick=0, faults=Fault.NONE, stop=Stop.NONE, **measured):
    tick = record_of(**(HEARD | measured))
    return SimpleNamespace(
        mode=mode,
        mode_tick=mode_tick,
        faults=faults,
        stop_requested=stop,
        proven=True,
        tick=tick,
        last=tick,
        estop=False,
        homing=SimpleNamespace(refusal=""),
        operating=SimpleNamespace(trouble=""),
        reset_tick=None,
        end=SimpleNamespace(lacks=lambda: ("",) * 6),
        looked=True,
        durations=Durations(0.3, 0.1, 0.1),
        parts=SimpleNamespace(
            rate_Hz=RATE_Hz,
            fusion=None,
            protocol=SET_UP,
            setup=DriveSetup(0.01, Reaction.BRAKE, RATE_Hz),
            safety=SimpleNamespace(
                limits={"stale_fault_ticks": np.int64(5)},
                memory={"refused": 0b11111, "running": 0, "untrusted": 0},
            ),
        ),
    )


def states(*different):
    return np.array([*different, *[DriveState.OFF] * (6 - len(different))], np.int64)


MOVES = np.array([0.0, 0.0, 0.02, 0.0, 0.0, 0.0])
NONE: dict[int, Any] = {}
E, S, R, X = (Operator.ENGAGE,), (Operator.STOP,), (Operator.RESET,), (Operator.ESTOP,)


def change(now, tick, changes):
    """Change a cycle in a tick; a new mode begins there."""
    for name, value in changes.items():
        if name in {"age", "rate", "drive_state"}:
            now.tick[name] = value
        else:
            setattr(now, name, value)
    if "mode" in changes:
        now.mode_tick = tick


# -- which commands a run gives by itself ----------------------------------------------------------------------


class Commands(NamedTuple):
    """A course, its modes by tick, the operator's commands by tick, and the expected commands until tick 200."""

    course: dict[str, Any]
    modes: dict[int, Mode]
    said: dict[int, tuple[Operator, ...]]
    given: dict[int, tuple[Operator, ...]]
    first: int = 0


I, W, L, T = Mode.IDLE, Mode.WAITING, Mode.LOADING, Mode.TRACKING
HALF = {"duration_s": 0.5}
ASKED = HALF | {"armed": False}
AGAIN = {0: I, 1: W, 2: I, 3: L, 4: W, 5: I}
"""The cycle returns to WAITING in the tick of the consent, and again, parked, by a reset."""
COMMANDS = {
    "engages once idle and never twice": Commands({}, {0: W, 1: I}, NONE, {1: E}),
    "engages again after a drive was switched off in that tick": Commands({}, AGAIN, NONE, {0: E, 2: E}),
    "the operator arms again after a drive was switched off in that tick": Commands(
        {"armed": False}, AGAIN, {0: E, 2: E}, {0: E, 2: E}
    ),
    "a fault before any motion takes the consent back": Commands(
        {}, {0: Mode.FAULT, 1: W, 2: I}, {0: R, 9: E}, {0: R, 9: E}
    ),
    "a reset in WAITING keeps the consent": Commands({}, {0: W, 1: I}, {0: R}, {0: R, 1: E}),
    "resets in the first tick on request": Commands({"reset": True}, {0: W}, NONE, {0: R}),
    "the run's own commands come first": Commands(
        {"duration_s": 0.01, "reset": True}, {1: I}, {1: X}, {1: (*R, *E, *S, *X)}, first=1
    ),
    "a duration counts from the first consent": Commands(ASKED, {0: I}, {7: E, 20: E}, {7: E, 20: E, 57: S}),
    "a duration counts from the second consent": Commands(
        ASKED, {0: I, 1: W, 2: I}, {0: E, 40: E}, {0: E, 40: E, 90: S}
    ),
    "a second consent after the end of the first duration": Commands(
        ASKED, {0: I, 1: W, 2: I}, {0: E, 80: E}, {0: E, 80: E, 130: S}
    ),
    "a withdrawn consent keeps the end of the run": Commands(
        HALF, {0: Mode.FAULT, 10: I, 11: W}, {10: E}, {10: E, 50: S}
    ),
    "a stopped run is not stopped again": Commands(HALF, {0: W, 60: I, 61: W}, NONE, {50: S, 60: E}),
    "a run after END is not stopped at its duration": Commands(
        HALF, {0: T}, {10: (Operator.END,)}, {10: (*S, Operator.END)}
    ),
    **{
        f"a consent in {mode.name} does not count for later": Commands(
            ASKED, {0: mode, 1: I}, {0: E, 100: E}, {0: E, 100: E, 150: S}
        )
        for mode in (W, L, T, Mode.PARKED)
    },
}


@pytest.mark.parametrize("case", COMMANDS.values(), ids=COMMANDS)
def test_run_sends_engage_once_and_stop_once(case):
    now = cycle(W, faults=Fault.NONE)
    course, given = Course(now, **case.course), {}
    for tick in range(case.first, 200):
        now.mode = case.modes.get(tick, now.mode)
        now.faults = Fault.ESTOP if now.mode is Mode.FAULT else Fault.NONE
        given[tick] = course.commands(tick, case.said.get(tick, ()))
    assert {tick: commands for tick, commands in given.items() if commands} == case.given


def test_run_stops_once_at_its_duration_even_if_that_period_is_skipped():
    course = Course(cycle(T), 0.5)
    assert [course.commands(tick) for tick in (49, 53, 54)] == [(), S, ()]


@pytest.mark.parametrize("mode", Mode)
def test_run_waits_for_the_operators_arm_command_only_when_its_drives_are_ready(mode):
    assert Course(cycle(mode), armed=False).waits_for_consent == (mode is I)
    assert not Course(cycle(mode)).waits_for_consent


# -- when a run ends -------------------------------------------------------------------------------------------


class End(NamedTuple):
    """A cycle, a course, changes and commands by tick, and the expected ending: its tick and part of its
    text.
    """

    now: dict[str, Any]
    course: dict[str, Any]
    ends: int | None
    said: str = ""
    changes: dict[int, dict[str, Any]] = NONE
    operator: dict[int, tuple[Operator, ...]] = NONE
    fault_tick: int | None = None


def at(mode: Mode, tick: int = 0, **more: Any) -> dict[str, Any]:
    faults = Fault.ESTOP if mode in {Mode.FAULT, Mode.HELD} else Fault.NONE
    return {"mode": mode, "mode_tick": tick, "faults": faults} | more


F, H, P = Mode.FAULT, Mode.HELD, Mode.PARKED
ONE_HEARD = np.where(np.arange(6) == 4, 0, FIRST["age"])
STAYS, GOES_ON = {"stays": True}, {"goes_on": True}
ON_BRAKES = {n: {"mode": (H, Mode.UNLOADING)[n // 20 % 2]} for n in range(0, 3000, 20)}
"""With lost frames no brake test comes to its end; the modes alternate every 0.2 s."""
ENDS = {
    # parked
    "parked, proven, all off": End(at(P, 7), {}, 7),
    "not proven": End(at(P, 7, proven=False), {}, 32),
    "a drive not off": End(at(P, 7, drive_state=states(DriveState.READY)), {}, 32),
    "proven later": End(at(P, proven=False), {}, 10, "", {10: {"proven": True}}),
    "off later": End(at(P, 7, drive_state=states(DriveState.BOOT)), {}, 9, "", {9: {"drive_state": states()}}),
    "parked, but stays": End(at(P), GOES_ON, None),
    "parked, but stays until END": End(at(P), GOES_ON | {"armed": False}, 1000, "", NONE, {1000: (Operator.END,)}),
    # after a fault
    **{f"a fault in tick {n}": End(at(F, n), {}, n + 25, fault_tick=n) for n in range(4)},
    "a slow loop commands OFF five times": End(at(F, rate_Hz=5.0), {}, 5),
    "a leg moves": End(at(F, 40, rate=MOVES), {}, 1040, "still moving: leg 2 at"),
    "a leg moves, stays": End(at(F, rate=MOVES), STAYS, None, "", NONE, {30: S}),
    "a leg moves, ended by an emergency stop": End(at(F, rate=MOVES), STAYS, 31, "still moving: leg 2", NONE, {30: S, 31: X}),
    "at rest, ended by an emergency stop": End(at(F, 40), STAYS, 41, "!still moving", NONE, {41: X}),
    "a fault, but goes on": End(at(F), GOES_ON, None),
    "a fault, but goes on until END": End(at(F), GOES_ON | {"armed": False}, 1000, "", NONE, {1000: (Operator.END,)}),
    **{
        f"an emergency stop in {mode.name} does not end it": End(
            at(mode, rate=MOVES), STAYS, 524, "", {10: at(F), 500: {"rate": 0.0}}, {10: X}
        )
        for mode in (Mode.APPROACH, T, Mode.STOPPING, H)
    },
    "a second emergency stop ends it": End(at(T, rate=MOVES), STAYS, 11, "", {10: at(F)}, {10: X, 11: X}),
    "all faults, the first tick": End(
        at(F, 40), {}, 65, "latched fault ESTOP, BUS", {45: {"faults": Fault.ESTOP | Fault.BUS}}, fault_tick=40
    ),
    "a second fault after a reset": End(
        at(F, 40), {}, 85, "latched fault BUS", {60: at(F, faults=Fault.BUS)}, fault_tick=60
    ),
    "parked after a reset": End(at(F, 40), {}, 60, "", {60: at(P, reset_tick=50)}, fault_tick=-1),
    # held
    **{f"held from tick {n}": End(at(H, n), {}, n + 100, fault_tick=n) for n in range(2)},
    "held, stays": End(at(H), STAYS, None),
    "held, moves": End(at(H, rate=MOVES), {}, 1000),
    "held, moves, a fault follows": End(at(H, rate=MOVES), {}, 1000, "", {600: {"faults": Fault.BUS | Fault.ESTOP}}),
    "held later": End(at(Mode.PARKING, rate=MOVES, faults=Fault.ESTOP), {}, 1500, "", {500: at(H)}),
    "held and on brakes in turn": End(at(H), {}, 1000, "", ON_BRAKES),
    "held and on brakes in turn, stays": End(at(H), STAYS, None, "", ON_BRAKES),
    "held again": End(at(H, rate=MOVES), {}, 1600, "", {800: at(T), 1500: at(H, rate=0.0)}),
    "held again, moves": End(at(H, rate=MOVES), {}, 2500, "", {800: at(T), 1500: at(H)}),
    # waiting
    "no drives": End(at(W, age=FIRST["age"]), {}, 200, "no drives"),
    "no drives, stays": End(at(W, age=NEVER), GOES_ON | {"armed": False}, 200, "no drives"),
    "one drive heard": End(at(W, 7, age=ONE_HEARD), {}, 1007, "drive 0 never answered"),
    "drives that boot": End(at(W, 7, drive_state=states(*[DriveState.BOOT] * 6)), {}, 1007),
    **{
        f"drive {n} failed": End(
            at(W, 7, drive_state=np.roll(states(DriveState.FAULT), n)), {}, 207, f"drive {n} stays in FAULT"
        )
        for n in range(6)
    },
    "turns are not known": End(at(W, 5, homing=SimpleNamespace(refusal="turn it home")), {}, 205, "turn it home"),
    "drives that were ready before": End(
        at(I), GOES_ON, 2900, "", {1: at(L), 2: at(W, age=NEVER)}, {2900: (Operator.END,)}
    ),
    "over before the drives were ready": End(
        at(W, age=NEVER, stop_requested=Stop.MISSED), {"duration_s": 1.0}, 100, "drive 0 never answered", {100: at(P)}
    ),
    "over before ready, a later END is no success": End(
        at(W, age=NEVER), GOES_ON | {"duration_s": 1.0}, 125, "drive 0 never answered",
        {100: at(P, drive_state=states(DriveState.READY))}, {101: (*S, Operator.END)},
    ),
    # between start and end
    **{f"in {mode.name}": End(at(mode), {}, None) for mode in Mode if mode not in {W, P, F, H}},
}  # fmt: skip


@pytest.mark.parametrize("case", ENDS.values(), ids=ENDS)
def test_run_ends_in_the_expected_period_with_the_expected_reason(case):
    now = cycle(case.now["mode"], case.now["mode_tick"], case.now["faults"])
    more = {key: value for key, value in case.now.items() if key not in {"mode", "mode_tick", "faults"}}
    now.parts.rate_Hz = more.pop("rate_Hz", RATE_Hz)
    change(now, 0, more)
    course, ending = Course(now, **case.course), None
    for tick in range(now.mode_tick, 3000):
        course.commands(tick, case.operator.get(tick, ()))
        if tick in case.changes:
            change(now, tick, {k: v for k, v in case.changes[tick].items() if k != "mode_tick"})
        ending = course.ending(tick)
        if ending is not None:
            break
    assert (ending.ticks if ending else None) == case.ends
    if ending is not None:
        wanted = case.said.removeprefix("!")
        assert (wanted in ending.reason) is (wanted == case.said)
        assert case.fault_tick in {None, ending.fault_tick}
