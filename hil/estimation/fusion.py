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

from math import ceil, inf

import numpy as np

from drivers.arrays import Array
from drivers.compiled.pointed import Callee, context_of, data_at
from drivers.config import ImuSettings, TrackerSettings
from drivers.signals import LEGS
from drivers.tick_columns import Record
from hil.config.estimation import FusionSettings
from hil.estimation.fusion_layout import FUSION, STEP, LegErrors
from hil.estimation.fusion_tick import fuse, latched_at
from hil.robot.dynamics import Model
from hil.robot.geometry import Platform

SILENT_SAMPLES = 5
"""A sensor that misses so many samples in a row is missed."""
_BIAS_STD = (0.05, 0.5)
"""rad/s and m/s^2, of an IMU whose biases nobody has seen."""
_START_STD = (1e-3, 1e-2, 1e-3, 1e-3)
"""Pose m and rad, linear and angular rate of a platform at rest whose legs have just been heard."""


class FusedEstimator:
    """The filter, from tick to tick, with which legs may be lost, what warns and what faults.

    Mutable state, in its record and the rings that this leads to: states, covariances and intervals, their
    ticks, which one is the newest and how many there are; the last forces; ticks left out, contradictions in
    a row and slips per leg; when each sensor was last of use. `start` resets all of it.

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
        self._model = model
        n = 12 + 6 * int(imu is not None and settings.imu_biases)
        errors = n + 6 * int(legs.force_std_N > 0.0)
        oldest_s = max(tracker.latency_max_ms * 1e-3 if tracker else 0.0, 2.0 / imu.rate_Hz if imu else 0.0)
        size = ceil(oldest_s / period_s) + 3
        self._steps, self._covariances = np.zeros(size, STEP), np.zeros((size, errors, errors))
        seen = {}
        if tracker is not None:
            seen["r_position"] = tracker.position_std_m**2
            seen["r_rotation"] = np.deg2rad(tracker.orientation_std_deg) ** 2
        if imu is not None:
            seen["r_gyro"] = imu.angular_rate_std_rad_s**2
            seen["r_force"] = imu.specific_force_std_m_s2**2
            seen["q_gyro_bias"] = settings.gyro_bias_walk_rad_s_sqrts**2
            seen["q_force_bias"] = settings.accelerometer_bias_walk_m_s2_sqrts**2
        self.record = context_of(
            FUSION,
            base_joints=platform.base_joints,
            platform_joints=platform.platform_joints,
            radius=platform.radius,
            constants=model.constants,
            code=model.code,
            period_s=period_s,
            slip_m=settings.encoder_slip_m,
            patience=[
                inf if each is None else SILENT_SAMPLES / each.rate_Hz / period_s for each in (tracker, imu)
            ],
            q_v=settings.acceleration_noise_m_s2_sqrtHz**2,
            q_w=settings.angular_acceleration_noise_rad_s2_sqrtHz**2,
            r_length=legs.length_std_m**2,
            r_rate=legs.rate_std_m_s**2,
            latch=(settings.latch_std_us * 1e-6) ** 2,
            rate_skew=legs.rate_skew_std_s**2,
            rate_scale=legs.rate_scale_std**2,
            leg_force=legs.force_std_N**2,
            leg_force_s=legs.force_time_s,
            gate=settings.gate_std**2,
            gravity=platform.gravity,
            may_lose=[leg in settings.may_lose_legs for leg in range(LEGS)],
            at_once=settings.lost_at_once,
            gap_max_s=settings.tracker_gap_max_ms * 1e-3,
            std_max_m=settings.position_std_max_m,
            steps=self._steps,
            covariances=self._covariances,
            size=size,
            errors=errors,
            forces=n,
            **seen,
        )
        self.fuse = Callee(fuse.address, data_at(self.record), self)
        """(filter, sensors, command, wrench, tick): fills estimate and fusion of a tick at its latching. The
        tick is after that of the last call, `start` or this. innovation_q counts whether a leg was used or
        not; innovation_tracker is that of the newest sample that came in this tick, 0 without."""
        self.start(0, 0, np.zeros(3), np.eye(3))

    @property
    def contradicting(self) -> tuple[int, ...]:
        """Legs whose encoders have slipped and may not be lost."""
        return tuple(leg for leg in range(LEGS) if self.record["contradicting"] >> leg & 1)

    def begin(self, tick: Record) -> None:
        """Begin at rest at the pose that the legs give in a tick."""
        self.start(int(tick["tick"]), latched_at(tick), tick["p"], tick["R"])

    def start(self, tick: int, t_ns: int, p: Array, R: Array) -> None:
        """Begin at rest at a pose that the legs have just given, at their latching, ns."""
        for name in ("newest", "driven", "left_out", "against", "slipped"):
            self.record[name] = 0
        self.record["count"], self.record["heard"], self.record["R"] = 1, tick, R
        self._steps["tick"], self._steps["latched_ns"] = 0, t_ns
        self._steps[0]["tick"], forces = tick, int(self.record["forces"])
        x, P = self._steps[0]["x"], self._covariances[0]
        x[:] = 0.0
        x[0:3], x[3:12] = p, np.reshape(R, 9)
        std = np.repeat((*_START_STD, *_BIAS_STD), 3)[:forces]
        P[:] = 0.0
        np.fill_diagonal(P, [*(std * std), *[self.record["leg_force"]] * (len(P) - forces)])
