"""Both ends of the bus in one process, in simulated time, over the same bus arithmetic as the virtual bus.

Rule of the room: no clock. A frame takes its worst-case bit time and the lowest identifier wins.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, field

from drivers.bustime import BitTiming, Wire, frame_time_ns, priority
from drivers.protocol import Frame, Received
from hil.cycle import Cycle
from hil.daemon import FAULT_TAIL_S, NO_DRIVES_S, drives_off
from hil.signals import Mode, Operator, TickInput, TickOutput
from plant_fmu.nodes import Nodes

Observer = Callable[[TickInput, tuple[Frame, ...], TickOutput], None]
"""Called after every tick with its input, the opening frames and the output."""

_new = tuple.__new__
"""Makes a NamedTuple of a tuple in half the time that its own constructor takes."""

COMPUTE_US = 60.0
"""Simulated time from the last feedback to the command's entry into the bus."""


@dataclass
class Lockstep:
    """The bus between a Cycle and Nodes, and the time that both share.

    Mutable state: the wire, the frames on their way to either end, the tick; and the controller and the
    nodes themselves. One run per instance.
    """

    cycle: Cycle
    nodes: Nodes
    timing: BitTiming | None
    """None is the ideal bus: no frame takes time, the force acts at the instant of the measurement."""
    feedback_window_s: float
    compute_us: float = COMPUTE_US
    recorder_alive: bool = True
    tick: int = -1
    wire: Wire[tuple[bool, Frame]] = field(default_factory=Wire)
    _late: list[Received] = field(default_factory=list)
    """Frames for the controller that ended after its window."""
    _commands: list[Received] = field(default_factory=list)
    """Frames for the drives that ended since their last step."""
    _shapes: dict[tuple[int, int, int], tuple[int, int]] = field(default_factory=dict)
    """(identifier, bytes, flags) -> (priority, ns on the wire) of every kind of frame seen so far."""

    def __post_init__(self) -> None:
        self.period_ns = round(1e9 / self.cycle.parts.rate_Hz)
        self.window_ns = round(self.feedback_window_s * 1e9)
        self.compute_ns = round(self.compute_us * 1e3) if self.timing else 0
        self.wanted = self.cycle.parts.protocol.feedback_ids
        self.nodes.start(0)

    def step(self, operator: tuple[Operator, ...] = ()) -> tuple[TickInput, tuple[Frame, ...], TickOutput]:
        """Advance both ends by one tick."""
        self.tick = tick = self.tick + 1
        t_ns = tick * self.period_ns
        opening = self.cycle.begin(tick)
        self._queue([(t_ns, frame) for frame in opening], from_drive=False)
        feedback, step_ns = self._exchange(t_ns, opening)
        inp = TickInput(
            tick=tick,
            t_ns=t_ns,
            lateness_ns=0,
            skipped=0,
            frames=tuple(feedback),
            sends_failed=0,
            bus_errors=0,
            bus_off=False,
            bus_overflow=0,
            recorder_alive=self.recorder_alive,
            recorder_dropped=0,
            operator=operator,
            compute_ns=0,
        )
        out = self.cycle.step(inp)
        queued_ns = step_ns + self.compute_ns
        self._queue([(queued_ns, frame) for frame in out.frames], from_drive=False)
        return inp, opening, out

    def _exchange(self, t_ns: int, opening: tuple[Frame, ...]) -> tuple[list[Received], int]:
        """Let SYNC reach the drives and their answers the controller; return those and the step's time."""
        deadline = t_ns + self.window_ns
        self._carry(t_ns)
        if opening[-1] not in [frame for _, frame in self._commands]:  # SYNC waits for the frame on the wire
            self._carry(self.wire.free_ns)
        synced = self._commands[-1].t_ns if self._commands else t_ns
        commands, self._commands = self._commands, []
        self._queue(self.nodes.step(max(synced, t_ns), commands), from_drive=True)
        early, self._late = self._late, []
        self._carry(deadline)
        answers, self._late = self._late, []
        missing = set(self.wanted)
        for n, (end_ns, frame) in enumerate(answers):
            missing.discard(frame.id)
            if end_ns > deadline or not missing:
                taken = n if end_ns > deadline else n + 1
                self._late = answers[taken:]
                return early + answers[:taken], min(end_ns, deadline)
        return early + answers, deadline

    def _queue(self, sends: Iterable[tuple[int, Frame]], *, from_drive: bool) -> None:
        """Put frames into their nodes' transmit queues, each at its instant."""
        shapes, queue = self._shapes, self.wire.queue
        for t_ns, frame in sends:
            identifier, data, flags = frame
            shape = identifier, len(data), flags
            try:
                rank, duration = shapes[shape]
            except KeyError:
                duration = 0 if self.timing is None else frame_time_ns(len(data), flags, self.timing)
                rank = priority(identifier, flags)
                shapes[shape] = rank, duration
            queue(t_ns, rank, duration, (from_drive, frame))

    def _carry(self, until_ns: int) -> None:
        """Move every frame that starts by `until_ns` to its receiver's list."""
        for end_ns, (from_drive, frame) in self.wire.advance(until_ns):
            (self._late if from_drive else self._commands).append(_new(Received, (end_ns, frame)))

    def run(
        self,
        duration_s: float | None,
        observe: Observer,
    ) -> Mode:
        """Engage, run the reference, park.

        Ends when parked with all drives off, FAULT_TAIL_S after a fault or after parking drives that never
        were on, or when the drives do not get ready.
        """
        rate = self.cycle.parts.rate_Hz
        stop_tick = None if duration_s is None else round(duration_s * rate)
        tail_ticks = max(5, round(FAULT_TAIL_S * rate))
        ending = 0
        operator: tuple[Operator, ...] = ()
        engaged = False
        while True:
            observe(*self.step(operator))
            operator = ()
            mode = self.cycle.mode
            if not engaged and mode is Mode.IDLE:
                operator, engaged = (Operator.ENGAGE,), True
            if stop_tick is not None and self.tick + 1 == stop_tick:
                operator = (*operator, Operator.STOP)
            ending += mode in {Mode.PARKED, Mode.FAULT}
            parked = mode is Mode.PARKED and drives_off(self.cycle)
            waited = mode is Mode.WAITING and self.tick > NO_DRIVES_S * rate
            if parked or ending > tail_ticks or waited:
                return mode
