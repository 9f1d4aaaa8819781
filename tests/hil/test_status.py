"""What a controller says of itself: each figure in the unit of its name, and what it waits for."""

import json
from types import SimpleNamespace

import numpy as np
import pytest

from drivers.signals import NEVER, Fault, Mode
from hil.contracts.records import record_of
from hil.loop.console import status_text, waits_for
from hil.loop.operating import NO_KEY


def course(
    mode=Mode.TRACKING, *, go=True, key=True, left=None, speed=0.6, trouble="", goes_on=False, **measured
):
    """A run on its way: 250 ticks, 0.25 s of a path of 8 s, at 30 % of the speed and slowing down."""
    quarter = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    pose = {"tick": 250, "age": 0, "p": np.array([0.1, -0.2, 0.5]), "R": quarter, "q": np.arange(1.0, 7.0)}
    operating = SimpleNamespace(
        speed=speed,
        patience=100,
        go=go,
        trouble=trouble,
        holds_key=lambda tick: key and tick == 250,
        moves=lambda mode: mode in {Mode.APPROACH, Mode.TRACKING},
    )
    motion = SimpleNamespace(
        left=left, away=left is not None, override=SimpleNamespace(sigma=0.3), time=lambda tick: tick * 1e-3
    )
    cycle = SimpleNamespace(
        mode=mode,
        faults=Fault.NONE,
        tick=record_of(**(pose | measured)),
        operating=operating,
        motion=motion,
        parts=SimpleNamespace(trajectory=SimpleNamespace(duration_s=8.0)),
    )
    return SimpleNamespace(cycle=cycle, goes_on=goes_on)


def status(*args, **kwargs):
    return json.loads(status_text(course(*args, **kwargs), 3))


def test_each_figure_is_in_the_unit_that_its_key_names():
    said = status()
    assert said["tick"] == 250
    assert (said["speed_percent"], said["speed_now_percent"]) == (60.0, 30.0)
    assert said["position_m"] == [0.1, -0.2, 0.5]
    assert said["rotation_vector_deg"] == pytest.approx([0.0, 0.0, 90.0])
    assert said["leg_lengths_m"] == [1.0, 2.0, 3.0, 4.0, 5.0, 6.0]
    assert (said["path_s"], said["path_length_s"]) == (0.25, 8.0)
    assert said["refused_lines"] == 3
    assert (said["mode"], said["faults"], said["held"], said["key"]) == ("TRACKING", [], False, "held")


def test_the_place_on_a_path_that_a_jog_has_left_is_where_it_was_left():
    assert status(left=(None, 1.5))["path_s"] == 1.5
    assert status(Mode.APPROACH)["path_s"] is None


def test_legs_that_were_not_all_heard_have_no_lengths_and_a_pose_unknown_is_none():
    assert status(age=np.array([0, 0, 0, 0, 0, NEVER]))["leg_lengths_m"] is None
    said = status(p=np.full(3, np.nan), R=np.full((3, 3), np.nan))
    assert said["position_m"] is None
    assert said["rotation_vector_deg"] is None


@pytest.mark.parametrize("value", [np.nan, np.inf])
@pytest.mark.parametrize("turn", [np.eye(3), np.diag([1.0, -1.0, -1.0]), np.diag([-1.0, -1.0, 1.0])])
def test_a_rotation_of_which_one_entry_is_no_number_is_unknown(value, turn):
    for entry in np.ndindex(3, 3):
        broken = turn.copy()
        broken[entry] = value
        said = status(R=broken)
        assert said["rotation_vector_deg"] is None
        assert said["position_m"] == [0.1, -0.2, 0.5]


@pytest.mark.parametrize(
    ("given", "text"),
    [
        ({}, ""),
        ({"speed": 0.0}, "a speed above 0 %"),
        ({"go": False, "key": False}, NO_KEY),
        ({"go": False, "key": False, "trouble": "leg 3 is too long"}, NO_KEY),
        ({"go": False}, "start"),
        ({"go": False, "left": (None, 1.5)}, "start, which first goes back to where the path was left"),
        ({"go": False, "trouble": "leg 3 is too long"}, "another order: leg 3 is too long"),
        ({"mode": Mode.IDLE, "go": False}, "arm: all six drives are ready"),
        ({"mode": Mode.FAULT, "goes_on": True}, "reset, then arm"),
        ({"mode": Mode.PARKED, "goes_on": True}, "reset, then arm"),
        ({"mode": Mode.FAULT}, ""),
        ({"mode": Mode.PARKED}, ""),
        ({"mode": Mode.PARKING, "go": False}, ""),
        ({"mode": Mode.PARKING, "speed": 0.0}, ""),
        ({"mode": Mode.APPROACH, "go": False}, "start"),
        ({"mode": Mode.APPROACH, "speed": 0.0}, "a speed above 0 %"),
        ({"go": False, "speed": 0.0}, "start"),
        ({"speed": 0.001}, ""),
        ({"mode": Mode.TRACKING, "goes_on": True}, ""),
        ({"mode": Mode.HELD}, "release, once the platform is supported: not all brakes are proven shut"),
    ],
)
def test_what_the_operator_could_do_next_is_said(given, text):
    assert waits_for(course(**given)) == text


def test_while_the_drives_are_waited_for_it_is_said_which_lack_what(monkeypatch):
    monkeypatch.setattr(
        "hil.loop.console.waiting_text", lambda cycle: f"{cycle.mode.name}: drive 3 is silent"
    )
    assert waits_for(course(Mode.WAITING, go=False)) == "WAITING: drive 3 is silent"


@pytest.mark.parametrize(
    ("faults", "names"), [(Fault.STALE | Fault.BRAKE, ["STALE", "BRAKE"]), (Fault.ESTOP, ["ESTOP"])]
)
def test_each_fault_that_is_latched_is_named_and_no_other(faults, names):
    of = course(Mode.FAULT)
    of.cycle.faults = faults
    assert sorted(json.loads(status_text(of, 0))["faults"]) == sorted(names)


@pytest.mark.parametrize("key", [True, False])
def test_a_key_that_no_setting_asks_for_is_not_needed(key):
    of = course(key=key)
    of.cycle.operating.patience = None
    assert json.loads(status_text(of, 0))["key"] == "not needed"


@pytest.mark.parametrize("leg", range(6))
def test_one_leg_that_was_never_heard_leaves_all_lengths_unknown(leg):
    age = np.where(np.arange(6) == leg, NEVER, NEVER - 1)
    assert status(age=age)["leg_lengths_m"] is None
    assert status(age=NEVER - 1)["leg_lengths_m"] == [1.0, 2.0, 3.0, 4.0, 5.0, 6.0]


def test_a_platform_on_hold_is_held_only_where_it_could_move():
    assert status(go=False)["held"] is True
    assert status(go=False, key=False)["key"] == "missing"
    assert status(Mode.PARKED, go=False)["held"] is False
