"""The filter against a plain NumPy one, its own statistics, late samples, and encoders that go wrong."""

from __future__ import annotations

import json
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from drivers.config import ImuSettings, TrackerSettings
from drivers.signals import DriveState
from drivers.tick_columns import Record
from hil.config.estimation import FusionSettings
from hil.contracts.records import altered, record_of
from hil.estimation.fusion import FusedEstimator
from hil.estimation.fusion_kernels import bend
from hil.estimation.fusion_layout import LegErrors
from hil.estimation.fusion_tick import LEFT_OUT_TICKS, SLIP_TICKS
from hil.robot.dynamics import Model
from hil.robot.geometry import Platform
from tests import sensed
from tests.sensed import Readings, Sample

BOOK = json.loads((Path(__file__).parents[1] / "data" / "book_platform.json").read_text())["geometry"]
PLATFORM = Platform.from_dict(BOOK)
A, B = PLATFORM.base_joints.copy(), PLATFORM.platform_joints.copy()
T = 1e-3
MS = 1_000_000
ZERO = np.zeros(6)
LOOSE = FusionSettings(
    acceleration_noise_m_s2_sqrtHz=0.5,
    angular_acceleration_noise_rad_s2_sqrtHz=0.4,
    gate_std=50.0,
)
LOOSE_LEGS = LegErrors(length_std_m=1e-4, rate_std_m_s=1e-2)
LEGS = LegErrors(length_std_m=3e-7, rate_std_m_s=1e-3)
TRACKER = TrackerSettings(position_std_m=2e-3, orientation_std_deg=0.1)
ROTATION_STD = np.deg2rad(0.1)


class Truth:
    """A platform that random accelerations push about. Rate and noise as the filter believes them."""

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

    def track(self, tick: int, offset_s: float) -> Sample:
        """Return a sample of the present pose, as if it had been taken then."""
        p = self.p + TRACKER.position_std_m * self.chance.standard_normal(3)
        R = Rotation.from_rotvec(ROTATION_STD * self.chance.standard_normal(3)) * self.R
        return Sample(tick, offset_s, (*p, *R.as_rotvec()))


def legs(p, R, twist):
    r = R.apply(B)
    d = p + r - A
    l = np.linalg.norm(d, axis=1)
    u = twist[:3] + np.cross(twist[3:], r)
    return l, np.sum(d / l[:, None] * u, axis=1)


def measurement(q, dq, *, lost=()) -> Record:
    """All drives off: the filter takes the acceleration as zero."""
    return record_of(length=q, rate=dq, age=[9 * (leg in lost) for leg in range(6)])


def estimator(settings=LOOSE, errors=LOOSE_LEGS, start=None):
    found = FusedEstimator(PLATFORM, Model(PLATFORM), settings, errors, TRACKER, None, T)
    truth = start or Truth(0)
    found.start(0, 0, truth.p, truth.R.as_matrix())
    return found


class Fused:
    """A tick that the filter has filled, and its health."""

    def __init__(self, found, tick, measured, readings, t_ns=None):
        self.record = altered(measured, tick=tick)
        t_ns = tick * MS if t_ns is None else t_ns
        self.health = sensed.update(found, self.record, t_ns, readings, ZERO, ZERO)

    def __getitem__(self, name):
        return self.record[name]

    @property
    def used(self):
        return tuple(bool(self.record["legs_used"] >> leg & 1) for leg in range(6))


def update(found, tick, measured, samples=()):
    return Fused(found, tick, measured, Readings(tracker=tuple(samples)))


def error(fused, truth):
    turned = Rotation.from_matrix(fused["R"]).inv()
    return np.concatenate(
        (truth.p - fused["p"], (truth.R * turned).as_rotvec(), truth.twist - fused["twist"])
    )


# -- against a plain one ---------------------------------------------------------------------------------------


