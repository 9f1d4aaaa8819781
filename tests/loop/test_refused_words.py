"""In a simulation words count where they do at a robot: which are refused, and that these change nothing."""

from types import SimpleNamespace
from typing import Any

from drivers.signals import DriveState, Fault, Mode
from hil.app.sim.lockstep import Lockstep
from hil.loop.tick_row import NOTHING, Given
from hil.signals import Operator
from tests.loop.test_run_end import cycle, states

COURSE: list[tuple[Mode, Operator | None, bool]] = [
    (Mode.TRACKING, Operator.RELEASE, False),
    (Mode.HELD, Operator.RELEASE, False),  # it was said before anybody could know
    (Mode.HELD, Operator.RELEASE, True),
    (Mode.FAULT, Operator.RELEASE, False),
    (Mode.FAULT, Operator.RESET, True),
    (Mode.WAITING, Operator.ENGAGE, False),
    (Mode.IDLE, None, True),
    (Mode.IDLE, Operator.ENGAGE, True),
    (Mode.LOADING, Operator.ENGAGE, False),
    (Mode.PARKED, Operator.RESET, True),
    (Mode.PARKED, Operator.END, True),
    (Mode.PARKED, Operator.RESET, False),
]
"""By tick: the mode, what is said, and whether it is taken."""


def test_each_word_of_a_script_is_judged_in_its_mode_and_one_that_is_refused_is_not_given():
    now: Any = cycle(Mode.WAITING, drive_state=states(DriveState.BOOT))
    now.parts.operator, now.parts.steering = SimpleNamespace(stays=True), None
    now.operating.answers = []
    given: list[Any] = []
    answers: list[tuple[Any, ...]] = []

    def commands(tick: int) -> Given:
        if tick >= len(COURSE):
            return NOTHING
        now.mode, word, _ = COURSE[tick]
        now.faults = Fault.ESTOP if now.mode in {Mode.HELD, Mode.FAULT} else Fault.NONE
        now.mode_tick = tick
        return Given(() if word is None else (word,))

    def step(operator: Any, _setpoints: Any, _orders: Any) -> tuple[None, None, None]:
        given.append(operator)
        bench.tick += 1
        return None, None, None

    bench: Any = SimpleNamespace(cycle=now, tick=-1, step=step)
    Lockstep.run(
        bench, None, lambda *_: None, commands=commands, armed=False,
        answered=lambda *each: answers.append(each),
    )  # fmt: skip
    words = [(word, taken) for _, word, taken in COURSE if word is not None]
    assert [not why for (why,), _, _ in answers] == [taken for _, taken in words]
    said = [each for tick in given for each in tick if each is not Operator.STOP]
    assert said == [word for word, taken in words if taken]
