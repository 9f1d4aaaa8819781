"""Both ends of the buses in one process, in simulated time, over the same bus arithmetic as the virtual bus.

A frame takes its worst-case bit time and the lowest identifier wins.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from drivers.arrays import Rows
from drivers.can.bus_time import BitTiming
from drivers.ends import hearing
from drivers.errors import PlantError
from drivers.frame_array import FRAME
from drivers.signals import LEGS, BusState, Mode
from hil.app.sim.wire_kernels import answer, begin, command, heard_by, pass_on
from hil.app.sim.wires import COMMANDS, LATCH, SKEW, STEP, SYNCED, TAKEN, Wires
from hil.loop.console import refusal, setpoint_refusals
from hil.loop.cycle import Cycle
from hil.loop.run_end import Course, Ending
from hil.loop.story.narrator import EventSink, no_event
from hil.signals import Operator, Order, SetPoint, TickInput, TickOutput
from plant_fmu.drives.nodes import Nodes

Observer = Callable[[TickInput, Rows, TickOutput], None]
"""Called after every tick with its input, the opening frames and the output."""

COMPUTE_US = 60.0
"""Simulated time from the last feedback to the command's entry into the bus."""
REST_S = 0.1
"""A reference that has stood still for so long in TRACKING is at rest: HOLD, as faults call it."""


class Given(NamedTuple):
    """What the operator gives in a tick."""

    operator: tuple[Operator, ...] = ()
    orders: tuple[Order, ...] = ()
    setpoints: tuple[SetPoint, ...] = ()


NOTHING = Given()


def nothing_given(tick: int) -> Given:
    """Return the commands of a tick where there are none."""
    del tick
    return NOTHING


def nobody_answered(operator: Sequence[str], orders: Sequence[str], setpoints: Sequence[str]) -> None:
    """Take what became of a tick's commands where nobody asks."""


