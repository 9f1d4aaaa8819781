"""Jogging: one axis or leg at set-up speed while on hold, as long as the operator's jog words keep coming.

No clock: time is the tick. Before each tick it checks the rest pose: where the platform would stop if it
moved for one more tick and then braked. If that pose is refused, it brakes at once, to the rest pose that was
accepted one tick before. So each pose on the way has been checked, and the platform stops inside the limits.
"""

from collections.abc import Callable
from math import hypot, inf, radians
from typing import Any, NamedTuple

import numpy as np

from drivers.arrays import Array
from drivers.compiled.compiler import MATRIX, REAL, VECTOR, kernel, record
from drivers.compiled.pointed import Callee, context_of, data_at, pointed
from drivers.rotations import rotation_vector_kernel
from drivers.signals import Refusal
from hil.config.running import OperatorSettings
from hil.loop.motion import Motion
from hil.mathematics.linear_algebra import lu_factor, lu_solve
from hil.mathematics.rotations import rotation_motion
from hil.mathematics.vectors import at, row, scale
from hil.robot.geometry import Platform
from hil.robot.kinematics_kernels import (
    continuation_kernel,
    jacobian_rate_twist,
    leg_lengths_kernel,
    lengths_and_jacobian,
)
from hil.signals import JOG_NAMES, Order, explain
from hil.trajectory.path import SAMPLE, CompiledTrajectory, PoseSample

AXIS = np.dtype([("p0", "<f8", 3), ("R0", "<f8", (3, 3)), ("rate", "<f8", 6)])
TOLERANCE_M = 1e-12
"""Largest error of the lengths during a jog of a leg."""
SUBSTEPS = 40
"""Most steps from one pose to the next: a tick takes one, the way to the rest pose a few."""


@pointed(record(AXIS), REAL, record(SAMPLE))
def evaluate(jog: Any, t: float, into: Any) -> int:
    """Fill in the sample at time t (s) of a motion from p0, R0 with constant twist [v; w], base frame.

    p = p0 + t v, R = exp([t w]) R0; the record `jog` has p0, R0 and rate = [v; w], m/s, rad/s.
    """
    still = (0.0, 0.0, 0.0)
    w, R0 = at(jog.rate, 3), jog.R0
    turn = np.empty((3, 3))
    rotation_motion(scale(t, w), w, still, turn)
    for i in range(3):
        into.p[i] = jog.p0[i] + t * jog.rate[i]
        for j in range(3):
            into.R[i, j] = turn[i, 0] * R0[0, j] + turn[i, 1] * R0[1, j] + turn[i, 2] * R0[2, j]
    for i in range(6):
        into.twist[i], into.dtwist[i] = jog.rate[i], 0.0
    return 0


@kernel(MATRIX, MATRIX, VECTOR, MATRIX, VECTOR)
def pose_rates(a: Array, b: Array, p: Array, R: Array, dq: Array) -> tuple[Array, Array]:
    """Twist J^-1 dq and dtwist = -J^-1 (dJ/dt) twist at constant leg rates dq (6,), m/s.

    a, b (6, 3) m: joints of base and platform. Both results are nan where J is singular.
    """
    J, LU = np.empty((6, 6)), np.empty((6, 6))
    l, twist, dtwist, right = np.empty(6), np.empty(6), np.empty(6), np.empty(6)
    order = np.empty(6, np.int64)
    lengths_and_jacobian(a, b, p, R, l, J)
    if not lu_factor(J, LU, order):
        twist[:] = np.nan
        dtwist[:] = np.nan
        return twist, dtwist
    lu_solve(LU, order, dq, twist)
    v, w = at(twist, 0), at(twist, 3)
    for i in range(6):
        right[i] = -jacobian_rate_twist(row(a, i), row(b, i), at(p, 0), R, v, w)
    lu_solve(LU, order, right, dtwist)
    return twist, dtwist


class AxisJog(CompiledTrajectory):
    """Motion along x, y or z of the base frame, or about one of these axes through the platform's origin.

    here: a pose at rest. rate (6,) m/s, rad/s: the constant twist.
    """

    duration_s = None

    def __init__(self, here: PoseSample, rate: Array) -> None:
        jog = context_of(AXIS, p0=here.p, R0=here.R, rate=rate)
        self.callee = Callee(evaluate.address, data_at(jog), jog)

    ahead = CompiledTrajectory.sample


