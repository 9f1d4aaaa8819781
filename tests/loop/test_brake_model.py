"""A bounded model of a run with adversarial brakes, drives and operator: it covers every interleaving.

The decisions are the program's own: `next_mode`, `overdue`, `after_fault`, `drive_mode` and the transitions
of the emulated drives. The model adds the environment: two drives that stand for six and may disobey or fail,
brakes that may stop holding at any time, safety that may find faults at any time and motion on closed brakes
one step late, every operator command, and time steps of at least a mode's shortest duration.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import pytest

from drivers.signals import DriveMode, DriveState, Fault, Mode
from hil.config.limits import ReactionSettings
from hil.loop.modes import (
    DRIVE_PATIENCE_S,
    MOVING,
    NO_PROOF,
    Durations,
    Facts,
    after_fault,
    drive_mode,
    next_mode,
    overdue,
)
from hil.signals import Operator
from plant_fmu.drives.drive_rules import TRANSITIONS

DURATIONS = Durations(load=0.3, release=0.1, close=0.1)
LATE = DRIVE_PATIENCE_S + 0.1
DRIVES = 2
COMMANDS = (None, Operator.ENGAGE, Operator.STOP, Operator.RESET, Operator.ESTOP, Operator.RELEASE)
FOUND = (Fault.NONE, Fault.STALE, Fault.SPEED, Fault.CERTIFICATE, Fault.BUS)
"""Faults that safety may find while the drives are powered, even if untrue: one per reaction. DRIVE and BRAKE
follow from the rest."""
REACTIONS = ReactionSettings()
UNDER_CONTROL, TORQUE_OFF = REACTIONS.led_to("ss1"), REACTIONS.led_to("sto")
FORCED = frozenset({Mode.PARKING, Mode.HELD, *MOVING})
"""Modes with the force on. In LOADING it rises and in UNLOADING it falls: the brakes may carry any part."""
ON_BRAKES = frozenset({Mode.IDLE, Mode.LOADING, Mode.UNLOADING, Mode.PARKED})


class State(NamedTuple):
    mode: Mode
    faults: Fault
    drives: tuple[DriveState, ...]
    good: tuple[bool, ...]
    """True while closed brakes hold; a brake that fails stays so."""
    was_bad: bool
    """A leg has moved on a closed brake since the last step."""


class Step(NamedTuple):
    before: State
    operator: Operator | None
    found: Fault
    after: State


START = State(Mode.WAITING, Fault.NONE, (DriveState.OFF,) * DRIVES, (True,) * DRIVES, was_bad=False)


def leads(mode: Mode, faults: Fault) -> Mode:
    """Next mode after faults, by the default reactions."""
    return after_fault(mode, faults, UNDER_CONTROL, TORQUE_OFF, located=True, heard=True)


def obeyed(drives: tuple[DriveState, ...], asked: DriveMode) -> Iterator[tuple[DriveState, ...]]:
    """Yield the possible behaviours of the drives: all obey, one does not, or one fails."""
    good = tuple(DriveState(TRANSITIONS[asked].get(s, s)) for s in drives)
    yield good
    for k in range(DRIVES):
        yield (*good[:k], drives[k], *good[k + 1 :])
        yield (*good[:k], DriveState.FAULT, *good[k + 1 :])


def steps(before: State) -> Iterator[Step]:
    """Yield every step from a state."""
    brakes = {before.good, (False, *before.good[1:]), (False,) * DRIVES}
    for operator in COMMANDS:
        commands = () if operator is None else (operator,)
        least = DURATIONS.least(before.mode)
        arrived = set()  # most lead to the same
        for elapsed, finished in (
            (0.0, False),
            (least + 0.5, False),
            (least + 0.5, True),
            (least + LATE, True),
        ):
            mode, faults, found = before.mode, before.faults, Fault.NONE
            if operator is Operator.RESET and mode in {Mode.FAULT, Mode.WAITING}:
                faults = Fault.NONE
            if overdue(mode, elapsed, DURATIONS):
                waits, found = mode is Mode.PARKING, Fault.DRIVE
                mode = Mode.HELD if waits else leads(mode, found)
            else:
                provable = finished and not faults & NO_PROOF
                facts = Facts(commands, before.drives, True, elapsed, finished, False, provable, False)
                mode = next_mode(mode, facts, DURATIONS)
            arrived.add((mode, faults, found))
        for mode, faults, found in arrived:
            for good in brakes:
                for said in FOUND if drive_mode(mode) is not DriveMode.OFF else FOUND[:1]:
                    yield from judged(
                        before, operator, State(mode, faults, before.drives, good, False), found | said
                    )


def judged(before: State, operator: Operator | None, state: State, found: Fault) -> Iterator[Step]:
    """Yield safety's possible verdicts on a step, with the drives' possible answers to its command."""
    faults = found & ~Fault.DRIVE  # one that is overdue has led to its mode already
    if operator is Operator.ESTOP:
        faults |= Fault.ESTOP
    if before.was_bad and state.mode in ON_BRAKES:
        faults |= Fault.BRAKE
    if DriveState.FAULT in state.drives and drive_mode(state.mode) is not DriveMode.OFF:
        faults |= Fault.DRIVE
    mode = leads(state.mode, faults) if faults else state.mode
    moves = mode in ON_BRAKES and not all(state.good)
    for drives in obeyed(state.drives, drive_mode(mode)):
        after = State(mode, state.faults | faults | found, drives, state.good, was_bad=moves)
        yield Step(before, operator, faults | found, after)


@pytest.fixture(scope="module")
def every() -> list[Step]:
    """Every step from every reachable state."""
    seen, front, all_steps = {START}, [START], []
    while front:
        for step in set(steps(front.pop())):
            all_steps.append(step)
            if step.after not in seen:
                seen.add(step.after)
                front.append(step.after)
    return all_steps


def test_exhaustive_model_of_brakes_drives_and_operator_reaches_every_mode(every):
    assert {step.after.mode for step in every} == set(Mode)
    assert len({step.after for step in every}) > 500


def test_force_is_removed_only_in_a_brake_test_estop_bus_failure_or_operator_release(every):
    """Emergency stop, bus failure, the operator's release: no other fault drops the platform."""
    lost = Fault.ESTOP | Fault.BUS
    for step in every:
        if step.before.mode not in FORCED or step.after.mode in FORCED:
            continue
        tested = step.before.mode in {Mode.PARKING, Mode.HELD} and step.after.mode is Mode.UNLOADING
        released = step.before.mode is Mode.HELD and step.operator is Operator.RELEASE
        powerless = all(state is DriveState.FAULT for state in step.before.drives)
        assert tested or released or powerless or step.found & lost, step


