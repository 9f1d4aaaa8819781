"""The condition of convergence, the filter that it leaves, and what is said of a floor."""

import numpy as np
import pytest

from drivers.errors import ModelError
from hil.design.stability.prediction import predicting
from hil.design.stability.sampled import gains
from hil.design.stability.sampled_loop import sampled_axis
from hil.lab.learn.convergence import CONTRACTION, FLAT, Filter, Uncertainty, choose, contraction, stated
from hil.lab.learn.judgement import bands, contradiction, floor, rms_in, state
from hil.lab.learn.loop import AxisLoop, axis_loop, frequencies
from hil.lab.learn.trial import LEAD_S, predicted, spectra, trial, updated
from hil.mathematics.linear_system import lag
from tests.hil.lab.learn.plants import K_D, K_P, LEAD, Plant, T, run

F = frequencies(2500, T)
AXIS = sampled_axis(1e-3, lag(0.8e-3), T)
LOOP = axis_loop(AXIS, gains(K_P, K_D, T), F, looks_ahead=False)


def worst(loop: AxisLoop, W: float) -> np.ndarray[tuple[int], np.dtype[np.float64]]:
    """Return the largest |1 - P/P_0| of an axis G_0 (1 + delta), |delta| = W, in closed loop."""
    L0, G0 = loop.T / loop.S, loop.P / loop.S
    largest = np.zeros(len(L0))
    for angle in np.linspace(0.0, 2.0 * np.pi, 181):
        delta = W * np.exp(1j * angle)
        P = G0 * (1.0 + delta) / (1.0 + L0 * (1.0 + delta))
        largest = np.maximum(largest, np.abs(1.0 - P / loop.P))
    return largest


def test_the_bound_of_the_contraction_holds_for_every_axis_of_the_uncertainty_and_is_reached() -> None:
    """|1 - P/P_0| of loops closed anew around G_0 (1 + delta), delta all around the circle of the bound."""
    W = 0.3
    c = contraction([LOOP], F, Uncertainty(np.array([0.0, 500.0]), np.array([W, W])))
    largest = worst(LOOP, W)
    assert (largest <= c * (1.0 + 1e-9))[1:].all()
    assert largest[1:] == pytest.approx(c[1:], rel=1e-3)


def test_a_stated_gain_and_delay_bound_what_they_do_to_an_axis() -> None:
    bound = stated(0.25, 1e-3, 100.0)
    f = np.linspace(0.1, 99.0, 50)
    off = np.array(
        [
            np.abs((1.0 + g) * np.exp(2j * np.pi * f * d) - 1.0)
            for g in np.linspace(-0.25, 0.25, 11)
            for d in np.linspace(-1e-3, 1e-3, 11)
        ]
    )
    np.testing.assert_allclose(bound.at(f), off.max(axis=0), atol=1e-5)
    assert np.isinf(bound.at(np.array([100.1]))).all(), "beyond it nothing is stated"


def test_the_filter_is_the_widest_that_keeps_the_condition() -> None:
    c = contraction([LOOP], F, stated(0.25, 1e-3, 100.0))
    found = choose(c, F)
    finite = np.where(np.isfinite(c), c, 1e300)
    assert (found.Q.at(F) * finite).max() <= CONTRACTION
    assert (Filter(1.03 * found.Q.end_Hz).at(F) * finite).max() > CONTRACTION
    assert 60.0 < found.Q.end_Hz < 100.0


def test_where_no_filter_keeps_the_condition_the_figures_are_said() -> None:
    c = contraction([LOOP], F, Uncertainty(np.array([0.0, 100.0]), np.array([30.0, 30.0])))
    with pytest.raises(ModelError, match=r"no filter .* allowed: at most 0\.8 from 0 to 2 Hz"):
        choose(c, F)


def test_the_filter_has_no_phase_is_one_in_its_band_and_nothing_beyond() -> None:
    Q = Filter(80.0).at(F)
    assert (Q[F < FLAT * 80.0] == 1.0).all()
    assert (Q[F >= 80.0] == 0.0).all()
    assert (np.diff(Q) <= 0.0).all()


def test_the_loop_predicts_what_a_learned_acceleration_does_to_a_simulated_leg() -> None:
    """The simulation is another one: tenths of a tick, Euler; the prediction comes from the exact axis."""
    a = np.zeros((LEAD + 1000, 6))
    t = T * np.arange(1000)[:, None]
    a[LEAD:] = (
        np.sin(2.0 * np.pi * 7.0 * t) * np.sin(np.pi * t) ** 2 * np.array([1.0, 2.0, 0.5, -1.0, 0.3, 1.5])
    )
    without, with_a = (run(Plant(), learned, 1.0) for learned in (np.zeros_like(a), a))
    assert without is not None
    assert with_a is not None
    first = trial(T, LEAD, *without, np.zeros_like(a), np.full(6, 20.0))
    f = frequencies(len(first.e), T)
    loops = [axis_loop(AXIS, gains(K_P, K_D, T), f, looks_ahead=False)] * 6
    ahead = predicted(first, a, loops)
    change = np.abs(ahead - first.tracked).max()
    assert np.abs(ahead - with_a[0][LEAD:]).max() < 0.03 * change


