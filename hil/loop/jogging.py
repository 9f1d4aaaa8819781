"""Jogging: one axis or leg at set-up speed from hold, while the operator's words keep coming.

Pure: it judges by ticks. Before each tick the pose is judged at which the platform would come to rest if it
went on for this tick and then braked. Where that is refused it brakes at once, to the rest that was judged a
tick before: so each pose on the way has been judged, and it stops inside.
"""

from collections.abc import Callable
from math import hypot, inf, radians
from typing import Any, NamedTuple

import numpy as np

from drivers.arrays import Array
from drivers.compiled.compiler import MATRIX, REAL, VECTOR, kernel, record
from drivers.compiled.pointed import Callee, context_of, data_at, pointed
from drivers.signals import Refusal
from hil.config.running import OperatorSettings
from hil.loop.motion import Motion
from hil.mathematics.linear_algebra import lu_factor, lu_solve
from hil.mathematics.rotations import rotation_motion, rotation_vector_kernel
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
"""By how much the lengths of a leg's jog may be off."""
SUBSTEPS = 40
"""Most steps from one pose to the next: a tick takes one, the way to rest a few."""


@pointed(record(AXIS), REAL, record(SAMPLE))
def evaluate(jog: Any, t: float, into: Any) -> int:
    """Fill the sample of p = p0 + t v, R = exp([t w]) R0 with the constant twist [v; w] = rate."""
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
    """Return twist = J^-1 dq and dtwist = -J^-1 (dJ/dt) twist for constant rates dq (6,) of the legs, m/s.

    Both nan where J is singular.
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
    """Along x, y or z of the base frame, or about one of these through the platform's origin.

    here: a pose at rest. rate (6,) m/s, rad/s: the constant twist.
    """

    duration_s = None

    def __init__(self, here: PoseSample, rate: Array) -> None:
        jog = context_of(AXIS, p0=here.p, R0=here.R, rate=rate)
        self.callee = Callee(evaluate.address, data_at(jog), jog)

    ahead = CompiledTrajectory.sample


class LegJog:
    """One leg longer or shorter, the other five as long as they are.

    The pose is that of the lengths at each time, so that none of them drifts. here: a pose at rest. rate (6,)
    m/s: of the lengths, one not zero. Mutable state: the last sample with its time, from which the next pose
    is looked for.
    """

    duration_s = None

    def __init__(self, platform: Platform, here: PoseSample, rate: Array) -> None:
        self._joints = (platform.base_joints, platform.platform_joints)
        self._rate = rate
        p, R = here.p.copy(), np.array(here.R, order="C")
        self._q = leg_lengths_kernel(*self._joints, p, R)
        self._t, self._last = 0.0, PoseSample(p, R, *pose_rates(*self._joints, p, R, rate))

    def sample(self, t: float) -> PoseSample:
        """Return the sample at t (s) >= 0, and go on from there; where there is none, the last one."""
        found = self.ahead(t)
        if found is not None:
            self._t, self._last = t, found
        return self._last

    def ahead(self, t: float) -> PoseSample | None:
        """Return the sample at t (s) >= 0; None where no pose of these lengths leads on from here."""
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
    """Return what a jog follows from a pose at rest.

    axis: index in JOG_NAMES; speeds: of set-up, m/s and rad/s; way: its sign is the direction.
    """
    rate = np.zeros(6)
    if axis < 6:
        rate[axis] = np.copysign(speeds[axis >= 3], way)
        return AxisJog(here, rate)
    rate[axis - 6] = np.copysign(speeds[0], way)
    return LegJog(platform, here, rate)


def setup_share(sample: PoseSample, speeds: tuple[float, float]) -> float:
    """Return at which share of a sample's speed the platform is no faster than at set-up, m/s and rad/s."""
    vx, vy, vz, wx, wy, wz = sample.twist.tolist()
    v, w = hypot(vx, vy, vz), hypot(wx, wy, wz)
    return min(1.0, speeds[0] / v if v else inf, speeds[1] / w if w else inf)


WORD_S = 0.1
"""A jog whose word is not heard again for so long ends."""
ON_HOLD = "jog: only on hold, in mode TRACKING: say hold first"
NOT_RESTING = "jog: the platform still comes to rest: wait for it"
NO_KEY = "jog: the key is not held (operator.deadman_s): hold it while you jog"
SUDDEN = (
    "a leg's force could change by more than limits.force_window_N within 250 ms: lower the set-up speed, or "
    "lengthen engage.stop_s"
)
LIVE = "jog: the reference is live, and moves to set-points alone: say start, then setpoint"


class Word(NamedTuple):
    """The last jog word."""

    axis: int
    """Index in JOG_NAMES."""
    fraction: float
    """-1 .. 1 of the set-up speed."""
    tick: int

    @property
    def way(self) -> tuple[int, int]:
        """Axis and direction: -1, 1, or 0 where it lets go."""
        return self.axis, (self.fraction > 0.0) - (self.fraction < 0.0)


class Jogging:
    """Moves the platform along one axis or leg, and stops it before a limit.

    Mutable state: the last word, the path it is on with its way, and the way on which a limit stopped it with
    the reason, until the words cease.
    """

    def __init__(
        self,
        settings: OperatorSettings,
        rate_Hz: float,
        platform: Platform,
        admission: Callable[[Array], int] | None,
        too_sudden: Callable[[PoseSample, float], bool],
    ) -> None:
        """Take the judge of poses (6,) m, rad: bits of Refusal; None: the reference is live.

        too_sudden: the judge of samples at a share of their speed, by what forces change by.
        """
        self._speeds = settings.setup_speed_m_s, radians(settings.setup_speed_deg_s)
        self._patience = max(1, int(WORD_S * rate_Hz + 1e-9))
        self._platform, self._admission, self._too_sudden = platform, admission, too_sudden
        self.reset()

    def reset(self) -> None:
        """Back to the start: no word."""
        self._word: Word | None = None
        self._path: JogPath | None = None
        self._way: tuple[int, int] | None = None
        self._stopped: Word | None = None
        self.refusal = ""
        """Why the jog does not go on; empty unless a limit has stopped it."""

    @property
    def waits(self) -> bool:
        """Whether a word has been taken that moves the platform yet to come."""
        return self._word is not None

    def let_go(self) -> None:
        """Come to rest."""
        self._word = self._stopped = None
        self.refusal = ""

    def take(self, order: Order, tick: int, motion: Motion, *, on_hold: bool, key: bool) -> str:
        """Take a jog word; return why it is refused, empty where it counts."""
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
        """Set how the jog goes on from a tick on, to which the motion has been advanced."""
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
        """Return the speed to go on at, 0 .. 1 of the path's; 0 where a limit is ahead, which is noted.

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
        self.refusal = f"jog {JOG_NAMES[word.axis]}: it stops, since beyond, {against}"
        return 0.0

    def _share(self, sample: PoseSample | None) -> float:
        return 1.0 if sample is None else setup_share(sample, self._speeds)
