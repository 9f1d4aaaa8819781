"""What the operator lets the platform do: go or hold, how fast, jog, park; and whether the key is held.

Pure: it judges by ticks. Orders come with a tick's input. Moves at set-up speed no file has, so each is
judged before it is followed, a few poses a tick while the platform rests.
"""

from collections.abc import Callable, Sequence
from math import ceil, hypot, radians, sqrt

import numpy as np

from drivers.arrays import Array
from drivers.signals import Mode
from hil.config.running import OperatorSettings
from hil.loop.jogging import Jogging
from hil.loop.motion import Motion
from hil.loop.parts import Parts
from hil.loop.reference import farthest_leg_m
from hil.mathematics.rotations import relative_rotation
from hil.robot.geometry import Platform
from hil.signals import Operator, Order, explain
from hil.trajectory.move import GeodesicMove
from hil.trajectory.path import PoseSample

PEAK = 1.875
"""Largest speed of a quintic over its mean."""


def approach(parts: Parts, here: PoseSample, period_s: float) -> GeodesicMove:
    """Return the move from a pose at rest to the start of the reference."""
    start, engage = parts.trajectory.sample(0.0), parts.engage
    farthest = farthest_leg_m(parts.platform, here, start)
    duration = max(farthest / engage.approach_speed_m_s, engage.blend_s, period_s)
    return GeodesicMove(here.p, here.R, start.p, start.R, duration)


def at_setup_speed(
    settings: OperatorSettings, least_s: float, here: PoseSample, there: PoseSample
) -> GeodesicMove:
    """Return the move between two poses that is nowhere faster than the set-up speed.

    It takes `least_s` at least, and its largest acceleration is 3.1 times the set-up speed over that.
    """
    way = _length(there.p - here.p)
    turn = _length(relative_rotation(np.array(here.R, order="C"), np.array(there.R, order="C")))
    longest = max(way / settings.setup_speed_m_s, turn / radians(settings.setup_speed_deg_s))
    return GeodesicMove(here.p, here.R, there.p, there.R, max(PEAK * longest, least_s))


def _length(vector: Array) -> float:
    """Return the length of a vector (3,), without BLAS."""
    x, y, z = vector.tolist()
    return sqrt(x * x + y * y + z * z)


APART_M = 5e-3
"""No joint of the platform moves farther from one pose that is judged to the next."""
LEAST, MOST = 16, 1000
"""Poses of a way, beside its start."""
PER_TICK = 2
"""Poses judged in one tick."""


class Inspection:
    """A move under judgement. Mutable state: how many of its poses are judged, and why one is refused."""

    def __init__(
        self, platform: Platform, judge: Callable[[PoseSample], int], name: str, move: GeodesicMove
    ) -> None:
        """Take the judge of samples, bits of Refusal, and what the move is called."""
        self.move, self._judge, self._name = move, judge, name
        reach = max(hypot(*joint) for joint in platform.platform_joints.tolist())
        self._steps = min(max(ceil(move.travel_m(reach) / APART_M), LEAST), MOST)
        self._next = 0
        self.refusal = ""
        """Why it cannot be followed; empty as far as it has been judged."""

    def step(self) -> bool:
        """Judge the next poses; return whether all have been, or one is refused."""
        for _ in range(PER_TICK):
            if self.refusal or self._next > self._steps:
                break
            t = self.move.duration_s * self._next / self._steps
            against = self._judge(self.move.sample(t))
            if against:
                at = f"{100.0 * self._next / self._steps:.0f} %"
                self.refusal = f"{self._name}: not followed, since {at} along it {explain(against)}"
            self._next += 1
        return bool(self.refusal) or self._next > self._steps


NO_KEY = "the key is not held (operator.deadman_s): hold it, then say start"
_ON_THE_WAY = frozenset({Operator.KEY, Operator.SPEED})
"""Orders that leave the platform on its way."""
NOT_MOVING = "nothing moves in mode {}: the platform has to be on its way or on hold"


