"""What the operator's word asks of the motion, call by call, on a motion that is only told."""

from __future__ import annotations

from itertools import product
from types import SimpleNamespace
from typing import Any

import pytest

from drivers.signals import Mode
from hil.loop.operating import Operating
from hil.signals import Operator, Order
from tests.hil.test_operating import HOLD, KEY, PARK, START, made

PATH, JOG = object(), object()


class Told:
    """A motion in a state that a test names; it keeps what it is asked for."""

    def __init__(self, **state: Any) -> None:
        self.away = self.resting = False
        self.trajectory, self.left = PATH, None
        self.ended = False
        vars(self).update(state)
        self.calls: list[tuple[Any, ...]] = []

    def finished(self, tick: int) -> bool:
        assert tick == 9
        return self.ended

    def advance(self, tick: int) -> None:
        self.calls.append(("advance", tick))

    def settle(self, tick: int, speed: float) -> None:
        self.calls.append(("settle", tick, speed))

    def aim(self, tick: int, speed: float, *, go: bool) -> None:
        self.calls.append(("aim", tick, speed, go))

    def resume(self, tick: int) -> None:
        self.calls.append(("resume", tick))


def operated(
    *orders: Order,
    mode: Mode = Mode.TRACKING,
    motion: Told,
    stops: str = "",
    order_refused: bool = False,
    **state: Any,
) -> Operating:
    """Return the operator's word after a tick, 9, with a state of its own before."""
    operating: Operating = made()[0]

    def take(order: Order, tick: int, _motion: Told, *, on_hold: bool, key: bool) -> str:
        motion.calls.append(("take", order.numbers, tick, on_hold, key))
        return "say hold" if order_refused else ""

    jogging = SimpleNamespace(
        refusal=stops,
        take=take,
        let_go=lambda: motion.calls.append(("let_go",)),
        step=lambda tick, _motion, *, key: motion.calls.append(("jog", tick, key)),
    )
    vars(operating).update(jogging=jogging, **state)
    operating.step(orders, 9, mode, motion)  # type: ignore[arg-type]
    return operating


@pytest.mark.parametrize("mode", [Mode.APPROACH, Mode.TRACKING, Mode.STOPPING, Mode.PARKING])
def test_a_motion_that_has_ended_on_hold_stands_at_its_end_in_time_too(mode):
    for go, parks, away, ended in product([False, True], repeat=4):
        motion = Told(away=away, ended=ended)
        operated(mode=mode, motion=motion, go=go, parks=parks)
        on_hold = not go and (mode is Mode.TRACKING or (mode is Mode.STOPPING and parks))
        assert motion.calls[0] == ("advance", 9)
        assert (("settle", 9, 0.0) in motion.calls) == (on_hold and ended and not away)


def test_without_orders_and_without_a_key_the_motion_on_its_path_is_left_alone_and_answers_are_forgotten():
    motion = Told()
    operating = operated(motion=motion, answers=["refused"])
    assert motion.calls == [("advance", 9)]
    assert operating.answers == []


@pytest.mark.parametrize(
    ("more", "away"), [({"patience": 5, "key_tick": 9}, False), ({}, True)], ids=["key", "away"]
)
def test_where_a_key_is_needed_or_a_path_was_left_each_tick_is_aimed(more, away):
    motion = Told(away=away)
    operated(motion=motion, speed=0.4, **more)
    assert motion.calls[-1] == ("aim", 9, 0.4, not away)


@pytest.mark.parametrize("mode", Mode)
def test_an_order_is_answered_in_every_mode_and_aims_the_motion_only_where_the_operator_moves_it(mode):
    motion = Told()
    operating = operated(KEY, HOLD, mode=mode, motion=motion)
    assert [bool(answer) for answer in operating.answers] == [
        False,
        mode not in {Mode.APPROACH, Mode.TRACKING},
    ]
    aimed = ("aim", 9, 1.0, False)
    assert (aimed in motion.calls) == (mode in {Mode.APPROACH, Mode.TRACKING})


@pytest.mark.parametrize(
    ("mode", "order", "jogs"),
    [
        (Mode.TRACKING, HOLD, True),
        (Mode.TRACKING, KEY, False),
        (Mode.TRACKING, PARK, False),
        (Mode.APPROACH, HOLD, False),
        (Mode.STOPPING, HOLD, False),
    ],
)
def test_a_jog_goes_on_only_on_hold_on_the_path(mode, order, jogs):
    motion = Told()
    operated(order, mode=mode, motion=motion)
    assert (("jog", 9, True) in motion.calls) == jogs