class Plain:
    """An extended Kalman filter with numerical derivatives, batch updates and inverses, second order in lengths."""

    def __init__(self, truth: Truth) -> None:
        self.p, self.R, self.twist = truth.p, truth.R, ZERO
        self.P = np.diag(np.repeat([1e-3, 1e-2, 1e-3, 1e-3], 3) ** 2)

    def moved(self, d):
        return self.p + d[:3], Rotation.from_rotvec(d[3:6]) * self.R, self.twist + d[6:]

    def jacobian(self, function):
        """Central differences of function(pose, twist) about the present state."""
        columns = []
        for e in np.eye(12):
            h = 1e-5
            columns.append((function(*self.moved(h * e)) - function(*self.moved(-h * e))) / (2 * h))
        return np.array(columns).T

    def predict(self, dt):
        p1, R1, twist1 = (
            self.p + dt * self.twist[:3],
            Rotation.from_rotvec(dt * self.twist[3:]) * self.R,
            self.twist,
        )

        def after(p, R, twist):
            R2 = Rotation.from_rotvec(dt * twist[3:]) * R
            return np.concatenate((p + dt * twist[:3] - p1, (R2 * R1.inv()).as_rotvec(), twist - twist1))

        F = self.jacobian(after)
        Q = np.zeros((12, 12))
        for k, density in (
            (0, LOOSE.acceleration_noise_m_s2_sqrtHz),
            (3, LOOSE.angular_acceleration_noise_rad_s2_sqrtHz),
        ):
            q = density**2
            for i in range(k, k + 3):
                Q[i, i], Q[i, 6 + i], Q[6 + i, i], Q[6 + i, 6 + i] = (
                    q * dt**3 / 3,
                    q * dt**2 / 2,
                    q * dt**2 / 2,
                    q * dt,
                )
        self.P = F @ self.P @ F.T + Q
        self.p, self.R, self.twist = p1, R1, twist1

    def bends(self, function, count):
        """Return mean and variance of the second-order terms of the first numbers of function(pose, twist)."""
        h, N = 1e-3, np.zeros((count, 6, 6))
        for i, j in np.ndindex(6, 6):
            for a, b in ((1, 1), (1, -1), (-1, 1), (-1, -1)):
                d = h * (a * np.eye(12)[i] + b * np.eye(12)[j])
                N[:, i, j] += a * b * function(*self.moved(d))[:count] / (4 * h * h)
        NP = N @ self.P[:6, :6]
        return np.einsum("lii->l", NP) / 2, np.einsum("lij,lji->l", NP, NP) / 2

    def update(self, function, z, r, bent=0):
        H = self.jacobian(function)
        mean, variance = (np.append(x, np.zeros(len(z) - bent)) for x in self.bends(function, bent))
        S = H @ self.P @ H.T + np.diag(r + variance)
        K = self.P @ H.T @ np.linalg.inv(S)
        d = K @ (z - mean - function(self.p, self.R, self.twist))
        self.P = self.P - K @ H @ self.P
        self.p, self.R, self.twist = self.moved(d)


def lost_leg(tick):
    return (2,) if tick > 60 else ()


def test_it_is_the_plain_filter_with_a_leg_lost_and_a_tracker_between_ticks():
    truth = Truth(1)
    plain, found = Plain(truth), estimator(start=truth)
    for tick in range(1, 121):
        samples = []
        share = 0.0
        if tick % 5 == 0:  # in the middle of the interval, where the truth is that of its beginning
            samples, share = [truth.track(tick - 1, 0.3e-3)], 0.3
        truth.step()
        m = truth.measure()
        lost = lost_leg(tick)
        fused = update(found, tick, measurement(m["length"], m["rate"], lost=lost), samples)
        if samples:
            plain.predict(share * T)
            z = np.array(samples[0].values)
            Z = Rotation.from_rotvec(z[3:])
            prior = plain.R

            def pose(p, R, twist, Z=Z, prior=prior):
                return np.concatenate((p, (R * prior.inv()).as_rotvec()))

            target = np.concatenate((z[:3], (Z * prior.inv()).as_rotvec()))
            plain.update(pose, target, np.repeat([TRACKER.position_std_m, ROTATION_STD], 3) ** 2)
        plain.predict((1 - share) * T)
        kept = [leg for leg in range(6) if leg not in lost]

        def both(p, R, twist, kept=kept):
            l, dl = legs(p, R, twist)
            return np.concatenate((l[kept], dl[kept]))

        z = np.concatenate((m["length"][kept], m["rate"][kept]))
        r = np.repeat([LOOSE_LEGS.length_std_m, LOOSE_LEGS.rate_std_m_s], len(kept)) ** 2
        plain.update(both, z, r, bent=len(kept))
        P = found._covariances[found.record["newest"]]
        scale = np.sqrt(np.outer(plain.P.diagonal(), plain.P.diagonal()))
        assert np.abs((P - plain.P) / scale).max() < 1e-5
        assert np.abs(fused["p"] - plain.p).max() < 1e-8
        assert (Rotation.from_matrix(fused["R"]) * plain.R.inv()).magnitude() < 1e-8
        assert np.abs(fused["twist"] - plain.twist).max() < 1e-6
        assert fused.used == tuple(leg not in lost for leg in range(6))


