"""Linear systems: series, loops, sampling and stability by textbook formulas."""

import numpy as np
import pytest

from drivers.errors import ModelError
from hil.mathematics.linear_system import LinearSystem, static

OMEGA = np.geomspace(0.1, 1e3, 40)
S = 1j * OMEGA


def first_order(pole: float, gain: float = 1.0) -> LinearSystem:
    return LinearSystem(np.array([[-pole]]), np.array([[1.0]]), np.array([[gain * pole]]), np.zeros((1, 1)))


def test_lags_in_series_and_side_by_side_are_the_textbooks():
    slow, fast = first_order(5.0, 2.0), first_order(30.0)
    series = slow.after(fast).response(OMEGA)[:, 0, 0]
    assert series == pytest.approx(300.0 / ((S + 5.0) * (S + 30.0)), rel=1e-12)
    G = slow.beside(static(np.array([[3.0]]))).response(OMEGA)
    assert G[:, 0, 0] == pytest.approx(10.0 / (S + 5.0), rel=1e-12)
    assert (G[:, 1, 1] == 3.0).all()
    assert not G[:, [0, 1], [1, 0]].any()


def test_closing_a_loop_gives_the_textbooks_sensitivity_also_with_feed_through():
    P = first_order(5.0)._replace(D=np.array([[0.5]]))
    # z = y = P u + w, seen by the controller
    generalised = LinearSystem(
        P.A, np.hstack([0 * P.B, P.B]), np.vstack([P.C, P.C]), np.array([[1.0, 0.5], [1.0, 0.5]])
    )
    K = first_order(40.0, -7.0)._replace(D=np.array([[-2.0]]))
    loop = P.response(OMEGA)[:, 0, 0] * K.response(OMEGA)[:, 0, 0]
    assert generalised.closed_with(K).response(OMEGA)[:, 0, 0] == pytest.approx(1.0 / (1.0 - loop), rel=1e-10)


def test_a_loop_that_is_not_well_posed_is_refused():
    with pytest.raises(ModelError, match="well posed"):
        static(np.ones((2, 2))).closed_with(static(np.array([[1.0]])))


def test_a_double_integrator_behind_a_hold_is_the_textbooks():
    T = 0.01
    P = LinearSystem(
        np.array([[0.0, 1.0], [0.0, 0.0]]), np.array([[0.0], [1.0]]), np.eye(1, 2), np.zeros((1, 1))
    )
    sampled = P.sampled(T)
    z = np.exp(1j * OMEGA[OMEGA < 300] * T)
    expected = 0.5 * T**2 * (z + 1) / (z - 1) ** 2
    assert sampled.response(OMEGA[OMEGA < 300])[:, 0, 0] == pytest.approx(expected, rel=1e-9)
    assert not sampled.is_stable()
    with pytest.raises(ModelError, match="different time"):
        sampled.after(P)


def test_stability_is_the_half_plane_or_the_unit_circle():
    assert first_order(5.0).is_stable()
    assert first_order(5.0).sampled(0.1).is_stable()
    assert not first_order(-5.0).is_stable()
    assert not first_order(-5.0).sampled(0.1).is_stable()
