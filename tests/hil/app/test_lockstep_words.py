"""Which words of the operator reach the controller of a simulation, and what is answered to the others."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import pytest

from drivers.errors import PlantError
from drivers.signals import Mode
from hil.app.sim import lockstep as kernel
from hil.app.sim.lockstep import Lockstep
from hil.loop.tick_row import NOTHING, Given
from hil.signals import Operator, Order

PARKING = (Operator.STOP,)
"""What is said where the operator has left the run alone."""
ORDER = Order(Operator.JOG, (1.0,))


class Bench:
    """A lockstep whose both ends do nothing but be in a given mode in each tick. State: what was said."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch, modes: list[Mode], fails_at: int = -1) -> None:
        self.heard: list[tuple[Operator, ...]] = []
        self.stepped: list[tuple[Any, ...]] = []
        self.answers: list[tuple[list[str], list[str], list[str]]] = []
        cycle: Any = SimpleNamespace(
            mode=modes[0],
            parts=SimpleNamespace(operator=SimpleNamespace(stays=True), steering=None),
            operating=SimpleNamespace(answers=["of the order"]),
        )

        def commands(_tick: int, given: tuple[Operator, ...]) -> tuple[Operator, ...]:
            self.heard.append(given)
            return given

        course = SimpleNamespace(
            goes_on=True, commands=commands, left_alone=lambda: PARKING,
            ending=lambda tick: f"ended in {tick}" if tick == len(modes) - 1 else None,
            failed=lambda why, tick: f"{why} in {tick}",
        )  # fmt: skip
        monkeypatch.setattr(kernel, "Course", lambda *_, **__: course)

        def step(operator: Any, setpoints: Any, orders: Any) -> tuple[Any, ...]:
            self.lockstep.tick += 1
            if self.lockstep.tick == fails_at:
                raise PlantError("the model is gone")
            self.stepped.append((operator, setpoints, orders))
            cycle.mode = modes[min(self.lockstep.tick + 1, len(modes) - 1)]
            return None, (), None

        self.lockstep = object.__new__(Lockstep)
        self.lockstep.tick, self.lockstep.cycle = -1, cycle
        self.lockstep.step = step  # type: ignore[method-assign,assignment]

    def run(self, said: dict[int, Given], over_from: int = 1000) -> Any:
        return self.lockstep.run(
            None,
            lambda *_: None,
            commands=lambda tick: said.get(tick, NOTHING),
            over=lambda: self.lockstep.tick + 1 >= over_from,
            answered=lambda *each: self.answers.append(each),
        )


@pytest.mark.parametrize("first", range(4))
def test_a_platform_that_has_just_come_to_be_held_is_released_from_its_second_tick_on_and_in_no_other(
    monkeypatch: pytest.MonkeyPatch, first: int
) -> None:
    modes = [Mode.FAULT] * first + [Mode.HELD] * 3 + [Mode.FAULT] * 2
    bench = Bench(monkeypatch, modes)
    bench.run(dict.fromkeys(range(len(modes)), Given((Operator.RELEASE,))))
    released = [tick for tick, each in enumerate(bench.heard) if each == (Operator.RELEASE,)]
    assert released == [first + 1, first + 2]
    assert [tick for tick, each in enumerate(bench.heard) if each == ()] == [
        tick for tick in range(len(modes)) if tick not in released
    ]
    refused = [
        tick for tick, (words, _, _) in enumerate(bench.answers) if words[0].startswith("nothing is held")
    ]
    assert refused == [tick for tick in range(len(modes)) if tick not in released]


def test_of_several_words_of_a_tick_those_that_are_refused_stay_behind_and_each_has_its_answer(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    bench = Bench(monkeypatch, [Mode.TRACKING] * 2)
    bench.run({0: Given((Operator.ENGAGE, Operator.STOP, Operator.RESET), (ORDER,))})
    assert bench.heard == [(Operator.STOP,), ()]
    assert bench.stepped == [((Operator.STOP,), (), (ORDER,)), ((), (), ())]
    ((words, orders, setpoints),) = bench.answers
    assert [bool(why) for why in words] == [True, False, True]
    assert (orders, setpoints) == (["of the order"], [])


@pytest.mark.parametrize(
    ("given", "heard"),
    [(NOTHING, PARKING), (Given((Operator.START,)), (Operator.START,)), (Given((), (ORDER,)), ())],
)
def test_a_run_is_left_alone_once_all_was_said_and_in_no_tick_in_which_something_is(
    monkeypatch: pytest.MonkeyPatch, given: Given, heard: tuple[Operator, ...]
) -> None:
    bench = Bench(monkeypatch, [Mode.TRACKING] * 4)
    bench.run({2: given}, over_from=2)
    assert bench.heard == [(), (), heard, PARKING]


def test_a_simulation_ends_with_its_plant_in_the_tick_in_which_that_fails(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    assert Bench(monkeypatch, [Mode.TRACKING] * 4, fails_at=2).run({}) == "the model is gone in 2"
    assert Bench(monkeypatch, [Mode.TRACKING] * 4).run({}) == "ended in 3"