# -- its own statistics ----------------------------------------------------------------------------------------


@pytest.mark.parametrize("lost", [(4,), pytest.param((), marks=pytest.mark.long)])
def test_its_errors_are_as_large_as_it_says(lost):
    """Mean of e^T P^-1 e / 12 over independent runs: 1, within five standard deviations of that mean."""
    runs, ticks = 20, 150
    nees = []
    for seed in range(runs):
        truth = Truth(seed)
        found = estimator(start=truth)
        for tick in range(1, ticks):
            samples = [truth.track(tick - 1, 0.0)] if tick % 5 == 0 else []
            truth.step()
            m = truth.measure()
            fused = update(found, tick, measurement(m["length"], m["rate"], lost=lost), samples)
        e = error(fused, truth)
        nees.append(e @ np.linalg.solve(found._covariances[found.record["newest"]], e) / 12)
    assert np.mean(nees) == pytest.approx(1.0, abs=5 * np.sqrt(2 / (12 * runs)))


# -- late samples ----------------------------------------------------------------------------------------------


def test_a_late_sample_leaves_the_filter_as_if_it_had_been_in_time():
    truth = Truth(3)
    prompt, tardy = estimator(start=truth), estimator(start=truth)
    waiting: list[tuple[int, Sample]] = []
    for tick in range(1, 101):
        samples = [truth.track(tick - 1, 0.0004)] if tick % 3 == 0 and tick < 90 else []
        waiting += [(tick + 4 + tick % 5, sample) for sample in samples]
        truth.step()
        m = truth.measure()
        a = update(prompt, tick, m, samples)
        b = update(tardy, tick, m, [sample for due, sample in waiting if due == tick])
    assert np.array_equal(a["p"], b["p"])
    assert np.array_equal(a["R"], b["R"])
    assert np.array_equal(a["twist"], b["twist"])
    assert np.array_equal(
        prompt._covariances[prompt.record["newest"]], tardy._covariances[tardy.record["newest"]]
    )


def test_a_late_sample_is_taken_at_its_own_instant():
    """A platform that moves at 1 m/s: 8 ms late would be 8 mm off."""
    truth = Truth(4, LOOSE.model_copy(update={"acceleration_noise_m_s2_sqrtHz": 1e-9}))
    truth.twist = np.array([1.0, 0, 0, 0, 0, 0])
    found = estimator(start=truth)
    innovations, waiting = [], []
    for tick in range(1, 200):
        truth.step()
        waiting.append(Sample(tick, 0.0, (*truth.p, *truth.R.as_rotvec())))
        fused = update(found, tick, truth.measure(noise=0.0), [waiting[-9]] if len(waiting) > 8 else [])
        innovations.append(fused["innovation_tracker"])
    assert np.abs(innovations[50:]).max() < 1e-4


def test_a_sample_older_than_the_memory_or_stamped_ahead_is_passed_over():
    truth = Truth(5)
    found, without = estimator(start=truth), estimator(start=truth)
    for tick in range(1, 60):
        old, ahead = (
            Sample(max(tick - 40, 0), 0.0, (1, 2, 3, 0, 0, 0)),
            Sample(tick, 2e-4, (1, 2, 3, 0, 0, 0)),
        )
        m = truth.measure()
        a = update(found, tick, m, [old, ahead] if tick > 41 else [])
        b = update(without, tick, m)
        assert a["tracker"] == 0
    assert np.array_equal(a["p"], b["p"])
    assert a.health.missed, "no sample of use for five periods"


