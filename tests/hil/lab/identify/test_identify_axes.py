"""The estimator of the linearised axes against loops of known plant, noise and coupling."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import cont2discrete

from drivers.errors import IdentificationError
from hil.lab.identify.estimators.axis_fit import axis_response, fit_axes, uncertainty
from hil.lab.identify.estimators.response import AxisSignals, Response, Spectra, estimate, periodic, segmented

T = 1e-3
LAG = 0.8e-3
PERIOD = 1000
GAIN = np.array([1.0, 0.9, 1.1, 1.0, 1.2, 0.8])


def plant(lag=LAG):
    """1 / (lag s + 1) / s^2 behind a hold, by scipy: A, B, C; whole samples of delay come on top."""
    A = np.array([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [0.0, 0.0, -1 / lag]])
    B, C = np.array([[0.0], [0.0], [1 / lag]]), np.array([[1.0, 0.0, 0.0]])
    return cont2discrete((A, B, C, np.zeros((1, 1))), T)[:3]


def sampled(f, lag=LAG, samples=1):
    """Frequency response of `plant`."""
    A, B, C = plant(lag)
    z = np.exp(2j * np.pi * np.asarray(f) * T)
    return np.array([(C @ np.linalg.solve(x * np.eye(3) - A, B))[0, 0] * x**-samples for x in z])


def run(r, coupling=None, noise=0.0, w_n=20.0):
    """Six axes under inverse dynamics, delay one period; r (n, 6) accelerates the reference."""
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
    """Axis j has every sixth harmonic; begins and goes on at a speed that makes its mean zero."""
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


# -- the nominal axis ----------------------------------------------------------------------------------------


@pytest.mark.parametrize("samples", [0, 1, 3])
@pytest.mark.parametrize("lag", [0.2e-3, LAG, 5e-3])
def test_the_nominal_axis_is_what_scipy_samples(samples, lag):
    f = np.array([0.5, 3.0, 30.0, 200.0, 450.0])
    np.testing.assert_allclose(axis_response(f, T, samples * T, lag), sampled(f, lag, samples), rtol=1e-6)


@pytest.mark.parametrize("delay", [0.1e-3, 0.5e-3, 0.9e-3, 1.7e-3])
@pytest.mark.parametrize("lag", [0.0, LAG])
def test_a_part_of_a_sample_of_delay_is_the_continuous_one_far_below_the_rate(delay, lag):
    f = np.array([0.5, 5.0, 30.0])
    s = 2j * np.pi * f
    continuous = (1 - np.exp(-s * T)) / (s * T) * np.exp(-delay * s) / (1 + lag * s) / s**2
    np.testing.assert_allclose(axis_response(f, T, delay, lag), continuous, rtol=1.5e-4)


# -- estimate and fit ----------------------------------------------------------------------------------------


def test_without_noise_the_response_is_the_plants(quiet):
    for axis in range(6):
        own = quiet.excited[:, axis] & (quiet.frequency_Hz < 50)
        assert own.sum() >= 5
        expected = GAIN[axis] * truth(quiet.frequency_Hz[own])
        np.testing.assert_allclose(quiet.G[own, axis], expected, rtol=2e-3)
        assert quiet.coherence[own, axis].min() > 0.9999


def test_each_line_counts_for_the_axis_that_it_moves(quiet):
    np.testing.assert_array_equal(quiet.excited, np.arange(len(HARMONICS))[:, None] % 6 == np.arange(6))


def test_gain_transport_and_lag_are_found(quiet):
    fit = fit_axes(quiet)
    assert fit.gain == pytest.approx(GAIN, rel=1e-3)
    assert fit.transport_s == pytest.approx(T, abs=0.01e-3)
    assert fit.lag_s == pytest.approx(LAG, abs=0.01e-3)
    assert fit.total_s == pytest.approx(T + LAG + T / 2, abs=0.005e-3)


def test_a_few_bent_lines_do_not_pull_the_gain(quiet):
    """As a model whose weight is wrong bends the lowest ones: by the inverse square of the frequency."""
    bent = quiet._replace(G=quiet.G * (1 + 0.1 * (3.0 / quiet.frequency_Hz[:, None]) ** 2))
    fit = fit_axes(bent)
    assert fit.gain == pytest.approx(GAIN, rel=5e-3)
    assert fit.total_s == pytest.approx(2.3e-3, abs=0.03e-3)
    bound = uncertainty(bent, fit).bound
    assert bound[0] > 0.09
    assert bound[-1] < 0.02


def test_the_errors_of_the_fit_are_as_large_as_it_says_though_the_lines_scatter_by_more_than_they_say(quiet):
    """Each line of its own off by 5 %, far beyond what its noise explains."""
    truth_of = np.array([*GAIN, T, LAG, T + LAG + 0.5 * T])
    z = []
    for seed in range(2):
        rng = np.random.default_rng(seed)
        off = 0.05 * (rng.normal(size=quiet.G.shape) + 1j * rng.normal(size=quiet.G.shape))
        fit = fit_axes(quiet._replace(G=quiet.G * (1.0 + off)))
        found = np.array([*fit.gain, fit.transport_s, fit.lag_s, fit.total_s])
        z.append((found - truth_of) / [*fit.gain_std, fit.transport_std_s, fit.lag_std_s, fit.total_std_s])
    assert 0.4 < np.sqrt(np.mean(np.square(z))) < 2.5


def test_noise_in_the_loop_does_not_bias_it_though_it_biases_the_plain_quotient():
    """Under noise alone position over demanded acceleration is -1 over the law, not the plant."""
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


def test_the_circles_hold_the_truth_as_often_as_they_say(noisy):
    """On four parts of the run with 40 lines each, independent: 95 % give or take 1.7."""
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


def test_segments_of_a_random_motion_give_the_same_axis():
    """Six independent random references, as a log has that was not made for it."""
    rng = np.random.default_rng(1)
    r = np.zeros((12000, 6))
    white = rng.normal(size=(12000, 6))
    for k in range(1, len(r)):
        r[k] = 0.7 * r[k - 1] + 0.3 * white[k]
    r -= r.mean(axis=0)
    response = estimate(segmented(run(r, noise=1e-7)))
    for axis in range(6):
        good = (response.coherence[:, axis] > 0.9) & (np.abs(response.frequency_Hz - 20) < 18)
        assert good.sum() > 15
        expected = GAIN[axis] * truth(response.frequency_Hz[good])
        assert np.median(np.abs(response.G[good, axis] / expected - 1.0)) < 0.02
    fit = fit_axes(response)
    assert fit.gain == pytest.approx(GAIN, rel=0.01)
    assert fit.total_s == pytest.approx(2.3e-3, abs=0.05e-3)


def test_the_circles_of_a_chirp_hold_the_truth_as_often_as_they_say():
    """One sweep is past a line within a segment or two, which alone cannot tell their noise."""
    n, f_0, f_1 = 20000, 0.5, 60.0
    t = np.arange(n) * T
    sweep = 0.5 * np.sin(2 * np.pi * (f_0 * t + (f_1 - f_0) * t**2 / (2 * t[-1])))
    r = (sweep * np.clip(2 * np.minimum(t, t[-1] - t), 0.0, 1.0))[:, None] * np.ones(6)
    response = estimate(segmented(run(r, noise=10e-6)))
    error = np.abs(response.G / (GAIN * sampled(response.frequency_Hz)[:, None]) - 1.0)
    judged = response.excited & (response.frequency_Hz[:, None] < 55.0)
    assert judged.any(axis=1).sum() > 20
    assert judged[response.frequency_Hz < 30.0].any(axis=1).sum() > 10
    assert (error <= response.radius)[judged].mean() > 0.9
    assert np.median(response.radius[judged]) < 0.05
    fit = fit_axes(response)
    assert fit.gain == pytest.approx(GAIN, rel=0.01)
    assert fit.total_s == pytest.approx(T + LAG + T / 2, abs=0.02e-3)


def test_a_line_that_one_block_alone_has_seen_is_not_used():
    """It leaves no residual and is coherent with itself, whatever noise it holds."""
    rng = np.random.default_rng(5)
    V, Y = (rng.normal(size=(9, 12, 6)) + 1j * rng.normal(size=(9, 12, 6)) for _ in range(2))
    R = np.zeros_like(V)
    R[4] = 1.0
    response = estimate(Spectra(T, np.arange(1.0, 13.0), V, Y, R))
    assert not response.excited.any()


# -- the bound -----------------------------------------------------------------------------------------------


def test_the_bound_holds_the_coupling_of_the_axes():
    """Delta is known: its largest singular value, not its diagonal, is what a controller meets."""
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


def test_axes_that_move_together_tell_no_coupling(quiet):
    t = np.arange(9 * PERIOD) * T
    heave = sum(np.sin(2 * np.pi * h * t / (PERIOD * T) + 2.4 * k * k) for k, h in enumerate(HARMONICS))
    signals = run(0.1 * heave[:, None] * np.ones(6))
    signals.good[: 3 * PERIOD] = False
    response = estimate(periodic(signals, PERIOD, HARMONICS))
    fit = fit_axes(response)
    assert fit.gain == pytest.approx(GAIN, rel=2e-3)
    assert not uncertainty(response, fit).coupled
    assert uncertainty(quiet, fit_axes(quiet)).coupled


def test_the_bound_is_never_below_the_measured_difference(noisy):
    response = estimate(periodic(noisy, PERIOD, HARMONICS))
    fit = fit_axes(response)
    found = uncertainty(response, fit)
    P0 = axis_response(response.frequency_Hz, T, fit.transport_s, fit.lag_s)
    for f, bound in zip(found.frequency_Hz, found.bound, strict=True):
        k = int(np.flatnonzero(response.frequency_Hz == f)[0])
        own = fit.used[k]
        assert (np.abs(response.G[k] / (P0[k] * fit.gain) - 1.0)[own] <= bound).all()


def test_an_axis_that_noise_drowns_at_high_frequency_is_in_the_bound(quiet):
    """Its lines there are no part of the fit, but nobody knows that it is as good as its neighbours."""
    high = (quiet.frequency_Hz > 60)[:, None] & (np.arange(6) == 3)
    drowned = quiet._replace(
        coherence=np.where(high, 0.5, quiet.coherence), radius=np.where(high, 0.8, quiet.radius)
    )
    fit = fit_axes(drowned)
    assert not fit.used[high].any()
    found = uncertainty(drowned, fit)
    assert (found.bound[found.frequency_Hz > 75] > 0.7).all()
    assert found.frequency_Hz.max() > 120
    assert (found.bound[found.frequency_Hz < 50] < 0.1).all()


def test_nothing_is_said_where_an_axis_was_not_excited(quiet):
    excited = quiet.excited.copy()
    excited[quiet.frequency_Hz > 60, 3] = False
    less = quiet._replace(excited=excited)
    found = uncertainty(less, fit_axes(less))
    last = quiet.frequency_Hz[excited[:, 3]].max()
    assert last <= found.frequency_Hz.max() < 1.3 * last


def test_axes_in_bands_of_their_own_are_refused(quiet):
    low = quiet.frequency_Hz[:, None] < np.median(quiet.frequency_Hz)
    apart = quiet.excited & np.where(np.arange(6) < 3, low, ~low)
    fit = fit_axes(quiet)._replace(used=apart)
    with pytest.raises(IdentificationError, match="too far apart"):
        uncertainty(quiet._replace(excited=apart), fit)


# -- what is refused -----------------------------------------------------------------------------------------


def test_noise_alone_is_refused_for_its_coherence():
    rng = np.random.default_rng(2)
    noise = rng.normal(size=(3, 9000, 6))
    response = estimate(segmented(AxisSignals(T, noise[0], noise[1], noise[2], np.ones(9000, bool))))
    with pytest.raises(IdentificationError, match=r"coherent with its reference \(above 0.9\) at 0 of"):
        fit_axes(response)


def test_a_response_of_another_shape_is_refused(quiet):
    other = Response(*quiet)._replace(G=quiet.G * (1j * quiet.frequency_Hz[:, None]) ** 2)
    with pytest.raises(IdentificationError, match="in front of a double integrator"):
        fit_axes(other)


def test_a_short_run_is_refused_with_the_length_it_needs():
    signals = run(multisine(3, HARMONICS))
    with pytest.raises(IdentificationError, match=r"3 whole periods of 1 s .* at least 4"):
        periodic(signals, PERIOD, HARMONICS)
    with pytest.raises(IdentificationError, match=r"1 segments of 2 s .* 5 s of tracking"):
        segmented(signals)


def test_a_period_with_a_missing_tick_is_left_out(noisy):
    good = noisy.good.copy()
    good[5 * PERIOD + 17] = False
    whole = periodic(noisy, PERIOD, HARMONICS)
    cut = periodic(noisy._replace(good=good), PERIOD, HARMONICS)
    assert len(whole.V) == 16
    assert 14 <= len(cut.V) < 16
