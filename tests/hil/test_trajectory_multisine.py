"""Multisines: their spectrum, their peak, lines of their own for each axis."""

import numpy as np
import pytest

from drivers.errors import ConfigurationError
from hil.config.reference import MultisineReference
from hil.config.values import Pose
from hil.trajectory.build import build_trajectory
from hil.trajectory.multisine import schroeder, seeded

HOME = Pose(position_m=(0.1, 0.0, 1.0))
PERIOD, RAMP, RATE = 10.0, 2.0, 200


def build(*axes, periods=2, ramp_s=RAMP, centre=None):
    settings = MultisineReference.model_validate(
        {
            "type": "multisine",
            "axes": axes,
            "period_s": PERIOD,
            "periods": periods,
            "ramp_s": ramp_s,
            "centre": centre,
        }
    )
    return build_trajectory(settings, HOME, None)


def lines(axis="x_m", band=(0.5, 5.0), count=10, amplitude=0.05, **more):
    return {"axis": axis, "band_Hz": band, "lines": count, "amplitude": amplitude, **more}


def period(trajectory, n=0):
    """One whole period of x, y, z (m), less the centre."""
    t = RAMP + PERIOD * (n + np.arange(int(PERIOD * RATE)) / (PERIOD * RATE))
    return np.array([trajectory.sample(float(s)).p for s in t]) - HOME.position_m


@pytest.mark.parametrize("phases", ["schroeder", "random"])
def test_the_lines_are_equal_and_lie_in_the_band_on_multiples_of_the_period(phases):
    x = period(build(lines(phases=phases)))[:, 0]
    spectrum = np.abs(np.fft.rfft(x)) * 2 / len(x)
    found = np.flatnonzero(spectrum > 1e-9)
    assert found.tolist() == [5, 10, 15, 20, 25, 30, 35, 40, 45, 50]  # 0.5 to 5 Hz in steps of 0.5
    np.testing.assert_allclose(spectrum[found], spectrum[found[0]], rtol=1e-9)


def test_the_amplitude_is_the_largest_deviation():
    for phases, seed in (("schroeder", 0), ("random", 0), ("random", 1)):
        x = period(build(lines(phases=phases, seed=seed, count=23)))[:, 0]
        assert 0.05 * 0.99 < np.abs(x).max() <= 0.05


def test_schroeders_phases_keep_the_peak_below_twice_the_effective_value():
    x = period(build(lines(count=46)))[:, 0]
    assert np.abs(x).max() < 2 * np.sqrt((x**2).mean()), "equal phases: sqrt(2 x 46) = 9.6 times"


def test_schroeders_phases_are_those_of_the_paper():
    """x(t) = sum of a sin(2 pi k t / T - pi n (n - 1) / N), from the end of the ramp on."""
    x = period(build(lines(count=4, band=(0.2, 0.5))))[:, 0]
    t = np.arange(len(x)) / RATE
    expected = sum(
        np.sin(2 * np.pi * k * t / PERIOD - np.pi * n * (n - 1) / 4) for n, k in enumerate([2, 3, 4, 5], 1)
    )
    np.testing.assert_allclose(x, expected * 0.05 / np.abs(expected).max(), rtol=0, atol=0.05 * 2e-3)
    assert np.corrcoef(x, expected)[0, 1] == pytest.approx(1.0, abs=1e-12)


def test_whole_periods_repeat_and_the_ends_are_at_rest_at_the_centre():
    trajectory = build(lines(), lines("y_m", amplitude=0.02))
    assert trajectory.duration_s == 2 * RAMP + 2 * PERIOD
    np.testing.assert_allclose(period(trajectory, 0), period(trajectory, 1), rtol=0, atol=1e-13)
    for t in (0.0, 24.0):
        np.testing.assert_allclose(trajectory.sample(t).p, HOME.position_m, rtol=0, atol=1e-15)
        np.testing.assert_allclose(trajectory.sample(t).twist, 0, atol=1e-12)
        np.testing.assert_allclose(trajectory.sample(t).dtwist, 0, atol=1e-12)


def test_no_two_axes_share_a_line():
    x, y, z = period(build(lines(), lines("y_m"), lines("z_m", count=6))).T
    spectra = [set(np.flatnonzero(np.abs(np.fft.rfft(w)) > 1e-6)) for w in (x, y, z)]
    assert [len(s) for s in spectra] == [10, 10, 6]
    assert len(set.union(*spectra)) == 26


def test_a_seed_repeats_and_another_one_differs():
    one, same, other = (period(build(lines(phases="random", seed=s))) for s in (4, 4, 5))
    np.testing.assert_array_equal(one, same)
    assert np.abs(one - other).max() > 0.01


@pytest.mark.parametrize(
    ("axes", "complaint"),
    [
        ([lines(count=47)], r"axes\[0\].lines: 47 lines do not fit into 0.5 to 5 Hz, allowed: at most 46"),
        ([lines(band=(5, 0.5))], r"axes\[0\].lines: .* at most 0"),
        ([lines(count=40), lines("y_m")], r"axes\[1\].lines: .* at most 6, .* less 40 that other axes have"),
    ],
)
def test_bands_without_room_for_the_lines_are_refused(axes, complaint):
    with pytest.raises(ConfigurationError, match=complaint):
        build(*axes)


def test_a_turn_is_refused_by_its_peak_and_not_by_the_sum_of_its_lines():
    """200 lines of a peak of 12 deg are 0.7 deg each, 145 deg in all: on three axes that is above half a turn."""
    axes = [lines(axis, (5.0, 90.0), 200, 12.0) for axis in ("rx_deg", "ry_deg", "rz_deg")]
    assert build(*axes).duration_s == pytest.approx(24.0)
    with pytest.raises(
        ConfigurationError, match=r"centre and amplitudes: the rotation vector reaches 183\.8\d* deg"
    ):
        build(*(axis | {"amplitude": 106.14} for axis in axes))  # 106.14 sqrt(3) = 183.84


def test_the_turn_of_the_centre_comes_to_that_of_the_lines_of_an_axis():
    centre = {"position_m": (0.0, 0.0, 1.0), "rotation_vector_deg": (0.0, 170.0, 0.0)}
    axes = [lines("ry_deg", (0.5, 2.0), 3, 5.0), lines("ry_deg", (2.1, 4.0), 3, 6.0)]
    with pytest.raises(ConfigurationError, match=r"centre and amplitudes: .* reaches 181 deg"):
        build(*axes, centre=centre)


def test_phases_of_schroeder_are_those_of_the_paper_within_a_turn():
    np.testing.assert_allclose(schroeder(5, 7), -np.pi * np.array([0.0, 2.0, 6.0, 2.0, 0.0]) / 5, rtol=1e-15)


def test_random_phases_are_the_same_on_every_machine_and_spread_evenly_over_a_turn():
    np.testing.assert_allclose(
        seeded(3, 4),
        2 * np.pi * np.array([0.23604808973743452, 0.1031660342307158, 0.396058242610681]),
        rtol=1e-15,
    )
    counts, _ = np.histogram(seeded(4000, 1), bins=4, range=(0.0, 2 * np.pi))
    assert counts.sum() == 4000
    assert counts.min() > 900


def test_the_phases_that_a_long_ramp_needs_are_within_two_turns():
    wave = build(lines(phases="random"), lines("y_m"), ramp_s=1234.5)._wave
    assert np.abs(wave[:, 2]).max() < 4 * np.pi