def test_missed_ticks_and_a_late_loop_are_taken_into_account():
    truth = Truth(6, LOOSE.model_copy(update={"acceleration_noise_m_s2_sqrtHz": 1e-9}))
    truth.twist = np.array([0.5, 0.2, 0, 0, 0, 0])
    tight = LOOSE.model_copy(update={"gate_std": 6.0})
    found = estimator(tight, LOOSE_LEGS._replace(length_std_m=1e-6), start=truth)
    tick = now = 0
    p0 = truth.p
    for k in range(200):
        step = 4 if k % 50 == 49 else 1
        tick += step
        late = 300_000 if k % 7 == 3 else 0
        now = tick * MS + late
        truth.p = p0 + truth.twist[:3] * now * 1e-9
        q, dq = legs(truth.p, truth.R, truth.twist)
        fused = Fused(found, tick, measurement(q, dq), Readings(), now)
        if k > 5:
            assert all(fused.used)
            assert np.abs(fused["innovation_q"]).max() < 1e-7


# -- encoders --------------------------------------------------------------------------------------------------


def settled(settings=None):
    """Return a filter of micrometre legs that has been at rest for a while, and the truth."""
    truth = Truth(7)
    found = estimator(settings or FusionSettings(), LEGS, start=truth)
    for tick in range(1, 100):
        update(found, tick, measurement(*legs(truth.p, truth.R, ZERO)))
    return found, truth


@pytest.mark.parametrize("leg", range(6))
def test_an_encoder_that_slips_by_2_mm_is_left_out_at_once_and_named(leg):
    found, truth = settled()
    q, dq = legs(truth.p, truth.R, ZERO)
    q[leg] += 2e-3
    for tick in range(100, 130):
        fused = update(found, tick, measurement(q, dq))
        assert fused.used == tuple(i != leg for i in range(6))
        assert fused.health.slipped == tuple(i == leg and tick >= 99 + SLIP_TICKS for i in range(6))
        assert fused["innovation_q"][leg] == pytest.approx(2e-3, abs=1e-5)
    assert np.abs(fused["p"] - truth.p).max() < 1e-5


def test_a_push_that_moves_all_legs_is_no_slip_and_is_followed():
    found, truth = settled()
    for tick in range(100, 130):
        truth.p = truth.p + np.array([0.0, 0.0, 1e-3])
        fused = update(found, tick, measurement(*legs(truth.p, truth.R, np.array([0, 0, 1.0, 0, 0, 0]))))
        assert not any(fused.health.slipped)
        assert all(fused.used)
        assert np.abs(fused["p"] - truth.p).max() < 2e-5


def test_a_leg_that_is_off_by_less_than_a_slip_is_believed_in_the_end():
    found, truth = settled()
    q, dq = legs(truth.p, truth.R, ZERO)
    q[1] += 0.1e-3
    used = [update(found, tick, measurement(q, dq)).used[1] for tick in range(100, 120)]
    assert not any(used[:LEFT_OUT_TICKS])
    assert used[LEFT_OUT_TICKS]
    assert not found.record["slipped"].any()


def test_a_silent_and_a_blind_leg_are_lost_and_come_back():
    found, truth = settled()
    q, dq = legs(truth.p, truth.R, ZERO)
    for tick in range(100, 110):
        age = np.array([tick - 99, 0, 0, 0, 0, 0])
        ages = age + np.array([0, 0, 0, tick - 99, 0, 0])
        m = altered(measurement(q, dq), age=ages, blind=[0, 0, 0, 1, 0, 0])
        fused = update(found, tick, m)
        assert fused.used == (False, True, True, False, True, True)
        assert fused.health.lost == (tick >= 101, False, False, True, False, False)
    fused = update(found, 110, measurement(q, dq))
    assert all(fused.used)
    assert not any(fused.health.lost)


def test_an_age_that_may_be_lost_does_not_count_and_a_leg_that_is_not_used_makes_errors_estimates():
    settings = FusionSettings(may_lose_legs=[2])
    truth = Truth(7)
    found = FusedEstimator(PLATFORM, Model(PLATFORM), settings, LEGS, TRACKER, None, T)
    found.start(0, 0, truth.p, truth.R.as_matrix())
    for tick, lost, ages, unseen in (
        (1, (), [0] * 6, 0),
        (2, (2,), [0] * 6, 1),
        (3, (4,), [0, 0, 0, 0, 9, 0], 1),
        (4, (), [0] * 6, 0),
    ):
        record = altered(measurement(*legs(truth.p, truth.R, ZERO), lost=lost), tick=tick)
        sensed.update(found, record, tick * MS, Readings(), ZERO, ZERO)
        assert record["counted_age"].tolist() == ages
        assert record["unseen"] == unseen