@dataclass
class Lockstep:
    """The buses between a Cycle and Nodes, and the time that both share.

    The faults of the nodes that wait for a mode are told when it is reached.

    Mutable state: the wires, the tick, the last mode and since when the reference rests; and the controller
    and the nodes themselves. One run per instance.
    """

    cycle: Cycle
    nodes: Nodes
    timing: BitTiming | None
    """None is the ideal bus: no frame takes time, the force acts at the instant of the measurement."""
    feedback_window_s: float
    compute_us: float = COMPUTE_US
    tick: int = -1
    """The last one; both ends begin with the next."""
    timings: tuple[BitTiming, ...] = ()
    """Of each bus, where there are several; not used where `timing` is None, which is layout ideal."""
    _mode: Mode = Mode.WAITING
    _rests: int = 0
    """How many ticks in a row the reference has stood still in TRACKING."""

    def __post_init__(self) -> None:
        self.period_ns = round(1e9 / self.cycle.parts.rate_Hz)
        self.window_ns = round(self.feedback_window_s * 1e9)
        self.compute_ns = round(self.compute_us * 1e3) if self.timing else 0
        several = self.timings or (self.timing,)
        protocol = self.cycle.parts.protocol
        self.wires = Wires([each if self.timing else None for each in several], hearing(protocol))
        self._all_buses = (1 << len(several)) - 1
        self._unasked = protocol.unasked_s > 0.0
        self.nodes.start((self.tick + 1) * self.period_ns)

    def step(
        self,
        operator: tuple[Operator, ...] = (),
        setpoints: tuple[SetPoint, ...] = (),
        orders: tuple[Order, ...] = (),
    ) -> tuple[TickInput, Rows, TickOutput]:
        """Advance both ends by one tick."""
        self.tick = tick = self.tick + 1
        wires, words, t_ns = self.wires, self.wires.words, tick * self.period_ns
        opening = self.cycle.begin(tick)
        heard = self._exchange(t_ns, opening)
        off = self.nodes.bus_off & self._all_buses
        inp = TickInput(
            tick,
            t_ns,
            frames=heard,
            sync_skew_ns=words[SKEW],
            bus_off=off,
            bus_state=BusState.OFF if off else BusState.UNKNOWN,
            operator=operator,
            latch_ns=tuple(words[LATCH : LATCH + LEGS]),
            setpoints=setpoints,
            orders=orders,
        )
        out = self.cycle.step(inp)
        if self.nodes.waiting:
            self._report_mode()
        done_ns, until_ns = words[STEP] + self.compute_ns, t_ns + self.period_ns - 1
        while status := command(wires.record, out.frames, done_ns, until_ns):
            wires.settle(status, out.frames)
        return inp, opening, out

    def _report_mode(self) -> None:
        """Let the time of the faults count that wait for the controller's mode."""
        cycle = self.cycle
        mode = cycle.mode
        if mode is not self._mode:
            self._mode = mode
            self.nodes.reached(mode.name)
        resting = mode is Mode.TRACKING and not cycle.tick["dq_d"].any()
        self._rests = self._rests + 1 if resting else 0
        if self._rests == round(REST_S * cycle.parts.rate_Hz):
            self.nodes.reached("HOLD")

    def _exchange(self, t_ns: int, opening: Rows) -> Rows:
        """Let SYNC reach the drives and their answers the controller; return what it hears."""
        wires, words = self.wires, self.wires.words
        deadline_ns = t_ns + self.window_ns
        if self._unasked:
            self._pass_time(t_ns)
        while status := begin(wires.record, opening, t_ns, deadline_ns):
            wires.settle(status, opening)
        replies = self.nodes.advance(words[SYNCED], wires.commands[: words[COMMANDS]])
        while status := answer(wires.record, replies, self.tick, t_ns, deadline_ns):
            wires.settle(status, replies)
        return np.frombuffer(wires.late[: FRAME.itemsize * words[TAKEN]].tobytes(), FRAME)

    def _pass_time(self, t_ns: int) -> None:
        """Let the drives hear what has come before the tick, and send what they send unasked."""
        wires = self.wires
        heard = heard_by(wires.record, t_ns)
        replies = self.nodes.advance(t_ns, wires.commands[:heard])
        while status := pass_on(wires.record, replies, t_ns, heard):
            wires.settle(status, replies)

    def run(
        self,
        duration_s: float | None,
        observe: Observer,
        event: EventSink = no_event,
        commands: Callable[[int], Given] = nothing_given,
        *,
        armed: bool = True,
        over: Callable[[], bool] = lambda: False,
        answered: Callable[[Sequence[str], Sequence[str], Sequence[str]], None] = nobody_answered,
    ) -> Ending:
        """Engage, run the reference, park. Return how the run ended.

        `commands` gives all that the operator says in a tick, and `answered` takes after it why each of these
        was refused, empty where it was taken; armed: it engages by itself; over: whether the operator has
        said all. It ends with its plant, too. `event` takes what each fault tells in its tick.
        """
        stays = self.cycle.parts.operator.stays
        course = Course(self.cycle, duration_s, event=event, armed=armed, goes_on=stays)
        ending, held = None, False
        while ending is None:
            tick = self.tick + 1
            said = commands(tick)
            taken, mode, refused = said.operator, self.cycle.mode, list[str]()
            was_held, held = held, mode is Mode.HELD
            if taken:
                goes_on = course.goes_on
                refused = [refusal(each, mode, was_held=was_held, goes_on=goes_on) for each in taken]
                taken = tuple(each for each, why in zip(taken, refused, strict=True) if not why)
            elif over() and not said.orders:
                taken = course.left_alone()
            operator = course.commands(tick, taken)
            try:
                stepped = self.step(operator, said.setpoints, said.orders)
            except PlantError as error:
                return course.failed(str(error), tick)
            observe(*stepped)
            if any(said):
                setpoints = setpoint_refusals(self.cycle, len(said.setpoints))
                answered(refused, self.cycle.operating.answers, setpoints)
            ending = course.ending(tick)
        return ending