class LegJog:
    """Path on which one leg changes its length and the other five keep theirs.

    Each pose is solved from the lengths at its time, so no length drifts. here: a pose at rest. rate (6,)
    m/s: leg rates, one of them not zero. Mutable state: the last sample with its time, from which the search
    for the next pose starts.
    """

    duration_s = None

    def __init__(self, platform: Platform, here: PoseSample, rate: Array) -> None:
        self._joints = (platform.base_joints, platform.platform_joints)
        self._rate = rate
        p, R = here.p.copy(), np.array(here.R, order="C")
        self._q = leg_lengths_kernel(*self._joints, p, R)
        self._t, self._last = 0.0, PoseSample(p, R, *pose_rates(*self._joints, p, R, rate))

    def sample(self, t: float) -> PoseSample:
        """Sample at t (s) >= 0, from which the next search starts; if no pose is found, the last sample."""
        found = self.ahead(t)
        if found is not None:
            self._t, self._last = t, found
        return self._last

    def ahead(self, t: float) -> PoseSample | None:
        """Sample at t (s) >= 0; None where no pose with these lengths connects to the last one."""
        if t == self._t:
            return self._last
        p, R, _, residual = continuation_kernel(
            *self._joints, self._q + t * self._rate, self._last.p, self._last.R, TOLERANCE_M, SUBSTEPS
        )
        if not residual < np.inf:
            return None
        twist, dtwist = pose_rates(*self._joints, p, R, self._rate)
        return PoseSample(p, R, twist, dtwist) if np.isfinite(twist).all() else None


JogPath = AxisJog | LegJog


def jog_path(
    platform: Platform, here: PoseSample, axis: int, speeds: tuple[float, float], way: float
) -> JogPath:
    """Path of a jog from a pose at rest along one axis or leg.

    axis: index in JOG_NAMES; speeds: set-up speeds, m/s and rad/s; way: its sign is the direction.
    """
    rate = np.zeros(6)
    if axis < 6:
        rate[axis] = np.copysign(speeds[axis >= 3], way)
        return AxisJog(here, rate)
    rate[axis - 6] = np.copysign(speeds[0], way)
    return LegJog(platform, here, rate)


def setup_share(sample: PoseSample, speeds: tuple[float, float]) -> float:
    """Largest share, 0..1, of a sample's speed that keeps the set-up speeds, m/s and rad/s."""
    vx, vy, vz, wx, wy, wz = sample.twist.tolist()
    v, w = hypot(vx, vy, vz), hypot(wx, wy, wz)
    return min(1.0, speeds[0] / v if v else inf, speeds[1] / w if w else inf)


WORD_S = 0.1
"""A jog ends if its order is not repeated within this time, s."""
ON_HOLD = "jog: only possible on hold, in mode TRACKING: send hold first"
NOT_RESTING = "jog: the platform is still slowing down: wait until it rests"
NO_KEY = "jog: the enabling key is not held (operator.deadman_s): hold it while you jog"
SUDDEN = (
    "a leg's force could change by more than limits.force_window_N within 250 ms: lower the set-up speed, or "
    "lengthen engage.stop_s"
)
LIVE = "jog: a live reference moves to set-points only: send start, then setpoint"


class Word(NamedTuple):
    """The operator's last jog order: axis or leg, speed and tick."""

    axis: int
    """Index in JOG_NAMES."""
    fraction: float
    """Speed as a share, -1 .. 1, of the set-up speed."""
    tick: int

    @property
    def way(self) -> tuple[int, int]:
        """(axis, direction): direction -1 or 1, 0 for a released key."""
        return self.axis, (self.fraction > 0.0) - (self.fraction < 0.0)