def test_a_law_that_looks_ahead_counts_what_was_learned_among_its_commands() -> None:
    """Step by step in time: the law predicts with the commands under way, the learned ones included."""
    law = predicting(K_P, K_D, T, bus_s=1e-3, lag_s=0.0, hold_s=0.5e-3)
    axis = sampled_axis(1e-3, lag(0.0), T)
    f = frequencies(4000, T)
    loop = axis_loop(axis, law, f, looks_ahead=True)
    a = np.zeros(4000)
    a[100:1100] = np.sin(2.0 * np.pi * 5.0 * T * np.arange(1000)) * np.sin(np.pi * T * np.arange(1000))
    enters = law.B[:, 0] / law.D[0, 0]
    without = law.A - np.outer(enters, law.C[0])
    x, z, e = np.zeros(axis.order), np.zeros(law.order), np.zeros(4000)
    for k in range(4000):
        y = axis.C @ x
        e[k] = -y[0]
        asked = float(law.C[0] @ z + law.D[0] @ -y) + a[k]
        x, z = axis.A @ x + axis.B[:, 0] * asked, without @ z + enters * asked
    expected = -np.fft.irfft(loop.P * np.fft.rfft(a), 4000)
    assert np.abs(e - expected).max() < 0.01 * np.abs(e).max()


@pytest.mark.parametrize("looks_ahead", [False, True])
def test_a_rate_that_is_measured_wrong_enters_by_the_gain_of_the_rate(looks_ahead: bool) -> None:
    """Step by step in time: the law is given de + n, and the leg goes where it then asks."""
    law = gains(K_P, K_D, T)
    if looks_ahead:
        law = predicting(K_P, K_D, T, bus_s=1e-3, lag_s=0.0, hold_s=0.5e-3)
    axis = sampled_axis(1e-3, lag(0.0), T)
    wrong = np.zeros(4000)
    wrong[100:1100] = np.sin(2.0 * np.pi * 5.0 * T * np.arange(1000)) * np.sin(np.pi * T * np.arange(1000))
    x, z, e = np.zeros(axis.order), np.zeros(law.order), np.zeros(4000)
    for k in range(4000):
        y = axis.C @ x
        e[k] = -y[0]
        measured = -y + [0.0, wrong[k]]
        asked = float(law.C[0] @ z + law.D[0] @ measured)
        x, z = axis.A @ x + axis.B[:, 0] * asked, law.A @ z + law.B @ measured
    by_rate = axis_loop(axis, law, frequencies(4000, T), looks_ahead=looks_ahead).by_rate
    expected = -np.fft.irfft(by_rate * np.fft.rfft(wrong), 4000)
    assert np.abs(e - expected).max() < 0.01 * np.abs(e).max()


def test_an_update_with_the_true_axis_takes_the_error_away_but_for_the_filter() -> None:
    e0, de0 = run(Plant(), np.zeros((LEAD + 1000, 6)), 0.9) or (None, None)
    assert e0 is not None
    assert de0 is not None
    first = trial(T, LEAD, e0, de0, np.zeros_like(e0), np.full(6, 20.0))
    f = frequencies(len(first.e), T)
    loops = [axis_loop(AXIS, gains(K_P, K_D, T), f, looks_ahead=False)] * 6
    a = updated(first, loops, Filter(80.0), f)
    assert not a[0].any(), "it begins at nothing"
    assert np.abs(predicted(first, a, loops)).max() < 0.01 * first.peak_m
    half = updated(first, loops, Filter(80.0), f, 0.5)
    np.testing.assert_allclose(half, 0.5 * a, atol=1e-12)


def test_the_bands_of_an_error_hold_all_of_it_up_to_the_filter() -> None:
    x = np.random.default_rng(1).standard_normal((2500, 2))
    found = bands(F, 500.1)
    assert sum(m.sum() for m in found.members) == len(F)
    of_bands = np.array([rms_in(spectra(x), inside, 2500, 2500) ** 2 for inside in found.members])
    nyquist = np.abs(spectra(x)[-1]) ** 2 / 2500**2  # counted twice, as no other bin is
    np.testing.assert_allclose(of_bands.sum(axis=0) - nyquist, (x**2).mean(axis=0), rtol=1e-9)


def test_an_error_that_grows_without_a_change_contradicts_where_nothing_is_known_of_an_axis_too() -> None:
    """Beyond what is stated the contraction is infinite, and times no change still nothing."""
    zero = np.zeros((LEAD + 1000, 6))
    e = zero.copy()
    e[LEAD:, 2] = 1e-4 * np.sin(2.0 * np.pi * 20.0 * T * np.arange(1000))
    before, now = (trial(T, LEAD, k * e, zero, zero, np.full(6, 20.0)) for k in (1.0, 3.0))
    f = frequencies(len(now.e), T)
    loops = [axis_loop(AXIS, gains(K_P, K_D, T), f, looks_ahead=False)] * 6
    unknown = np.full(len(f), np.inf)
    said = contradiction(before, now, loops, unknown, Filter(80.0), f, first_rms_m=before.rms_m, noise_m=0.0)
    assert said is not None
    assert said.axis == 2
    assert said.factor == pytest.approx(3.0, rel=1e-6)
    assert said.allowed == pytest.approx(1.5, rel=1e-6), "what it was, and the margin"


