"""What the operator's word asks of the motion, on a motion that only keeps the calls."""

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
TICK = 9


class Kept:
    """A motion in a state that a test gives it; it keeps what it is asked for."""

    def __init__(self, **state: Any) -> None:
        self.away = self.resting = False
        self.trajectory, self.left = PATH, None
        self.ended = False
        vars(self).update(state)
        self.calls: list[tuple[Any, ...]] = []

    def finished(self, tick: int) -> bool:
        assert tick == TICK
        return self.ended

    def advance(self, tick: int) -> None:
        assert tick == TICK
        assert not self.calls

    def settle(self, tick: int, speed: float) -> None:
        self.calls.append(("settle", tick, speed))

    def aim(self, tick: int, speed: float, *, go: bool) -> None:
        self.calls.append(("aim", tick, speed, go))

    def resume(self, tick: int) -> None:
        self.calls.append(("resume", tick))


def operated(*orders: Order, mode: Mode = Mode.TRACKING, motion: Kept, **state: Any) -> Operating:
    """Return the operator's word after a tick, with a state of its own before."""
    operating: Operating = made()[0]

    def take(order: Order, tick: int, _motion: Kept, *, on_hold: bool, key: bool) -> str:
        motion.calls.append(("take", order.numbers, tick, on_hold, key))
        return ""

    jogging = SimpleNamespace(
        refusal="",
        take=take,
        let_go=lambda: motion.calls.append(("let go",)),
        step=lambda tick, _motion, *, key: motion.calls.append(("jog", tick, key)),
    )
    vars(operating).update(jogging=jogging, **state)
    operating.step(orders, TICK, mode, motion)  # type: ignore[arg-type]
    return operating


def aimed(*, go: bool, speed: float = 1.0) -> tuple[Any, ...]:
    return "aim", TICK, speed, go


JOGS, LET_GO, RESUMED = ("jog", TICK, True), ("let go",), ("resume", TICK)
SLOW = Order(Operator.SPEED, (0.3,))


@pytest.mark.parametrize(
    ("mode", "orders", "motion", "word", "calls"),
    [
        # left alone without orders; aimed in each tick where a key is needed
        (Mode.TRACKING, (), {}, {}, []),
        (Mode.TRACKING, (), {}, {"patience": 5, "key_tick": 9, "speed": 0.4}, [aimed(go=True, speed=0.4)]),
        # a jog goes on only on hold on the path
        (Mode.TRACKING, (HOLD,), {}, {}, [aimed(go=False), JOGS]),
        (Mode.TRACKING, (KEY,), {}, {}, [aimed(go=True)]),
        (Mode.APPROACH, (HOLD,), {}, {}, [aimed(go=False)]),
        (Mode.STOPPING, (HOLD,), {}, {}, []),
        # before the way to the first pose it comes to rest, and on that way it goes
        (Mode.TRACKING, (PARK,), {}, {}, [aimed(go=False)]),
        (Mode.TRACKING, (SLOW,), {}, {"parks": True}, [aimed(go=False, speed=0.3)]),
        (Mode.APPROACH, (SLOW,), {}, {"parks": True}, [aimed(go=False, speed=0.3)]),
        (Mode.STOPPING, (SLOW,), {}, {"parks": True}, [aimed(go=True, speed=0.3)]),
        # away from the path a jog comes to rest, and the way back goes on and ends
        (Mode.TRACKING, (), {"away": True, "trajectory": JOG}, {}, [LET_GO, aimed(go=False)]),
        (Mode.TRACKING, (), {"away": True}, {"_way_back": PATH}, [LET_GO, aimed(go=True)]),
        (Mode.TRACKING, (), {"away": True, "ended": True}, {}, [LET_GO, RESUMED, aimed(go=False)]),
        (Mode.TRACKING, (), {"away": True, "ended": True}, {"parks": True}, [aimed(go=False)]),
        (Mode.TRACKING, (), {"away": True, "ended": True}, {"go": False}, [aimed(go=False), JOGS]),
    ],
)
def test_orders_and_state_decide_how_the_motion_goes_on(mode, orders, motion, word, calls):
    kept = Kept(**motion)
    operating = operated(*orders, mode=mode, motion=kept, answers=["refused"], **word)
    assert kept.calls == calls
    assert len(operating.answers) == len(orders), "those of the tick before are forgotten"


