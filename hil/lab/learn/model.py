"""Model for learning: the closed loop of each leg's axis, and the bound of the model error."""

from functools import cache
from pathlib import Path
from typing import NamedTuple

import numpy as np

from drivers.arrays import Array
from drivers.errors import ConfigurationError
from hil.app.configuration.configuration import Configuration
from hil.app.configuration.controller_file import controller_of
from hil.app.configuration.section_file import read_section
from hil.app.loop_delay import loop_delay
from hil.config.axis_model import AxisModel
from hil.control.law import ErrorDynamics, LawSettings
from hil.design.stability.sampled_loop import gains, predicting, sampled_axis, sampled_controller
from hil.lab.identify.linearised import law_terms, linearised_law, state_of
from hil.lab.learn.convergence import (
    AxisLoop,
    Choice,
    Uncertainty,
    axis_loop,
    choose,
    contraction,
    frequencies,
    stated,
)
from hil.mathematics.linear_system import LinearSystem, lag
from hil.robot.dynamics import Model

BELIEVED_UP_TO = 0.1
"""Upper end of a stated error, as a share of the rate: legs, joints and drives bend beyond it."""


class Belief(NamedTuple):
    """The nominal plant of six leg axes and its uncertainty."""

    gain: Array
    """(6,), of the nominal axes."""
    transport_s: float
    lag_s: float
    uncertainty: Uncertainty
    source: str


class Learner(NamedTuple):
    """Closed loops, error ratio and filter for the learning update."""

    loops: list[AxisLoop]
    """Closed loop of each leg, at `f_Hz`."""
    f_Hz: Array
    c: Array
    """Contraction without a filter, at `f_Hz`."""
    choice: Choice
    belief: Belief


def belief_of(c: Configuration, axes: Path | None, gain_error: float, delay_error_s: float) -> Belief:
    """Nominal plant from a file of `hil identify`, else from configured delays. Raises ConfigurationError."""
    if axes is None:
        delay = loop_delay(c)
        bound = stated(gain_error, delay_error_s, BELIEVED_UP_TO * c.loop.rate_Hz)
        source = (
            f"the configuration, gain within {100 * gain_error:g} %, delay within {1e3 * delay_error_s:g} ms"
        )
        return Belief(np.ones(6), delay.transport_s, delay.lag_s, bound, source)
    model, _ = read_section(axes, AxisModel)
    if model.axes != "joint" or model.rate_Hz != c.loop.rate_Hz:
        raise ConfigurationError(
            f"{axes}: {model.axes} axes, {model.rate_Hz:g} Hz, allowed: joint axes at {c.loop.rate_Hz:g} Hz"
        )
    nominal, profile = model.nominal, model.uncertainty
    bound = Uncertainty(np.array(profile.frequency_Hz), np.array(profile.bound))
    lag_s, transport_s = 1e-3 * nominal.lag_ms, 1e-3 * nominal.transport_ms
    return Belief(np.array(nominal.gain), transport_s, lag_s, bound, str(axes))


def learner(c: Configuration, belief: Belief, samples: int) -> Learner:
    """Model for the update of a run with `samples` samples. Raises ConfigurationError, ModelError."""
    period_s = 1.0 / c.loop.rate_Hz
    f = frequencies(samples, period_s)
    controllers = _controllers(c, period_s)
    found: dict[tuple[float, int], AxisLoop] = {}
    loops = []
    for gain, controller in zip(belief.gain.tolist(), controllers, strict=True):
        key = gain, id(controller)
        if key not in found:
            axis = sampled_axis(belief.transport_s, lag(belief.lag_s), period_s, gain)
            found[key] = axis_loop(axis, controller, f, looks_ahead=c.controller.lookahead is not None)
        loops.append(found[key])
    bound = contraction(loops, f, belief.uncertainty)
    return Learner(loops, f, bound, choose(bound, f), belief)


def _controllers(c: Configuration, period_s: float) -> list[LinearSystem]:
    """Controller of each leg, from [e m, de m/s] to the demanded acceleration, m/s^2."""
    law = c.controller
    _require_known(c, law)
    designed = controller_of(law, c.folder)
    if designed is not None:
        return [sampled_controller(designed)] * 6
    dynamics, delay = law.error_dynamics(), law.lookahead
    assert isinstance(dynamics, ErrorDynamics)

    @cache
    def controller(K_P: float, K_D: float) -> LinearSystem:
        if delay is None:
            return gains(K_P, K_D, period_s)
        bus_s, lag_s, hold_s = (1e-3 * ms for ms in (delay.bus_ms, delay.drive_lag_ms, delay.hold_ms))
        return predicting(K_P, K_D, period_s, bus_s=bus_s, lag_s=lag_s, hold_s=hold_s)

    return list(map(controller, dynamics.K_P.tolist(), dynamics.K_D.tolist()))


def _require_known(c: Configuration, law: LawSettings) -> None:
    where = f"{c.source}: controller.law: {law.law}"
    if linearised_law(c).space != "joint":
        raise ConfigurationError(
            f"{where} controls the pose; learning is for laws of leg axes, allowed: inverse_dynamics, "
            "partial_linearisation, state_space with a controller of joint axes"
        )
    dynamics = law.error_dynamics()
    layered = isinstance(dynamics, ErrorDynamics) and dynamics.steepness != 0.0
    if controller_of(c.controller, c.folder) is None and (isinstance(dynamics, str) or layered):
        raise ConfigurationError(
            f"{where} has no linear loop, so learning cannot be proven to converge; allowed: "
            "inverse_dynamics, partial_linearisation, state_space"
        )
    if c.estimation.wrench.source == "observer":
        raise ConfigurationError(
            f"{c.source}: estimation.wrench.source: the observer takes the learned forces for a load, and "
            "the law compensates them, which changes the loop; allowed with learning: none, sensor"
        )


def decay_rate(c: Configuration) -> Array:
    """Rate (6,) rad/s at which each leg's error decays after the end of a run."""
    dynamics = c.controller.error_dynamics()
    return np.sqrt(dynamics.K_P) if isinstance(dynamics, ErrorDynamics) else np.full(6, DEFAULT_DECAY)


DEFAULT_DECAY = 20.0
"""rad/s, for a controller from a file: it has many modes, and the time after a run hardly counts."""


def force_per_acceleration(model: Model, p: Array, R: Array) -> Array:
    """Forces (n, 6, 6) N per 1 m/s^2 of each leg along the path, by the law's model.

    A = J^-T M J^-1 at p (n, 3) m and R (n, 3, 3): tau = A a makes six equal axes of the legs.
    """
    still = np.zeros(6)
    states = [state_of(model, place, turn, still, still) for place, turn in zip(p, R, strict=True)]
    return law_terms("joint", model, states)[0]