@pytest.mark.parametrize("noise_m", [0.0, 1e-7, 2e-5])
def test_what_noise_makes_of_an_error_contradicts_nothing(noise_m: float) -> None:
    """Where nothing was changed an error may grow by half, and by three sigmas of its noise in the band."""
    zero = np.zeros((LEAD + 1000, 6))
    e = zero.copy()
    e[LEAD:, 4] = 1e-4 * np.sin(2.0 * np.pi * 20.0 * T * np.arange(1000))
    before = trial(T, LEAD, e, zero, zero, np.full(6, 20.0))
    f = frequencies(len(before.e), T)
    loops = [axis_loop(AXIS, gains(K_P, K_D, T), f, looks_ahead=False)] * 6
    Q, known = Filter(80.0), np.full(len(f), 0.5)
    (band,) = [inside for inside in bands(f, Q.end_Hz).members if inside[np.searchsorted(f, 20.0)]]
    was = rms_in(spectra(before.e), band, len(before.e), 1000)[4]
    noise = noise_m * (band.sum() / len(f) * len(before.e) / 1000) ** 0.5
    for beside, contradicts in ((0.99, False), (1.01, True)):
        factor = 1.5 + beside * 3.0 * noise / was if noise_m else 1.5 * beside
        now = trial(T, LEAD, factor * e, zero, zero, np.full(6, 20.0))
        said = contradiction(before, now, loops, known, Q, f, first_rms_m=before.rms_m, noise_m=noise_m)
        assert (said is not None) == contradicts, factor


def test_a_floor_has_the_cause_that_makes_most_of_it() -> None:
    one = AxisLoop(*(np.zeros(len(F), complex) for _ in range(4)))
    e = np.zeros((LEAD + 1000, 6))
    e[LEAD:] = 1e-5 * np.sin(2.0 * np.pi * 200.0 * T * np.arange(1000))[:, None]
    fast = trial(T, LEAD, e, 0.0 * e, 0.0 * e, np.full(6, 20.0))
    f = frequencies(len(fast.e), T)
    loops = [AxisLoop(*(np.zeros(len(f), complex) for _ in one))] * 6
    found = floor(fast, None, loops, Filter(80.0), f, length_m=1e-7, rate_m_s=0.0)
    assert found.beyond_filter_m == pytest.approx(1e-5 / 2.0**0.5, rel=0.02)
    assert found.not_repeating_m == 0.0
    other = floor(fast, fast.tracked, loops, Filter(80.0), f, length_m=0.0, rate_m_s=0.0)
    assert other.not_repeating_m == pytest.approx(1e-5 / 2.0, rel=1e-3), "of two runs each has a half"


@pytest.mark.parametrize(
    ("apart_m", "not_repeating_m"), [(1e-4, 0.0), (1.1e-4, 1e-4 * 0.21**0.5), (5e-5, 0.0), (None, 0.0)]
)
def test_noise_of_lengths_and_rates_is_not_told_as_what_does_not_repeat(
    apart_m: float | None, not_repeating_m: float
) -> None:
    """A law that makes 2 ms of a rate makes 60 um of 30 mm/s; with 80 um of the lengths they are 100 um."""
    zero = np.zeros((LEAD + 1000, 6))
    still = trial(T, LEAD, zero, zero, zero, np.full(6, 20.0))
    f = frequencies(len(still.e), T)
    nothing = np.zeros(len(f), complex)
    loops = [AxisLoop(nothing, nothing, nothing, np.full(len(f), 2e-3 + 0j))] * 6
    unexplained = None if apart_m is None else np.full((1000, 6), 2.0**0.5 * apart_m)
    found = floor(still, unexplained, loops, Filter(80.0), f, length_m=8e-5, rate_m_s=0.03)
    assert found.encoder_m == 8e-5
    assert found.rate_m == pytest.approx(6e-5)
    assert found.not_repeating_m == pytest.approx(not_repeating_m, abs=1e-9)


@pytest.mark.parametrize(
    ("contradicted", "inside", "factor", "expected"),
    [
        (True, 1e-3, 0.1, "contradicted"),
        (False, 1e-3, None, "learned"),
        (False, 1e-3, 0.5, "learned"),
        (False, 1e-3, 0.95, "floor"),
        (False, 1.4e-7, 0.1, "floor"),
    ],
)
def test_learning_goes_on_while_the_error_falls(
    contradicted: bool, inside: float, factor: float | None, expected: str
) -> None:
    assert state(contradicted, inside, factor, 1e-7) == expected


def test_the_lead_fits_before_a_trial() -> None:
    assert pytest.approx(LEAD) == LEAD_S / T
