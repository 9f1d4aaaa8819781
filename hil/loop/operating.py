"""The operator's permissions: go or hold, speed, jog, park; and whether the enabling key is held.

No clock: time is the tick. Orders come with a tick's input. Moves at set-up speed are in no file, so each is
checked before it starts, a few poses a tick while the platform rests.
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
"""Largest speed of a quintic, relative to its mean."""


def approach(parts: Parts, here: PoseSample, period_s: float) -> GeodesicMove:
    """Move from a pose at rest to the start of the reference; period_s: loop period, s."""
    start, engage = parts.trajectory.sample(0.0), parts.engage
    farthest = farthest_leg_m(parts.platform, here, start)
    duration = max(farthest / engage.approach_speed_m_s, engage.blend_s, period_s)
    return GeodesicMove(here.p, here.R, start.p, start.R, duration)


def at_setup_speed(
    settings: OperatorSettings, least_s: float, here: PoseSample, there: PoseSample
) -> GeodesicMove:
    """Move between two poses that nowhere exceeds the set-up speed.

    It takes at least `least_s`; its largest acceleration is 3.1 times the set-up speed divided by that.
    """
    way = _length(there.p - here.p)
    turn = _length(relative_rotation(np.array(here.R, order="C"), np.array(there.R, order="C")))
    longest = max(way / settings.setup_speed_m_s, turn / radians(settings.setup_speed_deg_s))
    return GeodesicMove(here.p, here.R, there.p, there.R, max(PEAK * longest, least_s))


def _length(vector: Array) -> float:
    """Euclidean norm of a vector (3,), without BLAS, so that replay is exact to the bit."""
    x, y, z = vector.tolist()
    return sqrt(x * x + y * y + z * z)


APART_M = 5e-3
"""Largest distance that a joint of the platform moves from one checked pose to the next."""
LEAST, MOST = 16, 1000
"""Bounds on the number of checked poses of a move, without its start."""
PER_TICK = 2
"""Poses checked in one tick."""


class Inspection:
    """Check of a move, some poses per call. Mutable state: number of checked poses, reason for a refusal."""

    def __init__(
        self, platform: Platform, judge: Callable[[PoseSample], int], name: str, move: GeodesicMove
    ) -> None:
        """judge: returns the Refusal bits of a sample; name: name of the move in messages."""
        self.move, self._judge, self._name = move, judge, name
        reach = max(hypot(*joint) for joint in platform.platform_joints.tolist())
        self._steps = min(max(ceil(move.travel_m(reach) / APART_M), LEAST), MOST)
        self._next = 0
        self.refusal = ""
        """Reason why the move is refused; empty as far as it has been checked."""

    def step(self) -> bool:
        """Check the next poses; return True when all have been checked, or one is refused."""
        for _ in range(PER_TICK):
            if self.refusal or self._next > self._steps:
                break
            t = self.move.duration_s * self._next / self._steps
            against = self._judge(self.move.sample(t))
            if against:
                at = f"{100.0 * self._next / self._steps:.0f} %"
                self.refusal = f"{self._name}: refused, since at {at} of it {explain(against)}"
            self._next += 1
        return bool(self.refusal) or self._next > self._steps


NO_KEY = "the enabling key is not held (operator.deadman_s): hold it, then send start"
_ON_THE_WAY = frozenset({Operator.KEY, Operator.SPEED})
"""Orders that do not cancel the check of a way back."""
NOT_MOVING = "not possible in mode {}: the platform must be moving or on hold"


class Operating:
    """Turns the operator's orders into the speed along the path.

    Mutable state: permission to go, requested speed, parking at or on the way to the first pose, the tick of
    the last frame of the enabling key, and the answers to the last tick's orders; the way back to the path
    after a jog, the move under check, the reason for the last refusal, and the state of `jogging`.
    """

    def __init__(
        self,
        settings: OperatorSettings,
        rate_Hz: float,
        least_s: float,
        jogging: Jogging,
        judged: Callable[[str, GeodesicMove], Inspection],
    ) -> None:
        """least_s: shortest time of a move at set-up speed, s; judged: starts the check of a named move."""
        self.jogging, self._judged = jogging, judged
        self.settings = settings
        self.least_s = least_s
        deadman_s = settings.deadman_s
        self.patience = None if deadman_s is None else max(1, int(deadman_s * rate_Hz + 1e-9))
        """Ticks without a key frame after which the key counts as released; None: no key is needed."""
        self.reset()

    def reset(self) -> None:
        """Restore the initial state: full speed, no orders, enabling key not held."""
        self.go = True
        self.speed = 1.0
        self.parks = False
        self.jogging.reset()
        self._way_back: GeodesicMove | None = None
        self._inspection: Inspection | None = None
        self.trouble = ""
        """Reason why a way back is refused; kept until the next order or the next motion."""
        self.key_tick: int | None = None
        self.answers: list[str] = []
        """Reason for the refusal of each order of the last tick, in order; empty where it was accepted."""

    def holds_key(self, tick: int) -> bool:
        """True while the operator holds the enabling key, or if no key is configured."""
        if self.patience is None:
            return True
        return self.key_tick is not None and tick - self.key_tick < self.patience

    def moves(self, mode: Mode) -> bool:
        """True in a mode in which the operator may hold, start or park the motion."""
        return mode in {Mode.APPROACH, Mode.TRACKING} or (mode is Mode.STOPPING and self.parks)

    def stays(self, mode: Mode) -> bool:
        """True if the brakes stay open when the reference is at rest, as the operator may move it again.

        That is on hold, and before the way back to the first pose has begun.
        """
        if mode is Mode.TRACKING:
            return self.parks or not self.go
        return mode is Mode.STOPPING and self.parks and not self.go

    def busy(self, mode: Mode) -> bool:
        """True if the next tick needs a decision in Python even without a new order."""
        parks = self.parks and mode is not Mode.STOPPING
        return bool(self.answers) or parks or self.jogging.waits or self._inspection is not None

    def step(self, orders: Sequence[Order], tick: int, mode: Mode, motion: Motion) -> None:
        """Advance the motion to a tick; process its orders and the enabling key, and set the speed."""
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
        """Continue a jog; if a limit has stopped it in this tick, answer its orders with the reason."""
        jogging = self.jogging
        jogging.step(tick, motion, key=self.holds_key(tick))
        if jogging.refusal:
            self.answers = [
                answer or (jogging.refusal if order.command is Operator.JOG else "")
                for order, answer in zip(orders, self.answers, strict=True)
            ]

    def _return(self, tick: int, motion: Motion) -> None:
        """Return to the place where the path was left, and follow it again; a jog comes to rest first."""
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
        """Start a motion: permission to go if the enabling key is held; a former way back is forgotten."""
        self.parks, self.go = False, self.holds_key(tick)
        self._way_back = self._inspection = None
        self.trouble = ""
        motion.settle(tick, self.speed if self.go else 0.0)

    def enter(self, mode: Mode, tick: int, motion: Motion) -> None:
        """Start TRACKING or the way back; at rest if the operator has to give the order to start."""
        if mode is Mode.TRACKING:
            begins = self.parks or self.settings.start == "automatic"
            self.go = self.go and begins and self.holds_key(tick)
        if not self.go or self.parks:
            motion.settle(tick, 0.0)
        self._aim(tick, mode, motion)

    def way(self, name: str, tick: int, motion: Motion, there: PoseSample) -> GeodesicMove | None:
        """Move from the present rest to a pose of the reference, once all its poses have been checked.

        None while the check runs, and if it fails: then the platform stays on hold, with the reason in
        `trouble`.
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
