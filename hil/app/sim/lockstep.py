"""Both ends of the bus in one process, in simulated time, over the same bus arithmetic as the virtual bus.

A frame takes its worst-case bit time and the lowest identifier wins.
"""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from operator import itemgetter
from typing import NamedTuple

from drivers.arrays import Rows
from drivers.can.arbitration import priority, transmit
from drivers.can.bus_time import BitTiming, frame_time_ns
from drivers.ends import hearing
from drivers.errors import PlantError
from drivers.frame_array import received_array, sent_array, sent_frames
from drivers.protocol import ALWAYS, Frame, Received
from drivers.signals import BusState, Mode
from hil.loop.cycle import Cycle
from hil.loop.latches import latch_ns
from hil.loop.refusals import refusal, setpoint_refusals
from hil.loop.run_end import Course, Ending
from hil.loop.story.narrator import EventSink, no_event
from hil.signals import Operator, Order, SetPoint, TickInput, TickOutput
from plant_fmu.drives.nodes import Nodes

Observer = Callable[[TickInput, Rows, TickOutput], None]
"""Called after every tick with its input, the opening frames and the output."""

_new = tuple.__new__
"""Makes a NamedTuple of a tuple in half the time that its own constructor takes."""

_frame_of = itemgetter(1)

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


Shape = tuple[int, int, int]
"""(identifier, bytes, flags): decides a frame's priority and its time on the wire."""


class Burst(NamedTuple):
    """How frames of certain shapes, queued at one instant, follow each other on a bus that has no others."""

    ends: tuple[tuple[int, int], ...]
    """Which of them, and ns from the start of the first to its end, in the order of the wire."""
    duration: int
    """ns from the start of the first to the end of the last."""
    answered: int
    """How many of them, in that order, it takes to bring every feedback; 0 if one is not there."""


