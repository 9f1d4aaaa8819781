"""The operator of a run: what he says by signals, Enter and the channel, and what he is answered."""

from collections.abc import Callable

from drivers.signals import Mode
from hil.loop.panel import OperatorPanel
from hil.loop.refusals import REFUSED, refusal, setpoint_refusals
from hil.loop.run_end import Course
from hil.loop.status import status_text
from hil.operate.channel import Heard, OperatorChannel
from hil.record import Recording
from hil.signals import Operator, explain

STATUS_S = 0.01
"""How old a status may be: composing one takes some 50 us."""


class Console:
    """Gathers the operator's commands of a tick, and answers them after it.

    Mutable state: whether the platform was held in the last tick, why commands of this one were refused, how
    many set-points nobody takes, and the last status with its tick.
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
        """Return what the operator has said since the last tick, without what was refused."""
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
        heard = self.channel.take(anew=held and not was_held)
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
        """Tell who waits what became of his commands, and the log what was refused."""
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