def test_the_tracker_alone_bounds_what_a_lost_leg_leaves_open():
    found, truth = settled()
    q, dq = legs(truth.p, truth.R, ZERO)
    for tick in range(100, 3000):
        samples = [truth.track(tick - 1, 0.0)] if tick % 5 == 0 and tick < 2000 else []
        fused = update(found, tick, measurement(q, dq, lost=(0,)), samples)
        if tick == 1999:
            with_it = fused.health.position_std
    assert with_it < 0.4e-3
    assert fused.health.position_std > 10 * with_it, "a second without"


def test_a_tracker_sample_that_is_far_off_is_refused():
    found, truth = settled()
    m = measurement(*legs(truth.p, truth.R, ZERO))
    wrong = Sample(99, 0.0, (truth.p[0] + 0.05, *truth.p[1:], *truth.R.as_rotvec()))
    fused = update(found, 100, m, [wrong])
    assert fused["tracker"] == -1
    assert fused["innovation_tracker"][0] == pytest.approx(0.05, abs=1e-5)
    assert np.abs(fused["p"] - truth.p).max() < 1e-6
    right = wrong._replace(tick=100, values=(*truth.p, *truth.R.as_rotvec()))
    assert update(found, 101, m, [right])["tracker"] == 1


# -- IMU -------------------------------------------------------------------------------------------------------


def test_it_finds_the_biases_of_an_imu_and_carries_the_pose_on_with_it():
    imu = ImuSettings(rate_Hz=1000.0)
    truth = Truth(8)
    found = FusedEstimator(PLATFORM, Model(PLATFORM), LOOSE, LOOSE_LEGS, TRACKER, imu, T)
    found.start(0, 0, truth.p, truth.R.as_matrix())
    gyro_bias, force_bias = np.array([0.02, -0.01, 0.03]), np.array([0.1, 0.2, -0.1])
    for tick in range(1, 1500):
        before = truth.twist[:3]
        R = truth.R
        truth.step()
        f = R.inv().apply((truth.twist[:3] - before) / T - PLATFORM.gravity) + force_bias
        w = truth.R.inv().apply(truth.twist[3:]) + gyro_bias
        w += imu.angular_rate_std_rad_s * truth.chance.standard_normal(3)
        f += imu.specific_force_std_m_s2 * truth.chance.standard_normal(3)
        sample = Sample(tick - 1, 0.999e-3, (*w, *f))
        fused = Fused(found, tick, truth.measure(), Readings(imu=(sample,)))
    x, P = found._steps[found.record["newest"]]["x"], found._covariances[found.record["newest"]]
    std = np.sqrt(P.diagonal())
    assert np.abs(x[18:21] - gyro_bias).max() < 5 * std[12:15].max() < 2e-3
    assert np.abs(x[21:24] - force_bias).max() < 5 * std[15:18].max() < 0.1
    without = estimator(start=truth)
    for tick in range(1, 200):
        alone = update(without, tick, truth.measure())
    assert fused["pose_std"][:3].max() < alone["pose_std"][:3].max()


# -- forces and rates that are wrong -----------------------------------------------------------------------------


class Driven:
    """A platform on its drives, about rest at its pose, with a force along each leg that nobody reports."""

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


FORCED = LEGS._replace(force_std_N=500.0)


def test_a_force_along_a_leg_that_nobody_reports_is_found():
    truth = Driven([0, 0, 400.0, 0, 0, -250.0])
    found = estimator(FusionSettings(), FORCED, start=truth)
    for tick in range(1, 60):
        truth.step(truth.hold)
        fused = update(found, tick, truth.measure(truth.hold))
        assert all(fused.used)
    x, P = found._steps[found.record["newest"]]["x"], found._covariances[found.record["newest"]]
    std = np.sqrt(P.diagonal()[12:])
    assert std.max() < 200.0, "of 500 N before anything was measured"
    assert np.abs((x[24:] - truth.unknown) / std).max() < 3
    e = error(fused, truth)
    assert e @ np.linalg.solve(P[:12, :12], e) / 12 < 2