class Operating:
    """Turns the operator's orders into the speed along the path.

    Mutable state: whether the platform may go, the speed that was asked for, whether it is to park at the
    first pose or on its way there, the tick of the last key frame, the answers to the last tick's orders, the
    way back to the path after a jog, the one that is being judged and why the last one was refused, and what
    `jogging` keeps.
    """

    def __init__(
        self,
        settings: OperatorSettings,
        rate_Hz: float,
        least_s: float,
        jogging: Jogging,
        judged: Callable[[str, GeodesicMove], Inspection],
    ) -> None:
        """Take the least time of a move at set-up speed, s, and what judges such a move, with its name."""
        self.jogging, self._judged = jogging, judged
        self.settings = settings
        self.least_s = least_s
        deadman_s = settings.deadman_s
        self.patience = None if deadman_s is None else max(1, int(deadman_s * rate_Hz + 1e-9))
        """Ticks after which a key that is not heard again counts as let go; None: no key is needed."""
        self.reset()

    def reset(self) -> None:
        """Back to the start: full speed, no key heard."""
        self.go = True
        self.speed = 1.0
        self.parks = False
        self.jogging.reset()
        self._way_back: GeodesicMove | None = None
        self._inspection: Inspection | None = None
        self.trouble = ""
        """Why a way back cannot be followed, until the next order, or until it moves anew."""
        self.key_tick: int | None = None
        self.answers: list[str] = []
        """Why each order of the last tick was refused, in their order; empty where it was taken."""

    def holds_key(self, tick: int) -> bool:
        """Tell whether the key is held, or none is needed."""
        if self.patience is None:
            return True
        return self.key_tick is not None and tick - self.key_tick < self.patience

    def moves(self, mode: Mode) -> bool:
        """Tell whether the operator decides in a mode how the platform goes on."""
        return mode in {Mode.APPROACH, Mode.TRACKING} or (mode is Mode.STOPPING and self.parks)

    def stays(self, mode: Mode) -> bool:
        """Tell whether the brakes stay open where the motion has ended.

        On hold, and where the way back to the first pose is still to begin.
        """
        if mode is Mode.TRACKING:
            return self.parks or not self.go
        return mode is Mode.STOPPING and self.parks and not self.go

    def busy(self, mode: Mode) -> bool:
        """Whether it has to be asked in the next tick though no order comes."""
        parks = self.parks and mode is not Mode.STOPPING
        return bool(self.answers) or parks or self.jogging.waits or self._inspection is not None

    def step(self, orders: Sequence[Order], tick: int, mode: Mode, motion: Motion) -> None:
        """Go on to a tick along the motion, take its orders, look at the key, and set the speed from here."""
        motion.advance(tick)
        if not self.go and self.stays(mode) and not motion.away and motion.finished(tick):
            motion.settle(tick, 0.0)  # the motion is over: so is its time
        if not orders and self.patience is None and not motion.away:
            if self.answers:
                self.answers = []
            return
        self.answers = [self._take(order, tick, mode, motion) for order in orders]
        if self.moves(mode):
            self.go = self.go and self.holds_key(tick)
            if motion.away and self.go and not self.parks:
                self._return(tick, motion)
            self._aim(tick, mode, motion)
            if mode is Mode.TRACKING and not self.go:
                self._jog(orders, tick, motion)

    def _take(self, order: Order, tick: int, mode: Mode, motion: Motion) -> str:
        if order.command not in _ON_THE_WAY:
            self.trouble, self._inspection = "", None
        match order.command:
            case Operator.JOG:
                on_hold = mode is Mode.TRACKING and not self.go
                return self.jogging.take(order, tick, motion, on_hold=on_hold, key=self.holds_key(tick))
            case Operator.KEY:
                self.key_tick = tick
            case Operator.SPEED:
                (self.speed,) = order.numbers
            case _ if not self.moves(mode):
                return NOT_MOVING.format(mode.name)
            case Operator.HOLD:
                self.go, self.parks = False, mode is Mode.STOPPING
            case _ if not self.holds_key(tick):
                return NO_KEY
            case Operator.START:
                self.go, self.parks = True, mode is Mode.STOPPING
            case Operator.PARK:
                self.go = self.parks = True
        return ""

    def _jog(self, orders: Sequence[Order], tick: int, motion: Motion) -> None:
        """Go on with a jog; where a limit has stopped it in this tick, its words are refused."""
        jogging = self.jogging
        jogging.step(tick, motion, key=self.holds_key(tick))
        if jogging.refusal:
            self.answers = [
                answer or (jogging.refusal if order.command is Operator.JOG else "")
                for order, answer in zip(orders, self.answers, strict=True)
            ]

    def _return(self, tick: int, motion: Motion) -> None:
        """Go back to where the path was left, and on along it; a jog comes to rest first."""
        self.jogging.let_go()
        if motion.finished(tick):
            motion.resume(tick)
        elif motion.trajectory is not self._way_back and motion.resting:
            left = motion.left
            assert left is not None
            move = self.way("start: the way back to the path", tick, motion, left[0])
            if move is not None:
                self._way_back = move
                motion.leave(move, tick)

    def engage(self, tick: int, motion: Motion) -> None:
        """Begin to move, where the key is held; no way back of the motion before counts any more."""
        self.parks, self.go = False, self.holds_key(tick)
        self._way_back = self._inspection = None
        self.trouble = ""
        motion.settle(tick, self.speed if self.go else 0.0)

    def enter(self, mode: Mode, tick: int, motion: Motion) -> None:
        """Begin TRACKING, or the way back: at rest where the operator has to start it."""
        if mode is Mode.TRACKING:
            begins = self.parks or self.settings.start == "automatic"
            self.go = self.go and begins and self.holds_key(tick)
        if not self.go or self.parks:
            motion.settle(tick, 0.0)
        self._aim(tick, mode, motion)

    def way(self, name: str, tick: int, motion: Motion, there: PoseSample) -> GeodesicMove | None:
        """Return the move from rest to a pose of the reference, once it has been judged.

        None before that, and where it cannot be followed: then the platform stays on hold, see `trouble`.
        """
        if self._inspection is None:
            move = at_setup_speed(self.settings, self.least_s, motion.sample(tick), there)
            self._inspection = self._judged(name, move)
        found = self._inspection
        if not found.step():
            return None
        self._inspection = None
        if not found.refusal:
            return found.move
        self.trouble = found.refusal
        self.go = self.parks = False
        return None

    def _aim(self, tick: int, mode: Mode, motion: Motion) -> None:
        jogs = motion.away and motion.trajectory is not self._way_back
        waits = jogs or (self.parks and mode is not Mode.STOPPING)  # for rest, from which the way back begins
        motion.aim(tick, self.speed, go=self.go and not waits)