@pytest.mark.parametrize(("parks", "go"), [(False, True), (True, True), (False, False), (True, False)])
def test_the_way_back_after_a_jog_begins_with_start_and_not_on_hold_or_before_park(parks, go):
    motion = Told(away=True, ended=True)
    operated(motion=motion, go=go, parks=parks)
    returns = go and not parks
    assert (("let_go",) in motion.calls) == returns
    assert (("resume", 9) in motion.calls) == returns


@pytest.mark.parametrize(
    ("mode", "parks", "trajectory", "go"),
    [
        (Mode.TRACKING, False, PATH, True),
        (Mode.TRACKING, True, PATH, False),
        (Mode.APPROACH, True, PATH, False),
        (Mode.STOPPING, True, PATH, True),
    ],
)
def test_before_the_way_to_the_first_pose_the_platform_comes_to_rest_and_on_that_way_it_goes(
    mode, parks, trajectory, go
):
    motion = Told(trajectory=trajectory)
    operated(Order(Operator.SPEED, (0.3,)), mode=mode, motion=motion, parks=parks)
    assert motion.calls[-1] == ("aim", 9, 0.3, go)


@pytest.mark.parametrize(("trajectory", "go"), [(JOG, False), (PATH, True)])
def test_away_from_the_path_a_jog_comes_to_rest_and_the_way_back_goes_on(trajectory, go):
    motion = Told(away=True, trajectory=trajectory)
    operated(motion=motion, _way_back=PATH)
    assert motion.calls[-1] == ("aim", 9, 1.0, go)


@pytest.mark.parametrize(("order", "go", "parks"), [(START, True, True), (HOLD, False, True)])
def test_on_the_way_to_the_first_pose_it_is_held_and_started_and_it_parks_all_the_same(order, go, parks):
    operating = operated(order, mode=Mode.STOPPING, motion=Told(), parks=True, go=not go)
    assert operating.answers == [""]
    assert (operating.go, operating.parks) == (go, parks)


@pytest.mark.parametrize(
    ("stops", "refused", "answers"),
    [
        ("", False, ["", "", ""]),
        ("a limit is ahead", False, ["", "a limit is ahead", ""]),
        ("a limit is ahead", True, ["", "say hold", ""]),
    ],
)
def test_where_a_limit_stops_a_jog_its_word_is_refused_unless_it_was_refused_before(stops, refused, answers):
    jog = Order(Operator.JOG, (0.0, 1.0))
    said = operated(HOLD, jog, KEY, motion=Told(), stops=stops, order_refused=refused)
    assert said.answers == answers


@pytest.mark.parametrize("key", [False, True])
@pytest.mark.parametrize("go", [False, True])
@pytest.mark.parametrize("mode", [Mode.APPROACH, Mode.TRACKING, Mode.STOPPING, Mode.PARKED])
def test_a_jogs_word_is_told_whether_the_path_is_on_hold_and_the_key_held(mode, go, key):
    motion = Told()
    jog = Order(Operator.JOG, (2.0, -0.5))
    operated(jog, mode=mode, motion=motion, go=go, patience=5, key_tick=9 if key else None)
    on_hold = mode is Mode.TRACKING and not go
    assert motion.calls[1] == ("take", (2.0, -0.5), 9, on_hold, key)


@pytest.mark.parametrize("start", ["automatic", "asked"])
@pytest.mark.parametrize("mode", [Mode.TRACKING, Mode.STOPPING])
def test_a_path_begins_by_itself_or_is_asked_for_and_a_way_back_needs_no_new_word(mode, start):
    for go, parks, key in product([False, True], repeat=3):
        operating, motion = made(deadman_s=0.05, start=start)[0], Told()
        operating.go, operating.parks, operating.speed = go, parks, 0.4
        operating.key_tick = 9 if key else None
        operating.enter(mode, 9, motion)
        goes = go and (mode is Mode.STOPPING or (key and (parks or start == "automatic")))
        waits = parks and mode is Mode.TRACKING
        assert operating.go == goes
        rest = [("settle", 9, 0.0)] if parks or not goes else []
        assert motion.calls == [*rest, ("aim", 9, 0.4, goes and not waits)]


@pytest.mark.parametrize("key", [True, False])
def test_a_new_motion_goes_on_with_the_key_alone_and_remembers_no_way_of_the_one_before(key):
    operating: Any = made(deadman_s=0.05)[0]
    motion: Any = Told()
    operating.key_tick, operating.speed, operating.parks = 9 if key else None, 0.4, True
    operating._inspection = operating._way_back = operating.trouble = "of the motion before"
    operating.engage(9, motion)
    assert (operating.go, operating.parks, operating.trouble) == (key, False, "")
    assert operating._inspection is None
    assert motion.calls == [("settle", 9, 0.4 if key else 0.0)]
