import numpy as np
import pytest

from drivers.errors import ModelError
from hil.design.synthesis.reduction import reduced
from hil.design.synthesis.wiring import well_scaled, wired
from hil.mathematics.linear_system import LinearSystem, static

OMEGA = np.geomspace(0.1, 1e3, 30)
S = 1j * OMEGA


def first_order(pole: float, gain: float = 1.0, through: float = 0.0) -> LinearSystem:
    return LinearSystem(np.array([[-pole]]), np.eye(1), np.array([[gain]]), np.array([[through]]))


def test_a_diagram_has_the_responses_that_its_algebra_gives():
    parts = {"a": (first_order(3.0), {"r": 1.0, "b": -2.0}), "b": (first_order(5.0), {"a": 1.0, "d": 1.0})}
    G = wired(parts, ["r", "d"], [{"b": 1.0}, {"a": 1.0, "r": 1.0}]).response(OMEGA)
    a, b = 1.0 / (S + 3.0), 1.0 / (S + 5.0)
    back = 1.0 + 2.0 * a * b
    expected = np.array([[a * b / back, b / back], [a / back + 1.0, -2.0 * a * b / back]]).transpose(2, 0, 1)
    assert pytest.approx(expected, rel=1e-10) == G


def test_a_ring_of_gains_without_a_solution_is_refused():
    parts = {"a": (static(np.eye(1)), {"r": 1.0, "b": 1.0}), "b": (static(np.eye(1)), {"a": 1.0})}
    with pytest.raises(ModelError, match="well posed"):
        wired(parts, ["r"], [{"b": 1.0}])


def test_other_units_of_the_states_change_no_bit_of_the_poles_but_their_sizes():
    badly = LinearSystem(
        np.array([[-1.0, 1e9, 0.0], [0.0, -2.0, 1e-7], [0.0, 0.0, -3.0]]),
        np.array([[0.0], [0.0], [1e8]]),
        np.array([[1e-6, 0.0, 0.0]]),
        np.zeros((1, 1)),
    )
    well = well_scaled(badly)
    assert well.response(OMEGA) == pytest.approx(badly.response(OMEGA), rel=1e-12)
    entries = np.abs(np.concatenate([well.A[[0, 1], [1, 2]], well.B[2], well.C[:, 0]]))
    assert entries.max() < 8 * entries.min()


def test_states_that_cancel_go_and_those_that_act_stay():
    """(s + 20.0001) / (s + 20) does next to nothing: of order 3 is left order 2."""
    near = first_order(20.0, 1e-4, 1.0)
    K = near.after(first_order(2.0)).after(first_order(70.0))
    small, off = reduced(K, np.ones(1), 1e-4)
    assert small.order == 2
    worst = np.abs(small.response(OMEGA) - K.response(OMEGA)).max()
    assert 0.0 < worst <= off * np.abs(K.response(OMEGA)).max()


def test_an_unstable_system_is_left_as_it_is():
    unstable = first_order(-20.0).after(first_order(2.0))
    assert reduced(unstable, np.ones(1), 0.9) == (unstable, 0.0)


def test_what_acts_little_stays_where_little_is_asked_to_go():
    near = first_order(20.0, 1e-4, 1.0)
    assert reduced(near.after(first_order(2.0)), np.ones(1), 1e-12)[0].order == 2
