"""The six drives during a bring-up: at most one brake open, the five others shut, for any protocol.

Where each drive has its own frames, the five others are commanded off. Where one command frame serves
several drives, the five others are locked out first. They are set up with a watchdog of LOCK_S, so they
latch a watchdog fault as soon as they are powered on shut brakes. A latched drive obeys RESET only. No
brake opens before all five have latched.
"""

from collections.abc import Callable, Collection, Sequence
from typing import Any, NamedTuple, Protocol

import numpy as np

from drivers.arrays import Array
from drivers.family import Family
from drivers.frame_array import received_array, sent_frames
from drivers.protocol import SERIAL, DriveSetup, Frame, Received, Said
from drivers.signals import LEGS, NEVER, Command, DriveMode, DriveState, Reaction
from drivers.tick_columns import Record, copy_of, new_record

_PROBES = 200


class Heard(NamedTuple):
    """Frames received in one tick."""

    since_ns: int
    """Start of the tick."""
    frames: tuple[Received, ...]
    """All frames since the last tick, including the answers to the opening frames of this tick."""
    stretched_ns: int = 0
    """Pause of the bench's time since the last tick."""


class Line(Protocol):
    """Exchanges frames with six drives, tick by tick. Mutable state: the tick, and the frames in transit."""

    rate_Hz: float

    def exchange(self, opening: Sequence[Frame]) -> Heard:
        """Wait for the next tick, send its opening frames, and collect the answers."""

    def send(self, frames: Sequence[Frame]) -> None:
        """Send the frames that end a tick."""


LOCK_S = 1e-6
"""Watchdog of a locked-out drive, s; the protocol `legs` allows no shorter one."""
SETUP_S = 3.0
"""Longest wait for the drives to confirm their set-up, s."""
READY_S, REPORT_S = 0.1, 0.3
"""Longest wait for a drive to change its state, s; REPORT_S is added if only heartbeats report the state."""
ANSWER_S, MOST_REQUESTS = 0.05, 5
"""Wait for an answer to an identity request, s, and the largest number of requests."""
SAFE_TICKS = 10
"""Off commands at every end, since the bus may lose some."""
Sink = Callable[[Record, Sequence[Received], Sequence[Frame]], None]
"""Takes the record of a tick, the received frames and the sent frames."""