@dataclass
class Lockstep:
    """The bus between a Cycle and Nodes, and the time that both share.

    The faults of the nodes that wait for a mode are told when it is reached.

    Mutable state: the transmit queue and when the bus falls free, the frames on their way to either end, the
    tick, the last mode and since when the reference rests; and the controller and the nodes themselves. One
    run per instance.
    """

    cycle: Cycle
    nodes: Nodes
    timing: BitTiming | None
    """None is the ideal bus: no frame takes time, the force acts at the instant of the measurement."""
    feedback_window_s: float
    compute_us: float = COMPUTE_US
    tick: int = -1
    """The last one; both ends begin with the next."""
    buses: int = 1
    """How many there are."""
    skew_ns: int = 0
    """From this tick's SYNC on the first bus to that on the last."""
    sent_ns: list[int | None] = field(default_factory=list)
    """When each of the frames that started this tick ended; None: it still waits."""
    free_ns: int = ALWAYS
    """When the bus falls free."""
    _queued: list[tuple[int, int, int, int, bool, Frame]] = field(default_factory=list)
    """Not started yet; see `bus_time.transmit`, then whether a drive sends it, and the frame."""
    _number: int = 0
    _late: list[Received] = field(default_factory=list)
    """Frames for the controller that ended after its window."""
    _commands: list[Received] = field(default_factory=list)
    """Frames for the drives that ended since their last step."""
    _shapes: dict[Shape, tuple[int, int]] = field(default_factory=dict)
    """Priority and ns on the wire of every shape seen so far."""
    _bursts: dict[tuple[Shape, ...], Burst] = field(default_factory=dict)
    """What is known of frames of these shapes: the same few come together tick after tick."""
    _mode: Mode = Mode.WAITING
    _rests: int = 0
    """How many ticks in a row the reference has stood still in TRACKING."""

    def __post_init__(self) -> None:
        self.period_ns = round(1e9 / self.cycle.parts.rate_Hz)
        self.window_ns = round(self.feedback_window_s * 1e9)
        self.compute_ns = round(self.compute_us * 1e3) if self.timing else 0
        self.wanted = self.cycle.parts.protocol.feedback_ids
        self.hearing = hearing(self.cycle.parts.protocol)
        self.fresh = self.cycle.parts.protocol.fresh
        self.awaited = self.cycle.parts.protocol.awaited
        self.nodes.start((self.tick + 1) * self.period_ns)

    def step(
        self,
        operator: tuple[Operator, ...] = (),
        setpoints: tuple[SetPoint, ...] = (),
        orders: tuple[Order, ...] = (),
    ) -> tuple[TickInput, Rows, TickOutput]:
        """Advance both ends by one tick."""
        self.tick = tick = self.tick + 1
        t_ns = tick * self.period_ns
        opening = sent_frames(self.cycle.begin(tick))
        feedback, step_ns = self._exchange(t_ns, opening)
        off = self.nodes.bus_off & (1 << self.buses) - 1
        inp = TickInput(
            tick,
            t_ns,
            frames=received_array(feedback),
            sync_skew_ns=self.skew_ns,
            bus_off=off,
            bus_state=BusState.OFF if off else BusState.UNKNOWN,
            operator=operator,
            latch_ns=latch_ns(self.hearing, sent_array(opening), self.sent_ns, t_ns),
            setpoints=setpoints,
            orders=orders,
        )
        out = self.cycle.step(inp)
        if self.nodes.waiting:
            self._report_mode()
        queued_ns = step_ns + self.compute_ns
        # nothing else is queued before the next SYNC
        sent = sent_frames(out.frames)
        if not self._send(queued_ns, sent, t_ns + self.period_ns - 1, self._commands):
            self._queue([(queued_ns, frame) for frame in sent], from_drive=False)
        return inp, sent_array(opening), out

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

    def _exchange(self, t_ns: int, opening: tuple[Frame, ...]) -> tuple[list[Received], int]:
        """Let SYNC reach the drives and their answers the controller; return those and the step's time."""
        deadline = t_ns + self.window_ns
        if self.cycle.parts.protocol.unasked_s > 0.0:
            self._pass_time(t_ns)
        self._open(t_ns, opening, deadline)
        synced = self._commands[-1].t_ns if self._commands else t_ns
        commands, self._commands = self._commands, []
        replies = self.nodes.step(max(synced, t_ns), commands)
        early, self._late = self._late, []
        answers: list[Received] = []
        if replies and replies[0][0] == replies[-1][0]:
            burst = self._send(replies[0][0], list(map(_frame_of, replies)), deadline, answers)
            if burst:
                taken = burst.answered
                # queued at one instant, they answer the same frame: one is fresh if all are
                if not taken or not self.fresh(answers[taken - 1], self.tick, t_ns):
                    return early + answers, deadline
                self._late = answers[taken:]
                return early + answers[:taken], answers[taken - 1].t_ns
        self._queue(replies, from_drive=True)
        self._carry(deadline)
        answers, self._late = self._late, []
        missing = set(self.wanted)
        for n, answer in enumerate(answers):
            end_ns = answer.t_ns
            if self.fresh(answer, self.tick, t_ns):
                missing.discard(self.awaited(answer.frame))
            if end_ns > deadline or not missing:
                taken = n if end_ns > deadline else n + 1
                self._late = answers[taken:]
                return early + answers[:taken], min(end_ns, deadline)
        return early + answers, deadline

    def _pass_time(self, t_ns: int) -> None:
        """Let the drives hear what has come before the tick, and send what they send unasked."""
        heard = [each for each in self._commands if each.t_ns <= t_ns]
        self._commands = self._commands[len(heard) :]
        self._queue(self.nodes.step(t_ns, heard), from_drive=True)
        self._carry(t_ns)

    def _open(self, t_ns: int, opening: tuple[Frame, ...], deadline: int) -> None:
        """Let what starts the tick reach the drives; take note when."""
        before = len(self._commands)
        if not self._send(t_ns, opening, deadline, self._commands):
            self._queue([(t_ns, frame) for frame in opening], from_drive=False)
            self._carry(t_ns)
            # it waits for the frame on the wire, on a flooded bus in vain
            while self.free_ns <= deadline and any(queued[-1] in opening for queued in self._queued):
                self._carry(self.free_ns)
        self._note_sent(opening, self._commands[before:])

    def _note_sent(self, opening: tuple[Frame, ...], ended: Sequence[Received]) -> None:
        """Take note when each of the frames that start the tick ended, among all that have."""
        ends = {frame: t_ns for t_ns, frame in ended}
        self.sent_ns = [ends.get(frame) for frame in opening]

    def _send(
        self, t_ns: int, frames: Sequence[Frame], end_ns: int, receiver: list[Received]
    ) -> Burst | None:
        """Pass frames queued at `t_ns` over a bus that nobody else waits for.

        Does nothing and returns None if a frame waits already or these are not through by `end_ns`.
        """
        if self._queued:
            return None
        shapes = tuple([(identifier, len(data), flags) for identifier, data, flags in frames])
        burst = self._bursts.get(shapes)
        if burst is None:
            burst = self._bursts[shapes] = self._burst(shapes)
        start = max(t_ns, self.free_ns)
        if start + burst.duration > end_ns:
            return None
        self.free_ns = start + burst.duration
        for k, end in burst.ends:
            receiver.append(_new(Received, (start + end, frames[k])))
        return burst

    def _burst(self, shapes: tuple[Shape, ...]) -> Burst:
        """Find out how frames of these shapes go."""
        queued = [(0, rank, k, ns) for k, (rank, ns) in enumerate(map(self._wire, shapes))]
        sent, _, duration = transmit(queued, 0, sum(ns for *_, ns in queued))
        ends = tuple((k, end) for end, (_, _, k, _) in sent)
        missing = set(self.wanted)
        answered = 0
        for n, (k, _) in enumerate(ends, 1):
            if shapes[k][0] in missing:
                missing.discard(shapes[k][0])
                answered = n
        return Burst(ends, duration, 0 if missing else answered)

    def _wire(self, shape: Shape) -> tuple[int, int]:
        """Return the priority of a frame and its ns on the wire."""
        wire = self._shapes.get(shape)
        if wire is None:
            identifier, length, flags = shape
            duration = 0 if self.timing is None else frame_time_ns(length, flags, self.timing)
            wire = self._shapes[shape] = priority(identifier, flags), duration
        return wire

    def _queue(self, sends: Iterable[tuple[int, Frame]], *, from_drive: bool) -> None:
        """Put frames into their nodes' transmit queues, each at its instant."""
        for t_ns, frame in sends:
            identifier, data, flags = frame
            rank, duration = self._wire((identifier, len(data), flags))
            self._number += 1
            self._queued.append((t_ns, rank, self._number, duration, from_drive, frame))

    def _carry(self, until_ns: int) -> None:
        """Move every frame that starts by `until_ns` to its receiver's list."""
        sent, self._queued, self.free_ns = transmit(self._queued, self.free_ns, until_ns)
        for end_ns, (_, _, _, _, from_drive, frame) in sent:
            (self._late if from_drive else self._commands).append(_new(Received, (end_ns, frame)))

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
        goes_on = self.cycle.parts.operator.stays
        course = Course(self.cycle, duration_s, event=event, armed=armed, goes_on=goes_on)
        ending, held = None, False
        while ending is None:
            tick = self.tick + 1
            said = commands(tick)
            silent = over() and not said.operator and not said.orders
            mode = self.cycle.mode
            was_held, held = held, mode is Mode.HELD
            refused = [
                refusal(each, mode, was_held=was_held, goes_on=course.goes_on) for each in said.operator
            ]
            taken = tuple(each for each, why in zip(said.operator, refused, strict=True) if not why)
            operator = course.commands(tick, course.left_alone() if silent else taken)
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