def test_force_returns_one_step_after_a_leg_moved_on_its_closed_brake(every):
    for step in every:
        if step.before.was_bad:
            lost = step.found & (Fault.ESTOP | Fault.BUS)
            braked = step.after.mode in FORCED or step.after.mode is Mode.FAULT
            assert braked, step
            if step.after.mode is Mode.FAULT:
                opening = step.before.mode is Mode.LOADING and not step.found & Fault.BRAKE
                assert lost or opening, step


def test_platform_on_a_failed_brake_stays_parked_without_force_for_at_most_one_step(every):
    for step in every:
        if step.before.mode is Mode.PARKED and step.after.mode is Mode.PARKED:
            assert not step.before.was_bad


def test_emergency_stop_acts_in_every_reachable_state(every):
    for step in every:
        if step.operator is Operator.ESTOP:
            assert step.after.mode is Mode.FAULT
            assert step.after.faults & Fault.ESTOP


def test_fault_is_cleared_only_by_a_reset_while_the_force_is_off(every):
    for step in every:
        if step.before.faults & ~step.after.faults:
            assert step.operator is Operator.RESET
            assert step.before.mode in {Mode.FAULT, Mode.WAITING}
        assert step.found in step.after.faults


def test_brakes_open_only_after_the_operators_arm_command(every):
    """From IDLE only ENGAGE leads to LOADING, and no other mode leads to an open brake."""
    for step in every:
        if step.after.mode in MOVING and step.before.mode not in MOVING:
            assert step.before.mode is Mode.LOADING
        if step.after.mode is Mode.LOADING and step.before.mode is not Mode.LOADING:
            assert step.before.mode is Mode.IDLE
            assert step.operator is Operator.ENGAGE
