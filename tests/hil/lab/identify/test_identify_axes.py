"""The estimator of the linearised axes, on simulated loops with known plant, noise and coupling."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import cont2discrete

from drivers.errors import IdentificationError
from hil.lab.identify.estimators.axis_fit import axis_response, fit_axes, uncertainty
from hil.lab.identify.estimators.response import AxisSignals, estimate, periodic, segmented

T = 1e-3
LAG = 0.8e-3
PERIOD = 1000
GAIN = np.array([1.0, 0.9, 1.1, 1.0, 1.2, 0.8])


def plant(lag=LAG):
    """A, B, C of 1 / (lag s + 1) / s^2 after a zero-order hold, by scipy; without whole samples of delay."""
    A = np.array([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [0.0, 0.0, -1 / lag]])
    B, C = np.array([[0.0], [0.0], [1 / lag]]), np.array([[1.0, 0.0, 0.0]])
    return cont2discrete((A, B, C, np.zeros((1, 1))), T)[:3]


def sampled(f, lag=LAG, samples=1):
    """Frequency response of `plant`."""
    A, B, C = plant(lag)
    z = np.exp(2j * np.pi * np.asarray(f) * T)
    return np.array([(C @ np.linalg.solve(x * np.eye(3) - A, B))[0, 0] * x**-samples for x in z])


def run(r, coupling=None, noise=0.0, w_n=20.0):
    """Six axes under inverse dynamics with a delay of one period; r (n, 6): acceleration of the reference."""
    A, B, C = plant()
    mix = np.diag(GAIN) if coupling is None else np.diag(GAIN) @ (np.eye(6) + coupling)
    rng = np.random.default_rng(3)
    n = len(r)
    x, late = np.zeros((3, 6)), np.zeros(6)
    q_d, dq_d, before = np.zeros(6), np.zeros(6), np.zeros(6)
    v, y = np.zeros((n, 6)), np.zeros((n, 6))
    for k in range(n):
        y[k] = (C @ x)[0] + noise * rng.normal(size=6)
        v[k] = r[k] + w_n**2 * (q_d - y[k]) + 2 * w_n * (dq_d - (y[k] - before) / T)
        before = y[k]
        x = A @ x + B @ (mix @ late)[None, :]
        late = v[k]
        q_d = q_d + T * dq_d + 0.5 * T * T * r[k]
        dq_d = dq_d + T * r[k]
    return AxisSignals(T, v, y, r, np.ones(n, bool))


def multisine(periods, harmonics):
    """Reference acceleration; axis j has every sixth harmonic."""
    t = np.arange(periods * PERIOD) * T
    r = np.zeros((len(t), 6))
    for k, h in enumerate(harmonics):
        r[:, k % 6] += 0.3 * np.sin(2 * np.pi * h * t / (PERIOD * T) + 2.4 * k * k)
    return r


HARMONICS = np.unique(np.geomspace(3, 150, 60).round().astype(int))
HARMONICS = HARMONICS[: len(HARMONICS) // 6 * 6]


def truth(f):
    """Closed form: hold, delay of a sample, lag, double integrator (spectral images are below 0.2 % to 50 Hz)."""
    s = 2j * np.pi * np.asarray(f)
    return (1 - np.exp(-s * T)) / (s * T) * np.exp(-T * s) / (1 + LAG * s) / s**2


@pytest.fixture(scope="module")
def quiet():
    signals = run(multisine(9, HARMONICS))
    signals.good[: 3 * PERIOD] = False  # settles
    return estimate(periodic(signals, PERIOD, HARMONICS))


@pytest.fixture(scope="module")
def noisy():
    signals = run(multisine(19, HARMONICS), noise=6e-6)
    signals.good[: 3 * PERIOD] = False
    return signals


@pytest.mark.parametrize("samples", [0, 1, 3])
@pytest.mark.parametrize("lag", [0.2e-3, LAG, 5e-3])
def test_frequency_response_of_the_nominal_axis_agrees_with_scipy(samples, lag):
    f = np.array([0.5, 3.0, 30.0, 200.0, 450.0])
    np.testing.assert_allclose(axis_response(f, T, samples * T, lag), sampled(f, lag, samples), rtol=1e-6)


def test_noise_in_the_loop_biases_the_plain_spectral_quotient_but_not_the_axis_estimate():
    """With noise only, position over demanded acceleration is -1 over the law, not the plant."""
    signals = run(multisine(27, HARMONICS), noise=24e-6, w_n=200.0)
    signals.good[: 3 * PERIOD] = False
    spectra = periodic(signals, PERIOD, HARMONICS)
    response = estimate(spectra)
    at = response.excited & (response.frequency_Hz[:, None] > 20)
    weight = 0.5 / response.std[at] ** 2
    sure = 1.0 / np.sqrt(weight.sum())
    plain = (spectra.Y * spectra.V.conj()).sum(axis=0) / (np.abs(spectra.V) ** 2).sum(axis=0)

    def mean_error(G):
        error = (G / (GAIN * sampled(response.frequency_Hz)[:, None]) - 1.0)[at]
        return np.abs((weight * error).sum() / weight.sum())

    assert mean_error(response.G) < 2.0 * sure
    assert mean_error(plain) > 3.0 * sure


def test_95_percent_confidence_circles_contain_the_true_response_in_95_percent(noisy):
    """Four parts of the run with 40 lines each, independent: 95 % within a standard deviation of 1.7 %."""
    inside = []
    for part in range(4):
        good = np.zeros_like(noisy.good)
        good[(3 + 4 * part) * PERIOD : (7 + 4 * part) * PERIOD] = True
        response = estimate(periodic(noisy._replace(good=good), PERIOD, HARMONICS))
        exact = sampled(response.frequency_Hz)  # the circles are narrower than the images of the closed form
        off = np.abs(response.G / (GAIN * exact[:, None]) - 1.0) <= response.radius
        inside += list(off[response.excited])
    share = np.mean(inside)
    assert len(inside) > 150
    assert 0.89 < share < 0.995


def test_uncertainty_bound_covers_the_coupling_of_the_axes():
    """Delta is known; its largest singular value, not its diagonal, matters to a controller."""
    coupling = 0.1 * np.random.default_rng(8).normal(size=(6, 6))
    np.fill_diagonal(coupling, 0.0)
    signals = run(multisine(9, HARMONICS), coupling)
    signals.good[: 3 * PERIOD] = False
    response = estimate(periodic(signals, PERIOD, HARMONICS))
    found = uncertainty(response, fit_axes(response))
    assert found.coupled
    sigma = np.linalg.svd(np.diag(GAIN) @ coupling @ np.diag(1 / GAIN), compute_uv=False)[0]
    low = (found.frequency_Hz > 8) & (found.frequency_Hz < 60)
    within = found.bound[low] / sigma
    assert within.min() > 0.8
    assert within.max() < 1.3


def test_identified_response_gain_and_delays_are_exact_without_noise(quiet):
    for axis in range(6):
        own = quiet.excited[:, axis] & (quiet.frequency_Hz < 50)
        assert own.sum() >= 5
        np.testing.assert_allclose(quiet.G[own, axis], GAIN[axis] * truth(quiet.frequency_Hz[own]), rtol=2e-3)
    fit = fit_axes(quiet)
    assert fit.gain == pytest.approx(GAIN, rel=1e-3)
    assert fit.delays.transport_s == pytest.approx(T, abs=0.01e-3)
    assert fit.delays.lag_s == pytest.approx(LAG, abs=0.01e-3)
    assert fit.delays.total_s == pytest.approx(T + LAG + T / 2, abs=0.005e-3)


def test_coupling_of_axes_is_unknown_if_all_axes_move_together(quiet):
    t = np.arange(9 * PERIOD) * T
    heave = sum(np.sin(2 * np.pi * h * t / (PERIOD * T) + 2.4 * k * k) for k, h in enumerate(HARMONICS))
    signals = run(0.1 * heave[:, None] * np.ones(6))
    signals.good[: 3 * PERIOD] = False
    response = estimate(periodic(signals, PERIOD, HARMONICS))
    assert not uncertainty(response, fit_axes(response)).coupled
    assert uncertainty(quiet, fit_axes(quiet)).coupled


def test_a_delay_that_noise_hides_is_refused(quiet):
    """Low noise gives transport and lag, higher noise only their sum, still higher noise neither."""
    slow = quiet._replace(excited=quiet.excited & (quiet.frequency_Hz < 100.0)[:, None])
    found = fit_axes(slow._replace(std=np.full_like(slow.std, 0.1))).delays
    assert found.lag_s == found.lag_std_s == 0.0
    assert found.total_s == pytest.approx(T + LAG + T / 2, abs=3 * found.total_std_s)
    assert found.total_std_s < 1e-4
    with pytest.raises(IdentificationError, match="Hz"):
        fit_axes(slow._replace(std=np.full_like(slow.std, 0.5)))


def test_axis_identification_refuses_noise_another_plant_and_a_short_run(quiet):
    noise = np.random.default_rng(2).normal(size=(3, 9000, 6))
    response = estimate(segmented(AxisSignals(T, noise[0], noise[1], noise[2], np.ones(9000, bool))))
    with pytest.raises(IdentificationError, match="coherent"):
        fit_axes(response)
    with pytest.raises(IdentificationError, match="double integrator"):
        fit_axes(quiet._replace(G=quiet.G * (1j * quiet.frequency_Hz[:, None]) ** 2))
    short = run(multisine(3, HARMONICS))
    with pytest.raises(IdentificationError, match="at least 4"):
        periodic(short, PERIOD, HARMONICS)
    with pytest.raises(IdentificationError, match="5 s of tracking"):
        segmented(short)