class Drives:
    """Sends the drive commands of a bring-up, one tick per call of `step`.

    Mutable state: the tick, its record, the two controller ends (of drives that may be powered, and of the
    others), the drive that may be powered, and the drive that the last command addressed.
    """

    def __init__(self, protocol: Family, line: Line, watchdog_s: float, sink: Sink = lambda *_: None) -> None:
        self.protocol, self.line, self._sink = protocol, line, sink
        can = protocol.traits.reactions
        setup = DriveSetup(watchdog_s, Reaction.BRAKE if Reaction.BRAKE in can else can[0], line.rate_Hz)
        self.locks = shares_commands(protocol, setup)
        """True if one command frame serves several drives."""
        locked = DriveSetup(LOCK_S, setup.reaction, line.rate_Hz) if self.locks else setup
        self._live, self._rest = protocol.controller_end(setup), protocol.controller_end(locked)
        self.tick = -1
        self.record = new_record()
        """Record of the last tick; the states of locked-out drives are their own."""
        self.heard: tuple[Received, ...] = ()
        """Frames of the last tick."""
        self.spoken: set[tuple[int, int]] | None = None
        """(drive, identifier) of all frames received, drive -1 if unknown; None: not collected."""
        self.serials: tuple[set[int], ...] = ()
        """Serial numbers that each node reported last; two numbers mean two drives."""
        self._records = self.record, copy_of(self.record)
        self._alone: int | None = None
        self._commanded: int | None = None

    def ticks(self, seconds: float) -> int:
        """Number of ticks in a time in s, at least one."""
        return max(1, round(seconds * self.line.rate_Hz))

    @property
    def report_ticks(self) -> int:
        """Longest delay, ticks, until a heartbeat reports a state change; 0 if feedback reports it."""
        return self.ticks(REPORT_S) if self.protocol.traits.power_told == "heartbeat" else 0

    # one tick

    def step(
        self,
        mode: DriveMode = DriveMode.OFF,
        leg: int | None = None,
        force: float = 0.0,
        *,
        silent: bool = False,
        set_up: bool = False,
        further: tuple[Frame, ...] = (),
    ) -> Record:
        """Command the drives for one tick and return its record.

        `mode` and `force` (N) apply to drive `leg`, the other drives stay off; without `leg`, `mode` applies
        to all, without force. silent: send no command. set_up: send the settings that the drives have not
        confirmed. further: more frames to send.
        """
        self.tick = tick = self.tick + 1
        opening: tuple[Frame, ...] = ()
        delayed = self.protocol.traits.command_delay_ticks > 0
        if not silent or not delayed:
            starts = sent_frames(self._live.begin(tick)), sent_frames(self._rest.begin(tick))
            # with a delay they carry the last command, which powers no drive but its own
            opening = self._chosen(*starts, self._commanded if delayed else leg)
        self._commanded = leg
        heard = self.line.exchange(opening)
        self.heard, received = heard.frames, received_array(heard.frames)
        if self.spoken is not None:
            self.spoken.update((self.protocol.sender(frame), frame.id) for _, frame in heard.frames)
        live, rest = new_record(), new_record()
        for record in (live, rest):
            record["tick"], record["t_ns"] = tick, heard.since_ns
            record["stretched_ns"] = heard.stretched_ns
        before, alike = self._records, leg is None and not self.locks
        self._live.take(received, before[0], live, heard.since_ns)
        if alike:
            rest = live
        else:
            self._rest.take(received, before[1], rest, heard.since_ns)
        self._records, self.record = (live, rest), copy_of(live)
        if leg is not None and not self.locks:
            others = np.arange(LEGS) != leg
            for name in ("drive_state", "drive_fault"):
                self.record[name][others] = rest[name][others]
        tau = np.zeros(LEGS)
        if leg is not None:
            tau[leg] = force
        self.record["q"], self.record["dq"] = self.record["length"], self.record["rate"]
        self.record["tau"], self.record["command_mode"] = tau, mode
        frames = sent_frames(self._live.give(Command(mode, tau), tick))
        if not self.locks and leg is not None:
            shut = Command(DriveMode.OFF, np.zeros(LEGS))
            frames = self._chosen(frames, sent_frames(self._rest.give(shut, tick)), leg)
        settings: tuple[Frame, ...] = ()
        if set_up:
            mine = np.array([self._powers(k) for k in range(LEGS)])
            chosen = self._live.set_up(_only(self.record, mine))
            settings = sent_frames(chosen if len(chosen) else self._rest.set_up(_only(self.record, ~mine)))
        sent = (() if silent else frames) + settings + further
        if alike:
            self._rest.remember(self._live.remembered())
        self.line.send(sent)
        self._sink(self.record, heard.frames, (*opening, *sent))
        return self.record

    def _chosen(
        self, frames: tuple[Frame, ...], others: tuple[Frame, ...], leg: int | None
    ) -> tuple[Frame, ...]:
        """Frames of drive `leg` from `frames`, which may power it, and of the other drives from `others`."""
        if self.locks or leg is None:
            return frames
        addressed = self.protocol.addressed
        mine = tuple(frame for frame in frames if leg in addressed(frame))
        return mine + tuple(frame for frame in others if leg not in addressed(frame))

    # set-up

    def prepare(self, leg: int | None) -> tuple[str, ...]:
        """Clear faults, set up drive `leg` or all drives for power; return unconfirmed settings per drive."""
        for _ in range(self.protocol.traits.reset_ticks if self._faulted() else 1):
            self.step(DriveMode.RESET if self._faulted() else DriveMode.OFF)
        self._alone = leg
        self._live.start()
        self._rest.start()
        for _ in range(self.ticks(SETUP_S)):
            self.step(set_up=True)
            lacks = self.lacks()
            if not any(lacks):
                break
        return lacks

    def lacks(self) -> tuple[str, ...]:
        """Text per drive: settings that it has not confirmed; empty if it has confirmed all."""
        live, rest = self._live.lacks(), self._rest.lacks()
        return tuple(live[k] if self._powers(k) else rest[k] for k in range(LEGS))

    def _powers(self, leg: int) -> bool:
        return not self.locks or self._alone is None or leg == self._alone

    def _faulted(self) -> bool:
        return bool((self.record["drive_state"] == DriveState.FAULT).any())

    def identities(self, legs: Collection[int] = range(LEGS)) -> tuple[dict[str, int], ...]:
        """Request the identity of drives `legs` while off; return {name: value} per drive. Sets `serials`."""
        answers: tuple[dict[str, Said], ...] = tuple({} for _ in range(LEGS))
        self.serials = tuple(set() for _ in range(LEGS))
        requests = self.protocol.traits.identity_requests
        for request in requests * MOST_REQUESTS:
            waited = {leg for leg in legs if len(answers[leg]) < len(requests)}
            if not waited:
                break
            self.step(further=tuple(request[leg] for leg in sorted(waited)))
            for _ in range(self.ticks(ANSWER_S)):
                last = not waited  # a second drive of the same number answers behind the first one
                self.step()
                for answer in filter(None, (self.protocol.identity(frame) for _, frame in self.heard)):
                    answers[answer.leg][answer.what] = answer
                    waited.discard(answer.leg)
                    if answer.what == SERIAL and answer.tells:
                        self.serials[answer.leg].add(answer.value)
                if last:
                    break
        return tuple({what: s.value for what, s in each.items() if s.tells} for each in answers)

    # one brake

    def power(self, leg: int) -> str:
        """Power one drive on its shut brake, the others off or locked; return the obstacle, "" for none."""
        lacks = self.lacks()
        if self.locks or self._faulted() or any(lacks):
            lacks = self.prepare(leg)
        if any(lacks):
            which = ", ".join(f"leg {k}: {text}" for k, text in enumerate(lacks) if text)
            return f"not set up: {which}"
        for _ in range(self.ticks(READY_S) + self.report_ticks):
            self.step(DriveMode.READY, leg)
            states = self.record["drive_state"]
            locked = states == DriveState.FAULT if self.locks else states != DriveState.RUN
            out = [k for k in range(LEGS) if k != leg and not locked[k]]
            if states[leg] == DriveState.READY and not out:
                return ""
        self.off()
        if out:
            return f"legs {out} did not go to FAULT by their watchdog of {1e6 * LOCK_S:g} us"
        return f"leg {leg} is {DriveState(int(states[leg])).name}, not READY"

    def carried(self, leg: int, force: float) -> float:
        """Force, N, on a leg at rest for a commanded `force`, N, after rounding to the frame's field."""
        forces = np.zeros(LEGS)
        forces[leg] = force
        return float(self._live.carried(forces)[leg])

    def force_step(self, leg: int, force: float) -> float:
        """Resolution, N, of commands between `force`/2 and `force`; 0 if finer than 1/400 of `force`."""
        carried = {self.carried(leg, force * (0.5 + 0.5 * k / _PROBES)) for k in range(_PROBES)}
        return 0.5 * force / len(carried) if len(carried) < _PROBES else 0.0

    def off(self, seconds: float = 0.0) -> None:
        """Command all drives to zero force and no power for `seconds`, for at least SAFE_TICKS ticks."""
        for _ in range(max(SAFE_TICKS, self.ticks(seconds))):
            self.step(DriveMode.OFF)


def shares_commands(protocol: Family, setup: DriveSetup) -> bool:
    """True if one frame powers several drives; found by comparing the frames for OFF and RUN."""

    def shared(mode: DriveMode) -> list[Frame]:
        end = protocol.controller_end(setup)
        command = sent_frames(end.give(Command(mode, np.zeros(LEGS)), 0))
        return [each for each in (*sent_frames(end.begin(0)), *command) if len(protocol.addressed(each)) > 1]

    return shared(DriveMode.OFF) != shared(DriveMode.RUN)


def _only(record: Record, legs: Array | Any) -> Record:
    """A copy of the record in which the other legs were never received, so no set-up is sent to them."""
    masked = copy_of(record)
    masked["age"] = np.where(legs, record["age"], NEVER)
    return masked
