"""Looking ahead gives back what the delay takes: eigenvalues of a loop without one, where the delays are true."""

import numpy as np
import pytest

from hil.design.stability.prediction import predicting
from hil.design.stability.sampled import Axis, analyse, gains

T = 1e-3


@pytest.mark.parametrize("lag", [0.0, 0.8e-3])
@pytest.mark.parametrize("bus", [0.0, 0.5e-3, 1e-3, 2.3e-3])
def test_an_exact_prediction_leaves_the_slow_poles_of_the_loop_without_delay(bus, lag):
    """Critically damped, wn 20: continuous poles at -20 twice."""
    controller = predicting(400.0, 40.0, T, bus_s=bus, lag_s=lag, hold_s=0.5e-3)
    found = analyse(Axis(T, bus, lag), controller)
    slow = np.log(found.poles[np.argsort(-np.abs(found.poles))][:2]) / T
    assert found.stable
    np.testing.assert_allclose(np.mean(slow), -20.0, rtol=0.01)


def test_it_returns_the_phase_that_the_delay_takes():
    w_n, bus, lag = 90.0, 2e-3, 0.8e-3
    late = analyse(Axis(T, bus, lag), gains(w_n**2, 2 * w_n, T))
    ahead = analyse(Axis(T, bus, lag), predicting(w_n**2, 2 * w_n, T, bus_s=bus, lag_s=lag, hold_s=0.5e-3))
    assert late.margins is not None
    assert ahead.margins is not None
    assert late.margins.phase_deg < 45.0
    assert ahead.margins.phase_deg > late.margins.phase_deg + 10.0


def test_without_a_horizon_it_is_the_plain_controller():
    controller = predicting(400.0, 40.0, T, bus_s=0.0, lag_s=0.0, hold_s=0.0)
    np.testing.assert_allclose(controller.D, [[400.0, 40.0]])
    np.testing.assert_allclose(controller.C, 0.0)


def test_its_state_follows_the_commands_it_gave():
    """By hand for a bus of 1.5 periods: u[k-2] acts for half a period more, then u[k-1] up to the horizon 2 T."""
    K_P, K_D, e = 100.0, 10.0, 0.01
    c = predicting(K_P, K_D, T, bus_s=1.5 * T, lag_s=0.0, hold_s=0.5e-3)
    x, y, u = np.zeros(c.order), np.array([e, 0.0]), [0.0, 0.0]
    for _ in range(4):
        before, last = u[-2:]
        rate = -before * T / 2 - last * 1.5 * T
        length = e - before * ((T / 2) ** 2 / 2 + T / 2 * 1.5 * T) - last * (1.5 * T) ** 2 / 2
        u.append((c.C @ x + c.D @ y).item())
        x = c.A @ x + c.B @ y
        assert u[-1] == pytest.approx(K_P * length + K_D * rate, rel=1e-9)
