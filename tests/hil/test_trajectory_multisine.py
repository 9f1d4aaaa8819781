"""Multisines: their spectrum, their peak, and separate lines for each axis."""

import numpy as np
import pytest

from drivers.errors import ConfigurationError
from hil.config.reference import MultisineReference
from hil.config.values import Pose
from hil.trajectory.build import build_trajectory
from hil.trajectory.multisine import seeded

HOME = Pose(position_m=(0.1, 0.0, 1.0))
PERIOD, RAMP, RATE = 10.0, 2.0, 200


def build(*axes, centre=None):
    settings = {"type": "multisine", "axes": axes, "period_s": PERIOD, "periods": 2, "ramp_s": RAMP}
    return build_trajectory(MultisineReference.model_validate({**settings, "centre": centre}), HOME, None)


def lines(axis="x_m", band=(0.5, 5.0), count=10, amplitude=0.05, **more):
    return {"axis": axis, "band_Hz": band, "lines": count, "amplitude": amplitude, **more}


def period(trajectory, n=0):
    """One whole period of x, y, z (m), minus the centre."""
    t = RAMP + PERIOD * (n + np.arange(int(PERIOD * RATE)) / (PERIOD * RATE))
    return np.array([trajectory.sample(float(s)).p for s in t]) - HOME.position_m


def spectrum(x):
    """Amplitudes of the multiples of the period."""
    return np.abs(np.fft.rfft(x)) * 2 / len(x)


@pytest.mark.parametrize("phases", ["schroeder", "random"])
def test_multisine_frequencies_have_equal_amplitudes_and_are_harmonics_within_the_band(phases):
    found = spectrum(period(build(lines(phases=phases)))[:, 0])
    at = np.flatnonzero(found > 1e-9)
    assert at.tolist() == [5, 10, 15, 20, 25, 30, 35, 40, 45, 50]  # 0.5 to 5 Hz in steps of 0.5
    np.testing.assert_allclose(found[at], found[at[0]], rtol=1e-9)


def test_multisine_amplitude_is_its_largest_deviation():
    for phases, seed in (("schroeder", 0), ("random", 0), ("random", 1)):
        x = period(build(lines(phases=phases, seed=seed, count=23)))[:, 0]
        assert 0.05 * 0.99 < np.abs(x).max() <= 0.05


def test_schroeder_phases_agree_with_the_paper():
    """x(t) = sum of a sin(2 pi k t / T - pi n (n - 1) / N), from the end of the ramp on."""
    x = period(build(lines(count=4, band=(0.2, 0.5))))[:, 0]
    t = np.arange(len(x)) / RATE
    expected = sum(
        np.sin(2 * np.pi * k * t / PERIOD - np.pi * n * (n - 1) / 4) for n, k in enumerate([2, 3, 4, 5], 1)
    )
    np.testing.assert_allclose(x, expected * 0.05 / np.abs(expected).max(), rtol=0, atol=0.05 * 2e-3)
    assert np.corrcoef(x, expected)[0, 1] == pytest.approx(1.0, abs=1e-12)


def test_random_phases_are_the_same_on_every_machine():
    known = 2 * np.pi * np.array([0.23604808973743452, 0.1031660342307158, 0.396058242610681])
    np.testing.assert_allclose(seeded(3, 4), known, rtol=1e-15)
    one, other = (period(build(lines(phases="random", seed=s))) for s in (4, 5))
    assert np.abs(one - other).max() > 0.01


def test_whole_periods_repeat_and_both_ends_rest_at_the_centre():
    trajectory = build(lines(), lines("y_m", amplitude=0.02))
    assert trajectory.duration_s == 2 * RAMP + 2 * PERIOD
    np.testing.assert_allclose(period(trajectory, 0), period(trajectory, 1), rtol=0, atol=1e-13)
    for t in (0.0, 24.0):
        np.testing.assert_allclose(trajectory.sample(t).p, HOME.position_m, rtol=0, atol=1e-15)
        np.testing.assert_allclose(trajectory.sample(t).dtwist, 0, atol=1e-12)


def test_multisine_axes_share_no_frequency():
    x, y, z = period(build(lines(), lines("y_m"), lines("z_m", count=6))).T
    found = [set(np.flatnonzero(spectrum(w) > 1e-9)) for w in (x, y, z)]
    assert [len(each) for each in found] == [10, 10, 6]
    assert len(set.union(*found)) == 26


TURNED = {"position_m": (0.0, 0.0, 1.0), "rotation_vector_deg": (0.0, 170.0, 0.0)}


@pytest.mark.parametrize(
    ("axes", "more", "complaint"),
    [
        ([lines(count=47)], {}, r"axes\[0\].lines: .* at most 46"),
        ([lines(band=(5, 0.5))], {}, r"axes\[0\].lines: .* at most 0"),
        ([lines(count=40), lines("y_m")], {}, r"axes\[1\].lines: .* at most 6"),
        ([lines(band=(1.0, 20_000.1))], {}, r"allowed: up to 20000 Hz"),
        ([lines("ry_deg", (0.5, 2), 3, 5), lines("ry_deg", (2.1, 4), 3, 6)], {"centre": TURNED}, "181 deg"),
    ],
)
def test_an_invalid_multisine_is_refused(axes, more, complaint):
    with pytest.raises(ConfigurationError, match=complaint):
        build(*axes, **more)


def test_rotation_multisine_is_refused_by_its_peak_not_by_the_sum_of_its_amplitudes():
    """200 lines with a peak of 12 deg have 0.7 deg each, 145 deg in all: on three axes more than half a
    turn.
    """
    axes = [lines(axis, (5.0, 90.0), 200, 12.0) for axis in ("rx_deg", "ry_deg", "rz_deg")]
    assert build(*axes).duration_s == pytest.approx(24.0)
    with pytest.raises(ConfigurationError, match=r"reaches 183\.8\d* deg"):
        build(*(axis | {"amplitude": 106.14} for axis in axes))  # 106.14 sqrt(3) = 183.84