@pytest.mark.parametrize("mode", [Mode.APPROACH, Mode.TRACKING, Mode.STOPPING, Mode.PARKING])
def test_a_motion_that_has_ended_on_hold_stands_at_its_end_in_time_too(mode):
    for go, parks, away, ended in product([False, True], repeat=4):
        motion = Kept(away=away, ended=ended)
        operated(mode=mode, motion=motion, go=go, parks=parks)
        on_hold = not go and (mode is Mode.TRACKING or (mode is Mode.STOPPING and parks))
        assert (("settle", TICK, 0.0) in motion.calls) == (on_hold and ended and not away)


@pytest.mark.parametrize("mode", Mode)
def test_an_order_is_answered_in_every_mode_and_aims_only_where_the_operator_moves(mode):
    motion = Kept()
    operating = operated(KEY, HOLD, mode=mode, motion=motion)
    moves = mode in {Mode.APPROACH, Mode.TRACKING}
    assert [bool(answer) for answer in operating.answers] == [False, not moves]
    assert (aimed(go=False) in motion.calls) == moves


@pytest.mark.parametrize(("order", "go"), [(START, True), (HOLD, False)])
def test_on_the_way_to_the_first_pose_it_is_held_and_started_and_parks_all_the_same(order, go):
    operating = operated(order, mode=Mode.STOPPING, motion=Kept(), parks=True, go=not go)
    assert operating.answers == [""]
    assert (operating.go, operating.parks) == (go, True)


@pytest.mark.parametrize("key", [False, True])
@pytest.mark.parametrize("go", [False, True])
@pytest.mark.parametrize("mode", [Mode.APPROACH, Mode.TRACKING, Mode.STOPPING, Mode.PARKED])
def test_a_jogs_word_counts_with_the_path_on_hold_and_the_key_held(mode, go, key):
    motion = Kept()
    jog = Order(Operator.JOG, (2.0, -0.5))
    operated(jog, mode=mode, motion=motion, go=go, patience=5, key_tick=TICK if key else None)
    on_hold = mode is Mode.TRACKING and not go
    assert motion.calls[0] == ("take", (2.0, -0.5), TICK, on_hold, key)


@pytest.mark.parametrize("start", ["automatic", "asked"])
@pytest.mark.parametrize("mode", [Mode.TRACKING, Mode.STOPPING])
def test_a_path_begins_by_itself_or_on_request_and_a_way_back_needs_no_new_word(mode, start):
    for go, parks, key in product([False, True], repeat=3):
        operating: Any = made(deadman_s=0.05, start=start)[0]
        motion: Any = Kept()
        operating.go, operating.parks, operating.speed = go, parks, 0.4
        operating.key_tick = TICK if key else None
        operating.enter(mode, TICK, motion)
        goes = go and (mode is Mode.STOPPING or (key and (parks or start == "automatic")))
        waits = parks and mode is Mode.TRACKING
        assert operating.go == goes
        rest = [("settle", TICK, 0.0)] if parks or not goes else []
        assert motion.calls == [*rest, aimed(go=goes and not waits, speed=0.4)]


@pytest.mark.parametrize("key", [True, False])
def test_a_new_motion_goes_on_with_the_key_alone_and_forgets_the_one_before(key):
    operating: Any = made(deadman_s=0.05)[0]
    motion: Any = Kept()
    operating.key_tick, operating.speed, operating.parks = TICK if key else None, 0.4, True
    operating._inspection = operating._way_back = operating.trouble = "of the motion before"
    operating.engage(TICK, motion)
    assert (operating.go, operating.parks, operating.trouble) == (key, False, "")
    assert operating._inspection is operating._way_back is None
    assert motion.calls == [("settle", TICK, 0.4 if key else 0.0)]
