"""The operator's side of a run: orders by signal, Enter key and channel, answers to them, and the status."""

import json
from collections.abc import Callable

import numpy as np

from drivers.arrays import Array
from drivers.signals import NEVER, Fault, Mode
from hil.loop.cycle import Cycle
from hil.loop.operating import NO_KEY
from hil.loop.panel import OperatorPanel
from hil.loop.report import waiting_text
from hil.loop.run_end import Course
from hil.mathematics.rotations import rotation_vector
from hil.operate.channel import Heard, OperatorChannel
from hil.record import Recording
from hil.signals import Operator, explain

NOT_LIVE = "only a live reference takes set-points: set reference.type to live"
REFUSED = "operator's command refused: "
"""Prefix of the log event for a refused command."""


def refusal(command: Operator, mode: Mode, *, was_held: bool, goes_on: bool) -> str:
    """Reason, as text, why an order without numbers is refused in a mode; empty if it is accepted.

    was_held: the platform was also in mode HELD in the tick before; goes_on: see `hil.loop.run_end.Course`.
    """
    match command:
        case Operator.ENGAGE if mode is not Mode.IDLE:
            return f"cannot arm in mode {mode.name}: all drives have to be ready (mode IDLE)"
        case Operator.RELEASE if not (mode is Mode.HELD and was_held):
            return "nothing is held: release is for a platform that force holds (mode HELD)"
        case Operator.RESET if mode not in {Mode.FAULT, Mode.WAITING} and not (
            mode is Mode.PARKED and goes_on
        ):
            return f"there is nothing to reset in mode {mode.name}"
        case _:
            return ""


def setpoint_refusals(cycle: Cycle, count: int) -> list[str]:
    """Reason for the refusal of each of the last tick's `count` set-points; empty where it was accepted."""
    steering = cycle.parts.steering
    return [NOT_LIVE] * count if steering is None else [explain(each) for each in steering.answers]


STATUS_S = 0.01
"""Largest age of a status: composing one takes some 50 us."""


class Console:
    """Collects the operator's orders for a tick, and answers them after it.

    Mutable state: whether the platform was in mode HELD in the last tick, reasons for this tick's refusals,
    the number of set-points without a live reference, and the last status with its tick.
    """

    def __init__(
        self,
        course: Course,
        panel: OperatorPanel,
        channel: OperatorChannel | None = None,
        consent: Callable[[], bool] | None = None,
    ) -> None:
        self.course, self.panel, self.channel, self.consent = course, panel, channel, consent
        self._status_ticks = round(STATUS_S * course.cycle.parts.rate_Hz)
        self._held = False
        self._refusals: list[str] = []
        self._not_live = 0
        self._status, self._status_tick = "", -1

    def take(self) -> Heard:
        """Orders that came since the last call, without those refused in the present mode."""
        course, mode = self.course, self.course.cycle.mode
        held = mode is Mode.HELD
        was_held, self._held = self._held, held
        operator = self.panel.take(held=held)
        if operator and course.goes_on:
            operator += (Operator.END,)
        if course.waits_for_consent and self.consent is not None and self.consent():
            operator += (Operator.ENGAGE,)
        if self.channel is None:
            return Heard(operator)
        # What came before the platform was held must not release it, whenever it is read.
        heard = self.channel.take(mark_old=held and not was_held)
        if course.cycle.parts.steering is None:
            self._not_live = len(heard.setpoints)
            heard = heard._replace(setpoints=())
        self._refusals = []
        if not heard.operator:
            return heard._replace(operator=operator)
        self._refusals = [
            refusal(each, mode, was_held=was_held and k not in self.channel.old, goes_on=course.goes_on)
            for k, each in enumerate(heard.operator)
        ]
        taken = [each for each, why in zip(heard.operator, self._refusals, strict=True) if not why]
        operator += tuple(taken)
        return heard._replace(operator=operator + (Operator.STOP,) * (Operator.END in taken))

    def answer(self, recording: Recording, t_ns: int) -> None:
        """Send answers to the clients that wait for one, and log the refusals at time `t_ns`."""
        cycle, channel = self.course.cycle, self.channel
        steering, operating = cycle.parts.steering, cycle.operating
        if steering is not None and steering.counts.refusal:
            recording.event(t_ns, "warning", f"set-point refused: {explain(steering.counts.refusal)}")
        if channel is None or not channel.waited_for:
            return
        setpoints = setpoint_refusals(cycle, self._not_live)
        refused = [why for why in (*self._refusals, *operating.answers) if why]
        if refused:
            recording.event(t_ns, "warning", REFUSED + "; ".join(refused))
        channel.answer(self._refusals, operating.answers, setpoints, self._status_text)

    def _status_text(self) -> str:
        tick = int(self.course.cycle.tick["tick"])
        if self._status_tick < 0 or tick - self._status_tick >= self._status_ticks:
            assert self.channel is not None
            self._status, self._status_tick = status_text(self.course, self.channel.malformed), tick
        return self._status


def waits_for(course: Course) -> str:
    """Operator's action that is needed before the platform moves, as text; empty if none."""
    cycle = course.cycle
    mode, operating = cycle.mode, cycle.operating
    if mode is Mode.WAITING:
        return waiting_text(cycle)
    if mode is Mode.IDLE:
        return "arm: all six drives are ready"
    if mode is Mode.HELD:
        return "release, once the platform is supported: not all brakes are proven shut"
    if mode in {Mode.FAULT, Mode.PARKED} and course.goes_on:
        return "reset, then arm"
    if operating.moves(mode) and not operating.go:
        if not operating.holds_key(int(cycle.tick["tick"])):
            return NO_KEY
        if operating.trouble:
            return f"another order: {operating.trouble}"
        return "start, which first returns to where the path was left" if cycle.motion.away else "start"
    if operating.moves(mode) and operating.speed == 0.0:
        return "a speed above 0 %"
    return ""


def _known(values: Array) -> list[float] | None:
    """The values as a list; None if one is not finite, as JSON has no such number."""
    return values.tolist() if np.isfinite(values).all() else None


def status_text(course: Course, malformed: int) -> str:
    """The run's status as JSON text; `hil.operate.client.OperatorClient.status` lists its keys."""
    cycle = course.cycle
    tick, operating, motion = cycle.tick, cycle.operating, cycle.motion
    number = int(tick["tick"])
    needed = operating.patience is not None
    key = ("held" if operating.holds_key(number) else "missing") if needed else "not needed"
    left = motion.left
    along = motion.time(number) if left is None else left[1]
    length = cycle.parts.trajectory.duration_s
    heard = bool((tick["age"] < NEVER).all())
    turn = np.rad2deg(rotation_vector(tick["R"])) if np.isfinite(tick["R"]).all() else tick["R"]
    return json.dumps(
        {
            "mode": cycle.mode.name,
            "faults": [fault.name for fault in Fault if fault & cycle.faults],
            "tick": number,
            "speed_percent": 100.0 * operating.speed,
            "speed_now_percent": 100.0 * motion.override.sigma,
            "position_m": _known(tick["p"]),
            "rotation_vector_deg": _known(turn),
            "leg_lengths_m": _known(tick["q"]) if heard else None,
            "path_s": along if cycle.mode is Mode.TRACKING else None,
            "path_length_s": length,
            "held": operating.moves(cycle.mode) and not operating.go,
            "key": key,
            "waits_for": waits_for(course),
            "refused_lines": malformed,
        }
    )