def test_unknown_forces_and_the_biases_of_an_imu_are_told_apart():
    truth = Driven([300.0, 0, 0, -300.0, 0, 0])
    imu = ImuSettings(rate_Hz=1000.0)
    found = FusedEstimator(PLATFORM, Model(PLATFORM), FusionSettings(), FORCED, TRACKER, imu, T)
    found.start(0, 0, truth.p, truth.R.as_matrix())
    gyro_bias = np.array([0.02, -0.01, 0.03])
    for tick in range(1, 200):
        truth.step(truth.hold)
        w = truth.R.inv().apply(truth.twist[3:]) + gyro_bias
        f = truth.R.inv().apply(truth.dtwist[:3] - PLATFORM.gravity)
        sample = Sample(tick - 1, 0.999e-3, (*w, *f))
        Fused(found, tick, altered(truth.measure(truth.hold)), Readings(imu=(sample,)))
    x, P = found._steps[found.record["newest"]]["x"], found._covariances[found.record["newest"]]
    std = np.sqrt(P.diagonal())
    assert np.abs(x[18:21] - gyro_bias).max() < 3 * std[12:15].max() < 3e-3
    assert np.abs((x[24:] - truth.unknown) / std[18:]).max() < 3


@pytest.mark.parametrize(
    ("off", "stated"),
    [({"skew_s": 50e-6}, {"rate_skew_std_s": 50e-6}), ({"scale": 1.01}, {"rate_scale_std": 0.01})],
)
def test_a_rate_that_is_wrong_by_what_is_stated_leaves_no_leg_out_and_no_twist_beyond_its_deviation(
    off, stated
):
    """A leg pushes with 10 kN for 60 ms. Noise of the rates: 10 um/s, in both filters."""
    quiet = LEGS._replace(rate_std_m_s=1e-5)
    beyond = []
    for errors in (quiet._replace(**stated), quiet):
        truth = Driven([0.0] * 6)
        found = estimator(FusionSettings(), errors, start=truth)
        tau = truth.hold + np.array([10e3, 0, 0, 0, 0, 0])
        worst = 0.0
        for tick in range(1, 60):
            truth.step(tau)
            fused = update(found, tick, truth.measure(tau, **off))
            P = found._covariances[found.record["newest"]]
            e = error(fused, truth)[6:]
            if tick > 5:
                worst = max(worst, e @ np.linalg.solve(P[6:12, 6:12], e) / 6)
        beyond.append(worst)
    assert beyond[0] < 2
    assert beyond[1] > 20


def test_the_bend_of_a_length_is_that_of_drawn_poses():
    """Mean and variance of length less tangent over 400,000 poses, half a millimetre and milliradian wide."""
    truth = Truth(0)
    chance = np.random.default_rng(2)
    L = 5e-4 * chance.uniform(-1, 1, (6, 6))
    d = chance.standard_normal((400_000, 6)) @ L.T
    x, P, h = np.zeros(30), np.zeros((12, 12)), np.zeros(12)
    x[:3], x[3:12], P[:6, :6] = truth.p, truth.R.as_matrix().ravel(), L @ L.T
    f = SimpleNamespace(r_length=1e-14)
    r = truth.R.apply(B)
    for leg in range(6):
        arm = truth.p + r[leg] - A[leg]
        l = float(np.linalg.norm(arm))
        h[:3], h[3:6] = arm / l, np.cross(r[leg], arm / l)
        moved = truth.p + d[:, :3] + Rotation.from_rotvec(d[:, 3:]).apply(r[leg]) - A[leg]
        bent = np.linalg.norm(moved, axis=1) - l - d @ h[:6]
        mean, variance = bend(f, tuple(B[leg]), x, P, h, l)
        assert mean == pytest.approx(bent.mean(), abs=0.02 * bent.std())
        assert variance == pytest.approx(bent.var(), rel=0.03)


def test_the_bend_of_a_length_that_is_well_known_is_nothing():
    x, P, f = np.zeros(30), 1e-14 * np.eye(12), SimpleNamespace(r_length=1e-14)
    x[:3], x[3:12] = (0.0, 0.0, 1.0), np.eye(3).ravel()
    assert bend(f, (0.5, 0.0, 0.0), x, P, np.zeros(12), 1.0) == (0.0, 0.0)
