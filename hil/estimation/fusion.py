"""Pose from legs, model, tracker and IMU: one error-state Kalman filter on SE(3).

Equations of one interval: `hil.estimation.fusion_kernels`.

The state is pose and twist; with an IMU also its biases; with a tracker also the constant errors of its
stamps and of its pose, which six legs reveal; optionally the force along each leg that neither
model nor drives know: friction, inertia of motor and screw. The prediction from tick to tick uses the model's
acceleration under the forces that the drives report, at their own latching. The command of the tick before
would miss the delay of force loop and bus (1.1 ms at 1 kHz). The reference would miss every disturbance and
the law's own corrections. For a silent drive, and for drives that report no force, the last command is used.
On the brakes there is no acceleration: while they stop the platform, no leg is doubted. Once all legs with
readings are at rest, the platform is at rest, too, also in the direction that a lost leg leaves open.

Polled encoders sample one after the other. Their rates bring the lengths to the instant of the first one.

Each leg gives length and rate. A leg that contradicts the prediction is left out. If two legs do so at once,
the prediction was wrong, and the process noise of that interval is raised until it fits. The encoder of a leg
that alone is off by `encoder_slip_m` three ticks in a row has slipped, and stays out. A leg that is off by
less for ten ticks is trusted again: a disturbance of 4 m/s^2 is needed to look like a slip of 0.2 mm. An
encoder that drifts slowly cannot be told from a platform that drifts.

A sample of tracker or IMU belongs to an instant between two past ticks. The filter keeps the states,
covariances and measurements of the last ticks, inserts the sample at its instant and runs them again. The
result equals that of a filter with all samples in time. Earlier decisions about legs stay.
"""

from math import ceil, inf

import numpy as np

from drivers.arrays import Array
from drivers.compiled.pointed import Callee, context_of, data_at
from drivers.sensing.settings import ImuSettings, TrackerSettings
from drivers.signals import LEGS
from drivers.tick_columns import Record
from hil.config.estimation import FusionSettings
from hil.estimation.fusion_layout import FUSION, STEP, LegErrors
from hil.estimation.fusion_tick import fuse, latched_at
from hil.robot.dynamics import Model
from hil.robot.geometry import Platform

SILENT_SAMPLES = 5
"""A sensor is missed after this number of missing samples in a row."""
_BIAS_STD = (0.05, 0.5)
"""Standard deviations, rad/s and m/s^2, of the unknown biases of an IMU."""
_STAMP_STD_s, _STAMP_WALK_s_sqrts, _MEMORY_s = 3e-3, 1e-5, 30.0
"""s, s/sqrt(s) and s: constant error of the tracker's stamps, its random walk, and the time over which the
filter remembers the tracker's offset, whose initial deviation is that of the noise."""
_START_STD = (1e-3, 1e-2, 1e-3, 1e-3)
"""Pose m and rad, linear and angular rate of a platform at rest, just after a reading of all legs."""


class FusedEstimator:
    """The fusion filter, from tick to tick, with the legs that may be lost, warnings and faults.

    Mutable state, in its record and the rings that this points to: states, covariances and intervals, their
    ticks, the newest one and their number; the last forces; ticks left out, contradictions in a row and slips
    per leg; the last use of each sensor; the mean of the tracker's innovations. `start` resets all of it.

    Parameters
    ----------
    model : predicts the pose.
    legs : errors of encoders and drives.
    tracker, imu : the configured sensors, with their standard deviations; None without one.
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
        offsets = n + 6 * int(legs.force_std_N > 0.0)
        errors = offsets + 7 * int(tracker is not None)
        oldest_s = max(tracker.latency_max_ms * 1e-3 if tracker else 0.0, 2.0 / imu.rate_Hz if imu else 0.0)
        size = ceil(oldest_s / period_s) + 3
        self._steps, self._covariances = np.zeros(size, STEP), np.zeros((size, errors, errors))
        seen = {}
        if tracker is not None:
            seen["r_position"] = tracker.position_std_m**2
            seen["r_rotation"] = np.deg2rad(tracker.orientation_std_deg) ** 2
            seen["q_stamp"], share = _STAMP_WALK_s_sqrts**2, 1.0 / tracker.rate_Hz / _MEMORY_s**2
            seen["q_position"], seen["q_rotation"] = share * seen["r_position"], share * seen["r_rotation"]
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
            reports_force=legs.reports_force,
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
            offsets=offsets,
            **seen,
        )
        self.fuse = Callee(fuse.address, data_at(self.record), self)
        """Arguments: (filter, sensors, command, wrench, tick). Fills estimate and fusion of a tick at its
        latching; the tick must follow that of the last call or `start`. innovation_q is filled also for
        unused legs; innovation_tracker is that of the newest sample that came in this tick, 0 without."""
        self.start(0, 0, np.zeros(3), np.eye(3))

    @property
    def contradicting(self) -> tuple[int, ...]:
        """Legs whose encoders have slipped although the configuration allows no loss of them."""
        return tuple(leg for leg in range(LEGS) if self.record["contradicting"] >> leg & 1)

    def begin(self, tick: Record) -> None:
        """Start the filter at rest at the pose that the legs gave in this tick."""
        self.start(int(tick["tick"]), latched_at(tick), tick["p"], tick["R"])

    def start(self, tick: int, t_ns: int, p: Array, R: Array) -> None:
        """Start at rest at a pose just measured: p (3,) m, R (3, 3), base frame; t_ns: of its sampling."""
        for name in ("newest", "driven", "left_out", "against", "slipped", "mean", "strays"):
            self.record[name] = 0
        self.record["count"], self.record["heard"], self.record["R"] = 1, tick, R
        self._steps["tick"], self._steps["latched_ns"] = 0, t_ns
        self._steps[0]["tick"], forces = tick, int(self.record["forces"])
        x, P = self._steps[0]["x"], self._covariances[0]
        x[:] = 0.0
        x[0:3], x[3:12] = p, np.reshape(R, 9)
        std = np.repeat((*_START_STD, *_BIAS_STD), 3)[:forces]
        P[:] = 0.0
        f, forced = self.record, int(self.record["offsets"]) - forces
        own = [_STAMP_STD_s**2, *[f["r_position"]] * 3, *[f["r_rotation"]] * 3][: len(P) - f["offsets"]]
        np.fill_diagonal(P, [*(std * std), *[f["leg_force"]] * forced, *own])
