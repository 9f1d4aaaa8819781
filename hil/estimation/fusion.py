"""Where the platform is: legs, model, tracker and IMU in one error-state Kalman filter on SE(3).

Equations of one interval: `hil.estimation.fusion_kernels`.

The state is pose and twist, with an IMU its biases, and where there is some the force along each leg that
neither model nor drives know: friction, inertia of motor and screw. It is carried from tick to tick by the
acceleration that the model gives for the forces which the drives report, at their own latching: the command
of the tick before would miss what the force loop and the bus do to it (1.1 ms at 1 kHz), the reference would
miss every disturbance and the law's own corrections. A drive that is silent is taken at its last command. On
the brakes there is no acceleration: no leg is doubted while they stop the platform, and once all legs that
are heard are at rest, so is the platform, in the direction that a lost leg leaves open, too.

Each leg gives length and rate. What contradicts the prediction is left out, leg by leg; where two legs do so
at once it is the prediction that was wrong, and the process noise of that interval is raised until it is
not. The encoder of a leg that alone is off by `encoder_slip_m` three ticks in a row has slipped, and stays
out. One that is off by less for ten ticks is believed: it takes a disturbance of 4 m/s^2 to look like a slip
of 0.2 mm. An encoder that drifts slowly cannot be told from a platform that does.

A sample of tracker or IMU belongs to an instant between two ticks that are past. The filter keeps the states,
covariances and measurements of the last ticks, puts the sample where it belongs and runs them again: the
result is that of a filter to which nothing was late. What was decided about a leg before stays decided.
"""

from collections.abc import Sequence
from math import ceil, inf, sqrt
from typing import NamedTuple

import numpy as np

from drivers.arrays import Array
from drivers.config import ImuSettings, TrackerSettings
from drivers.sensors import Readings, Sample
from drivers.signals import LEGS, DriveState
from drivers.tick_columns import Record
from hil.config.estimation import FusionSettings
from hil.estimation import fusion_layout as k
from hil.estimation.fusion_kernels import fill_estimate, rerun_kernel
from hil.estimation.fusion_noise import LegErrors, pack_noise
from hil.estimation.fusion_predict import accelerate_kernel, forces_at
from hil.mathematics.rotations import rotation_from_vector
from hil.robot.dynamics import Model
from hil.robot.geometry import Platform

SLIP_TICKS = 3
"""Contradictions in a row that make a slip."""
LEFT_OUT_TICKS = 10
"""For how long a leg is left out at most that contradicts the prediction, but not by as much as a slip."""
LOST_TICKS = 2
"""Age from which a leg counts as lost."""
STANDING_m_s = 5e-3
"""On shut brakes no leg is faster that stands."""
SILENT_SAMPLES = 5
"""A sensor that misses so many samples in a row is missed."""
_BIAS_STD = (0.05, 0.5)
"""rad/s and m/s^2, of an IMU whose biases nobody has seen."""
_START_STD = (1e-3, 1e-2, 1e-3, 1e-3)
"""Pose m and rad, linear and angular rate of a platform at rest whose legs have just been heard."""


class Health(NamedTuple):
    """What of the filter's work safety judges, beside what stands in the tick."""

    lost: tuple[bool, ...]
    """Which legs' encoders do not count: silent, blind, slipped."""
    slipped: tuple[bool, ...]
    position_std: float
    """m, the filter's own standard deviation of the position over all directions."""
    gap_s: float
    """Since the tracker's last sample of use arrived."""
    missed: bool
    """A configured tracker or IMU has been silent, refused or too late for SILENT_SAMPLES of its periods."""