class Jogging:
    """Moves the platform along one axis or leg by the operator's jog orders, and stops it before a limit.

    Mutable state: the last order, the present path with its axis and direction, and, until its orders end,
    the order that a limit has stopped, with the reason.
    """

    def __init__(
        self,
        settings: OperatorSettings,
        rate_Hz: float,
        platform: Platform,
        admission: Callable[[Array], int] | None,
        too_sudden: Callable[[PoseSample, float], bool],
    ) -> None:
        """admission: returns the Refusal bits of a pose (6,) m, rad; None: the reference is live.

        too_sudden: True for a sample and a share of its speed at which the forces would change too much.
        """
        self._speeds = settings.setup_speed_m_s, radians(settings.setup_speed_deg_s)
        self._patience = max(1, int(WORD_S * rate_Hz + 1e-9))
        self._platform, self._admission, self._too_sudden = platform, admission, too_sudden
        self.reset()

    def reset(self) -> None:
        """Forget all jog orders."""
        self._word: Word | None = None
        self._path: JogPath | None = None
        self._way: tuple[int, int] | None = None
        self._stopped: Word | None = None
        self.refusal = ""
        """Reason why a limit has stopped the jog; else empty."""

    @property
    def waits(self) -> bool:
        """True while a jog order is in effect."""
        return self._word is not None

    def let_go(self) -> None:
        """End the jog in effect: the platform comes to rest."""
        self._word = self._stopped = None
        self.refusal = ""

    def take(self, order: Order, tick: int, motion: Motion, *, on_hold: bool, key: bool) -> str:
        """Accept a jog order, or return the reason why it is refused; key: the enabling key is held."""
        if self._admission is None:
            return LIVE
        if not on_hold:
            return ON_HOLD
        if not key:
            return NO_KEY
        if not motion.resting and motion.trajectory is not self._path:
            return NOT_RESTING
        axis, fraction = order.numbers
        word = Word(int(axis), fraction, tick)
        stopped = self._stopped
        if stopped is not None and stopped.way == word.way and tick - stopped.tick < self._patience:
            self._stopped = word
            return self.refusal
        self.let_go()
        self._word = word
        return ""

    def step(self, tick: int, motion: Motion, *, key: bool) -> None:
        """Set the speed of the jog from this tick on; key: the operator holds the enabling key."""
        word = self._word
        if word is not None and not (key and word.fraction and tick - word.tick < self._patience):
            word = self._word = None
        under_way = motion.trajectory is self._path
        speed = 0.0
        if word is not None and under_way and self._way == word.way:
            assert self._path is not None
            speed = self._judged(self._path, word, tick, motion, 0.0)
        elif word is not None and motion.resting:
            path = self._begun(word, motion.sample(tick))
            speed = self._judged(path, word, tick, motion, motion.time(tick))
            if speed > 0.0:
                motion.leave(path, tick)
                self._path, self._way, under_way = path, word.way, True
        if under_way:
            motion.aim(tick, speed, go=True)

    def _begun(self, word: Word, here: PoseSample) -> JogPath:
        return jog_path(self._platform, here, word.axis, self._speeds, word.fraction)

    def _judged(self, path: JogPath, word: Word, tick: int, motion: Motion, zero_s: float) -> float:
        """Speed of the next tick, 0 .. 1 of the path's; 0 at a limit, with the reason in `refusal`.

        zero_s: the motion's time at which the path begins.
        """
        assert self._admission is not None
        here = path.ahead(motion.time(tick) - zero_s)
        speed = abs(word.fraction) * self._share(here)
        rest = path.ahead(motion.override.rests_at(tick, speed) - zero_s)
        slower = min(speed, abs(word.fraction) * self._share(rest))
        if slower < speed:
            speed, rest = slower, path.ahead(motion.override.rests_at(tick, slower) - zero_s)
        against = explain(Refusal.CONDITION)
        if rest is not None:
            against = explain(self._admission(np.concatenate([rest.p, rotation_vector_kernel(rest.R)])))
            if not against and self._too_sudden(rest, speed):
                against = SUDDEN
        if not against:
            return speed
        self._word, self._stopped = None, word
        self.refusal = f"jog {JOG_NAMES[word.axis]}: stopped, since farther on {against}"
        return 0.0

    def _share(self, sample: PoseSample | None) -> float:
        return 1.0 if sample is None else setup_share(sample, self._speeds)
