"""Fusion filter against a plain one and its own statistics: late samples, encoder errors, IMU, forces."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from drivers.sensing.settings import ImuSettings
from hil.config.estimation import FusionSettings
from hil.estimation.fusion_kernels import bend
from tests.hil.fusion_bench import (
    LEGS,
    LOOSE,
    LOOSE_LEGS,
    MS,
    PLATFORM,
    ROTATION_STD,
    TRACKER,
    ZERO,
    A,
    B,
    Driven,
    Fused,
    T,
    Truth,
    error,
    estimator,
    legs,
    measurement,
    state_of,
    update,
)
from tests.sensor_samples import Readings, Sample


class Plain:
    """Plain extended Kalman filter: numerical derivatives, batch updates, second order in lengths."""

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
        """Mean and variance of the second-order terms of the first numbers of function(pose, twist)."""
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
        S = H @ self.P @ H.T + np.diag(r + 2 * variance)
        K = self.P @ H.T @ np.linalg.inv(S)
        d = K @ (z - mean - function(self.p, self.R, self.twist))
        self.P = self.P - K @ H @ self.P
        self.p, self.R, self.twist = self.moved(d)


def test_filter_with_a_lost_leg_and_a_tracker_agrees_with_a_textbook_kalman_filter():
    truth = Truth(1)
    plain, found = Plain(truth), estimator(start=truth)
    found._covariances[0][12:, 12:] = found.record[["q_stamp", "q_position", "q_rotation"]] = 0.0
    for tick in range(1, 121):
        samples = []
        share = 0.0
        if tick % 5 == 0:  # in the middle of the interval, where the truth is that of its beginning
            samples, share = [truth.track(tick - 1, 0.3e-3)], 0.3
        truth.step()
        m = truth.measure()
        lost = (2,) if tick > 60 else ()
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
        P = state_of(found)[1][:12, :12]
        scale = np.sqrt(np.outer(plain.P.diagonal(), plain.P.diagonal()))
        assert np.abs((P - plain.P) / scale).max() < 1e-5
        assert np.abs(fused["p"] - plain.p).max() < 1e-8
        assert (Rotation.from_matrix(fused["R"]) * plain.R.inv()).magnitude() < 1e-8
        assert np.abs(fused["twist"] - plain.twist).max() < 1e-6
        assert fused.used == tuple(leg not in lost for leg in range(6))


IMU = ImuSettings(rate_Hz=1000.0)


@pytest.mark.parametrize(
    ("lost", "imu"), [((4,), None), ((), IMU), pytest.param((), None, marks=pytest.mark.long)]
)
def test_errors_of_the_filter_agree_with_its_covariance(lost, imu):
    """Mean of e^T P^-1 e / n over independent runs is 1, within five standard deviations of that mean.

    Biases of an IMU, and constant errors of the tracker and of its stamps, are drawn from the filter's
    initial covariance.
    """
    runs, ticks, late = 20, 150, 12
    nees = []
    for seed in range(runs):
        truth = Truth(seed)
        found = estimator(start=truth, imu=imu)
        _, P = state_of(found)
        own = np.sqrt(P.diagonal()[12:]) * truth.chance.standard_normal(len(P) - 12)
        biases, stamp_s, off = own[:-7], own[-7], own[-6:]
        taken: dict[int, list[Sample]] = {}
        for tick in range(1, ticks):
            if tick % 5 == 0:
                taken[tick + late] = [truth.track(tick - 1, stamp_s, off)]
            samples = taken.get(tick, [])
            felt = [truth.feel(tick, imu, biases)] if imu else []
            if not imu:
                truth.step()
            m = truth.measure()
            fused = update(found, tick, measurement(m["length"], m["rate"], lost=lost), samples, felt)
        x, P = state_of(found)
        e = np.concatenate((error(fused, truth), own - np.append(x[18:24][: len(biases)], x[30:])))
        nees.append(e @ np.linalg.solve(P, e) / len(e))
    assert np.mean(nees) == pytest.approx(1.0, abs=5 * np.sqrt(2 / (len(e) * runs)))


@pytest.mark.parametrize("imu", [None, IMU], ids=["alone", "beside an IMU"])
def test_late_sensor_sample_gives_the_same_filter_state_as_a_prompt_one(imu):
    """Samples of every third tick arrive together in every seventh tick."""
    truth = Truth(3)
    prompt, tardy = (estimator(start=truth, imu=imu) for _ in range(2))
    waiting: list[Sample] = []
    for tick in range(1, 99):
        samples = [truth.track(tick - 1, 0.0004)] if tick % 3 == 0 else []
        waiting += samples
        truth.step()
        turning = (Sample(tick - 1, 0.0005, (*truth.twist[3:], *-PLATFORM.gravity)),) * (imu is not None)
        due = waiting if tick % 7 == 0 else []
        m = truth.measure()
        a = Fused(prompt, tick, m, Readings(tracker=tuple(samples), imu=turning))
        b = Fused(tardy, tick, m, Readings(tracker=tuple(due), imu=turning))
        if due:
            assert len(waiting) > 1
            waiting = []
    for name in ("p", "R", "twist"):
        assert np.array_equal(a[name], b[name])
    assert all(np.array_equal(x, y) for x, y in zip(state_of(prompt), state_of(tardy), strict=True))


def test_sensor_sample_too_old_or_from_the_future_is_ignored_by_the_filter():
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


def test_filter_accounts_for_skipped_ticks_and_a_late_loop():
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


def test_filter_finds_imu_biases_and_its_pose_improves():
    truth = Truth(8)
    found = estimator(start=truth, imu=IMU)
    biases = np.array([0.02, -0.01, 0.03, 0.1, 0.2, -0.1])
    for tick in range(1, 1500):
        felt = truth.feel(tick, IMU, biases)
        fused = update(found, tick, truth.measure(), felt=[felt])
    x, P = state_of(found)
    std = np.sqrt(P.diagonal())
    assert np.abs(x[18:21] - biases[:3]).max() < 5 * std[12:15].max() < 2e-3
    assert np.abs(x[21:24] - biases[3:]).max() < 5 * std[15:18].max() < 0.1
    without = estimator(start=truth)
    for tick in range(1, 200):
        alone = update(without, tick, truth.measure())
    assert fused["pose_std"][:3].max() < alone["pose_std"][:3].max()


FORCED = LEGS._replace(force_std_N=500.0)


def test_filter_finds_an_unreported_force_along_a_leg():
    truth = Driven([0, 0, 400.0, 0, 0, -250.0])
    found = estimator(FusionSettings(), FORCED, start=truth)
    for tick in range(1, 60):
        truth.step(truth.hold)
        fused = update(found, tick, truth.measure(truth.hold))
        assert all(fused.used)
    x, P = state_of(found)
    std = np.sqrt(P.diagonal()[12:18])
    assert std.max() < 200.0, "the initial deviation of 500 N must fall by the measurements"
    assert np.abs((x[24:30] - truth.unknown) / std).max() < 3
    e = error(fused, truth)
    assert e @ np.linalg.solve(P[:12, :12], e) / 12 < 2


@pytest.mark.parametrize(
    ("off", "stated"),
    [({"skew_s": 50e-6}, {"rate_skew_std_s": 50e-6}), ({"scale": 1.01}, {"rate_scale_std": 0.01})],
)
def test_stated_rate_errors_are_in_the_covariance(off, stated):
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
            _, P = state_of(found)
            e = error(fused, truth)[6:]
            if tick > 5:
                worst = max(worst, e @ np.linalg.solve(P[6:12, 6:12], e) / 6)
        beyond.append(worst)
    assert beyond[0] < 2
    assert beyond[1] > 20


def test_second_order_terms_of_a_length_agree_with_random_poses():
    """Mean and variance of length minus tangent over 400,000 poses within 0.5 mm and 0.5 mrad."""
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
    assert bend(f, tuple(B[0]), x, 1e-14 * np.eye(12), h, l) == (0.0, 0.0), "zero for an exactly known pose"
