"""What of a tick the certificate is judged by: errors and motion each by its own weight, and the reference's past."""

import numpy as np
import pytest

from hil.safety.certificate import Watch
from tests.hil.test_safety import RATE_HZ, Bench, leg

T = 1.0 / RATE_HZ
LATE_s = 4e-3
"""Late enough to count as motion, and too little to make a tick a late one."""


def watching(disturbance):
    """Return a bench whose V is 9 e^2 + 4 e de + 4 de^2, and whose level neither grows nor decays.

    The law asks for an acceleration that no reference has.
    """
    table = np.zeros((12, 6))
    table[0] = 1e3
    table[2], table[3], table[4] = 9.0, 2.0, 4.0
    table[5] = disturbance
    table[8] = 1.0
    table[11] = [0.0, 0.0, 1.0, 1.0, 1.0, T]
    return Bench(watch=Watch(table, 3))


def test_an_error_of_length_and_one_of_rate_count_by_their_own_weights():
    bench = watching(disturbance=1e3)
    assert bench.tick(q=leg(4.5, 5.0), dq=leg(-0.25)).certificate[0] == pytest.approx(2.25 + 0.5 + 0.25)
    assert bench.tick(q=leg(4.5, 5.0), dq=leg(0.25)).certificate[0] == pytest.approx(2.25 - 0.5 + 0.25)


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_what_a_late_reading_makes_of_speed_and_of_acceleration_counts_by_their_own_weights(sign):
    """sqrt(P_11) = 3 times 2 m/s, sqrt(P_22) = 2 times 3 m/s^2 and a disturbance of 50 m/s^2."""
    bench = watching(disturbance=leg(50.0, 1e3))
    moving = {"dq_d": leg(sign * 2.0), "dq": leg(sign * 1.5), "ddq_d": leg(sign * -3.0)}
    bench.tick(**moving)
    share = bench.tick(**moving, lateness_ns=round(1e9 * LATE_s)).certificate[3]
    assert share == pytest.approx(1.0 / (1.0 + LATE_s * (3.0 * 2.0 + 2.0 * (3.0 + 50.0))))


def accelerated(tick):
    """Return the reference after so many ticks at 40 m/s^2 from 2 m/s on: a rate of 1 m/s more in each."""
    s = tick * T
    return {"q_d": leg(5.0 + 2.0 * s + 20.0 * s**2, 5.0), "dq_d": leg(2.0 + 40.0 * s), "ddq_d": leg(40.0)}


@pytest.mark.parametrize(
    ("changed", "by"), [("q_d", 0.99), ("q_d", 1.01), ("q_d", -1.01), ("dq_d", 0.99), ("dq_d", 1.01)]
)
def test_a_reference_is_compared_with_where_its_own_rates_bring_it_from_the_last_tick(changed, by):
    """A disturbance of 8 m/s^2 allows 0.2 m/s within a tick, and 5 mm."""
    bench = watching(disturbance=8.0)
    for tick in range(3):
        told = bench.tick(**accelerated(tick), q=leg(5.0, 5.0)).certificate
        assert np.isfinite(told[2]) == (tick > 0)
    moved = accelerated(3)
    moved[changed] = moved[changed] + leg(by * {"q_d": T * T * 8.0, "dq_d": T * 8.0}[changed])
    if changed == "dq_d":
        moved["q_d"] = moved["q_d"] + leg(0.5 * T * by * T * 8.0)
    assert np.isfinite(bench.tick(**moved).certificate[2]) == (abs(by) < 1.0)
