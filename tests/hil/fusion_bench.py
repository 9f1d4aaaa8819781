"""A pushed or driven platform, its measurements, and the filter that follows it."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from drivers.arrays import Array
from drivers.sensing.settings import ImuSettings, TrackerSettings
from drivers.signals import DriveState
from drivers.tick_columns import Record
from hil.config.estimation import FusionSettings
from hil.contracts.records import altered, record_of
from hil.estimation.fusion import FusedEstimator
from hil.estimation.fusion_layout import LegErrors
from hil.robot.dynamics import Model
from hil.robot.geometry import Platform
from tests import sensor_samples
from tests.sensor_samples import Readings, Sample

BOOK = json.loads((Path(__file__).parents[1] / "data" / "book_platform.json").read_text())["geometry"]
PLATFORM = Platform.from_dict(BOOK)
A, B = PLATFORM.base_joints.copy(), PLATFORM.platform_joints.copy()
T = 1e-3
MS = 1_000_000
ZERO = np.zeros(6)
LOOSE = FusionSettings(
    acceleration_noise_m_s2_sqrtHz=0.5, angular_acceleration_noise_rad_s2_sqrtHz=0.4, gate_std=50.0
)
LOOSE_LEGS = LegErrors(length_std_m=1e-4, rate_std_m_s=1e-2)
LEGS = LegErrors(length_std_m=3e-7, rate_std_m_s=1e-3)
TRACKER = TrackerSettings(position_std_m=2e-3, orientation_std_deg=0.1)
ROTATION_STD = np.deg2rad(0.1)


class Truth:
    """Platform pushed by random accelerations. Rate and noise are those that the filter assumes."""

    def __init__(self, seed: int, settings: FusionSettings = LOOSE) -> None:
        self.chance = np.random.default_rng(seed)
        self.settings = settings
        self.p, self.R, self.twist = (
            np.array([0.05, -0.1, 1.1]),
            Rotation.from_rotvec([0.1, -0.05, 0.2]),
            ZERO,
        )
        s = settings
        self.push = np.repeat(
            [s.acceleration_noise_m_s2_sqrtHz, s.angular_acceleration_noise_rad_s2_sqrtHz], 3
        ) / np.sqrt(T)

    def step(self) -> None:
        a = self.push * self.chance.standard_normal(6)
        self.p = self.p + T * self.twist[:3] + T * T / 2 * a[:3]
        self.R = Rotation.from_rotvec(T * self.twist[3:] + T * T / 2 * a[3:]) * self.R
        self.twist = self.twist + T * a

    def measure(self, *, noise: float = 1.0) -> Record:
        q, dq = legs(self.p, self.R, self.twist)
        s, normal = LOOSE_LEGS, self.chance.standard_normal
        return measurement(q + noise * s.length_std_m * normal(6), dq + noise * s.rate_std_m_s * normal(6))

    def track(self, tick: int, offset_s: float, off: Array = ZERO) -> Sample:
        """Sample of the present pose, off by a constant (6,), with the time stamp of another instant."""
        p = self.p + off[:3] + TRACKER.position_std_m * self.chance.standard_normal(3)
        R = Rotation.from_rotvec(off[3:] + ROTATION_STD * self.chance.standard_normal(3)) * self.R
        return Sample(tick, offset_s, (*p, *R.as_rotvec()))

    def feel(self, tick: int, imu: ImuSettings, biases: Array) -> Sample:
        """Step, and sample an IMU with biases (6,) of rate and force at the end of the interval."""
        before = self.twist[:3]
        self.step()
        acceleration = (self.twist[:3] - before) / T
        measured = np.concatenate(
            (self.R.inv().apply(self.twist[3:]), self.R.inv().apply(acceleration - PLATFORM.gravity))
        )
        std = np.repeat([imu.angular_rate_std_rad_s, imu.specific_force_std_m_s2], 3)
        return Sample(tick - 1, 0.999e-3, (*(measured + biases + std * self.chance.standard_normal(6)),))


def legs(p, R, twist):
    r = R.apply(B)
    d = p + r - A
    l = np.linalg.norm(d, axis=1)
    u = twist[:3] + np.cross(twist[3:], r)
    return l, np.sum(d / l[:, None] * u, axis=1)


def measurement(q, dq, *, lost=()) -> Record:
    """Measurement with all drives off: the filter takes the acceleration as zero."""
    return record_of(length=q, rate=dq, age=[9 * (leg in lost) for leg in range(6)])


def estimator(settings=LOOSE, errors=LOOSE_LEGS, start=None, imu=None):
    found = FusedEstimator(PLATFORM, Model(PLATFORM), settings, errors, TRACKER, imu, T)
    truth = start or Truth(0)
    found.start(0, 0, truth.p, truth.R.as_matrix())
    return found


class Fused:
    """A tick that the filter has filled, and its health."""

    def __init__(self, found, tick, measured, readings, t_ns=None):
        self.record = altered(measured, tick=tick)
        t_ns = tick * MS if t_ns is None else t_ns
        self.health = sensor_samples.update(found, self.record, t_ns, readings, ZERO, ZERO)

    def __getitem__(self, name):
        return self.record[name]

    @property
    def used(self):
        return tuple(bool(self.record["legs_used"] >> leg & 1) for leg in range(6))


def update(found, tick, measured, samples=(), felt=()):
    return Fused(found, tick, measured, Readings(tracker=tuple(samples), imu=tuple(felt)))


def error(fused, truth):
    turned = Rotation.from_matrix(fused["R"]).inv()
    return np.concatenate(
        (truth.p - fused["p"], (truth.R * turned).as_rotvec(), truth.twist - fused["twist"])
    )


def settled(settings=None):
    """Filter of micrometre legs after some time at rest, and the truth."""
    truth = Truth(7)
    found = estimator(settings or FusionSettings(), LEGS, start=truth)
    for tick in range(1, 100):
        update(found, tick, measurement(*legs(truth.p, truth.R, ZERO)))
    return found, truth


class Driven:
    """Platform on its drives, at rest at its pose, with an unreported force along each leg."""

    def __init__(self, unknown) -> None:
        start = Truth(0)
        self.p, self.R, self.twist = start.p, start.R, ZERO
        self.model = Model(PLATFORM)
        self.unknown = np.array(unknown, float)
        self.dtwist = ZERO
        self.hold = self.model.inverse_dynamics(self.p, self.R.as_matrix(), ZERO, ZERO)

    def step(self, tau) -> None:
        n = 20
        for _ in range(n):
            acting = np.asarray(tau) + self.unknown
            self.dtwist = self.model.forward_dynamics(self.p, self.R.as_matrix(), self.twist, acting)
            dt = T / n
            self.p = self.p + dt * self.twist[:3] + dt * dt / 2 * self.dtwist[:3]
            self.R = Rotation.from_rotvec(dt * self.twist[3:] + dt * dt / 2 * self.dtwist[3:]) * self.R
            self.twist = self.twist + dt * self.dtwist

    def measure(self, tau, *, skew_s=0.0, scale=1.0) -> Record:
        q, _ = legs(self.p, self.R, self.twist)
        there = Rotation.from_rotvec(skew_s * self.twist[3:]) * self.R
        _, dq = legs(self.p + skew_s * self.twist[:3], there, self.twist + skew_s * self.dtwist)
        return altered(measurement(q, scale * dq), drive_force=tau, drive_state=[DriveState.RUN] * 6)


def state_of(found):
    """Newest state (30,) and covariance of a filter."""
    newest = found.record["newest"]
    return found._steps[newest]["x"], found._covariances[newest]