class FusedEstimator:
    """The filter, from tick to tick.

    Mutable state: rings of states, covariances and intervals, their ticks, which one is the newest and how
    many there are; the last forces; ticks left out, contradictions in a row and slips per leg; when each
    sensor was last of use. `start` resets all of it.

    Parameters
    ----------
    model : carries the pose on.
    legs : what encoders and drives are wrong by.
    tracker, imu : the configured ones, with their standard deviations; None where there is none.
    """

    def __init__(
        self,
        platform: Platform,
        model: Model,
        settings: FusionSettings,
        legs: LegErrors,
        tracker: TrackerSettings | None,
        imu: ImuSettings | None,
        period_s: float,
    ) -> None:
        self._a = platform.base_joints
        self._b = platform.platform_joints
        self._radius = platform.radius
        self._model = model
        self._period_s = period_s
        self._slip = settings.encoder_slip_m
        self._noise = pack_noise(settings, legs, tracker, imu, platform.gravity)
        biased = imu is not None and settings.imu_biases
        n = 12 + 6 * int(biased) + 6 * int(legs.force_std_N > 0.0)
        oldest_s = max(tracker.latency_max_ms * 1e-3 if tracker else 0.0, 2.0 / imu.rate_Hz if imu else 0.0)
        size = ceil(oldest_s / period_s) + 3
        self._states = np.zeros((size, k.STATE))
        self._covariances = np.zeros((size, n, n))
        self._intervals = np.zeros((size, k.INTERVAL))
        self._patience = tuple(
            inf if sensor is None else SILENT_SAMPLES / sensor.rate_Hz / period_s for sensor in (tracker, imu)
        )
        self.start(0, 0, np.zeros(3), np.eye(3))

    def start(self, tick: int, t_ns: int, p: Array, R: Array) -> None:
        """Begin at rest at a pose that the legs have just given."""
        self._ticks = [0] * len(self._states)
        self._newest = 0
        self._count = 1
        self._ticks[0] = tick
        self._latched = [t_ns] * len(self._states)
        x, P = self._states[0], self._covariances[0]
        x[:] = 0.0
        x[0:3] = p
        x[3:12] = R.reshape(9)
        P[:] = 0.0
        for block, std in enumerate(_START_STD):
            for i in range(3):
                P[3 * block + i, 3 * block + i] = std * std
        forces = forces_at(len(P), self._noise) or len(P)
        for i in range(12, forces):
            P[i, i] = _BIAS_STD[(i - 12) // 3] ** 2
        for i in range(forces, len(P)):
            P[i, i] = self._noise[k.LEG_FORCE_VARIANCE]
        self._tau: Array | None = None
        self._left_out = [0] * LEGS
        self._against = [0] * LEGS
        self.slipped = [False] * LEGS
        self._heard = [tick, tick]

    def update(self, tick: Record, t_ns: int, readings: Readings, command: Array, wrench: Array) -> Health:
        """Fill estimate and fusion of a tick, at its latching, from its measurement. Never raises.

        The tick is after that of the last call. t_ns: when its SYNC was sent, whatever the clock; only
        differences count. command (6,) N: forces last sent; wrench (6,) N, N m: external load on the
        platform, base frame. innovation_q counts whether a leg was used or not; innovation_tracker is that
        of the newest sample that came in this tick, 0 without.
        """
        self._open(tick, t_ns, command, wrench)
        first, tracked = self._place(readings)
        size = len(self._states)
        count = (self._newest - first) % size + 1
        rerun_kernel(
            self._a, self._b, self._noise, self._intervals, self._states, self._covariances, first, count
        )
        return self._close(tick, tracked)

    # -- before the kernel ---------------------------------------------------------------------------

    def _open(self, tick: Record, t_ns: int, command: Array, wrench: Array) -> None:
        """Begin the interval that ends at the tick."""
        size = len(self._states)
        before = self._newest
        self._newest = now = (before + 1) % size
        self._count = min(self._count + 1, size)
        self._ticks[now] = int(tick["tick"])
        self._latched[now] = t_ns
        u = self._intervals[now]
        u[:] = 0.0
        u[k.T] = (t_ns - self._latched[before]) * 1e-9
        u[k.FADE] = 1.0
        u[k.LENGTH : k.LENGTH + 6] = tick["length"]
        u[k.RATE : k.RATE + 6] = tick["rate"]
        age = tick["age"]
        ages = age.tolist()
        free = bool((tick["drive_state"] == DriveState.RUN).all())
        stands = self._stands(tick)
        for leg in range(LEGS):
            if ages[leg] == 0 and not self.slipped[leg]:
                doubted = (free or stands) and self._left_out[leg] < LEFT_OUT_TICKS
                u[k.USED + leg] = 1.0 if doubted else k.KEPT
        heard = (age == 0) | (tick["blind"] != 0)
        tau = np.where(heard, tick["drive_force"], command)
        if free:
            mean = tau if self._tau is None else 0.5 * (tau + self._tau)
            model = self._model
            accelerate_kernel(model.constants, model.code, self._states[before], mean, wrench, u)
            self._tau = tau
        else:
            self._tau = None
            if stands and u[k.T] > 0.0:
                u[k.DTWIST : k.DTWIST + 6] = self._states[before, 12:18] / -u[k.T]

    def _stands(self, tick: Record) -> bool:
        """Tell whether all brakes are shut and no leg that is heard moves."""
        fresh = tick["age"] == 0
        shut = not (tick["drive_state"] == DriveState.RUN).any()
        return shut and bool(fresh.any()) and float(np.abs(tick["rate"][fresh]).max()) < STANDING_m_s

    def _instant(self, sample: Sample) -> float | None:
        """Return when a sample was taken, ns on the clock of `update`; None if the rings do not reach."""
        size = len(self._states)
        for back in range(self._count):
            i = (self._newest - back) % size
            since = sample.tick - self._ticks[i]
            if since >= 0:
                return self._latched[i] + 1e9 * (since * self._period_s + sample.offset_s)
        return None

    def _interval_of(self, at_ns: float) -> int | None:
        """Return which interval holds an instant; None when it is older than all, or not past."""
        size = len(self._states)
        if at_ns > self._latched[self._newest]:
            return None
        for back in range(self._count - 1):
            i = (self._newest - back) % size
            if at_ns > self._latched[(i - 1) % size]:
                return i
        return None

    def _place(self, readings: Readings) -> tuple[int, int | None]:
        """Put samples into their intervals; return the first to run again, and the newest with a new pose.

        A sample is passed over that is older than the rings, or stamped after the newest latching.
        """
        first, size = self._newest, len(self._states)
        tracked = None
        for kind, samples in enumerate((readings.tracker, readings.imu)):
            for sample in samples:
                at_ns = self._instant(sample)
                i = None if at_ns is None else self._interval_of(at_ns)
                if at_ns is None or i is None:
                    continue
                u = self._intervals[i]
                share = 1.0 - (self._latched[i] - at_ns) * 1e-9 / float(u[k.T])
                if kind == 0:
                    _write_tracker(u, share, sample)
                    tracked = i
                else:
                    _write_imu(u, share, sample)
                    self._heard[1] = self._ticks[self._newest]
                if (self._newest - i) % size > (self._newest - first) % size:
                    first = i
        return first, tracked

    # -- after the kernel ----------------------------------------------------------------------------

    def _close(self, tick: Record, tracked: int | None) -> Health:
        now = self._newest
        x, u, P = self._states[now], self._intervals[now], self._covariances[now]
        fill_estimate(self._a, self._b, self._radius, x, u, P, tick)
        used = [share != 0.0 for share in u[k.USED : k.USED + 6].tolist()]
        ages = tick["age"].tolist()
        for leg, off in enumerate(tick["innovation_q"].tolist()):
            left_out = ages[leg] == 0 and not used[leg]
            self._left_out[leg] = self._left_out[leg] + 1 if left_out else 0
            self._against[leg] = self._against[leg] + 1 if left_out and abs(off) > self._slip else 0
            if self._against[leg] >= SLIP_TICKS:
                self.slipped[leg] = True
        lost = tuple(
            age >= LOST_TICKS or blind != 0 or slipped
            for age, blind, slipped in zip(ages, tick["blind"].tolist(), self.slipped, strict=True)
        )
        number = self._ticks[now]
        if tracked is not None:
            v = self._intervals[tracked]
            tick["tracker"] = int(v[k.TRACKER])
            tick["innovation_tracker"] = v[k.TRACKER_INNOVATION : k.TRACKER_INNOVATION + 6]
            if v[k.TRACKER] > 0:
                self._heard[0] = number
        missed = any(
            number - heard > patience for heard, patience in zip(self._heard, self._patience, strict=True)
        )
        sx, sy, sz, *_ = tick["pose_std"].tolist()
        tick["legs_used"], tick["legs_lost"], tick["legs_slipped"] = map(_bits, (used, lost, self.slipped))
        return Health(
            lost,
            tuple(self.slipped),
            sqrt(sx * sx + sy * sy + sz * sz),
            (number - self._heard[0]) * self._period_s,
            missed,
        )


def _bits(legs: Sequence[bool]) -> int:
    return sum(1 << leg for leg in range(LEGS) if legs[leg])


def _write_tracker(u: Array, share: float, sample: Sample) -> None:
    u[k.TRACKER] = k.UNDECIDED
    u[k.TRACKER_AT] = share
    u[k.TRACKER_P : k.TRACKER_P + 3] = sample.values[:3]
    u[k.TRACKER_R : k.TRACKER_R + 9] = rotation_from_vector(np.array(sample.values[3:])).reshape(9)


def _write_imu(u: Array, share: float, sample: Sample) -> None:
    u[k.IMU] = 1.0
    u[k.IMU_AT] = share
    u[k.GYRO : k.GYRO + 6] = sample.values
