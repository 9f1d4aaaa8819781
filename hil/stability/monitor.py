"""From a control law to what watches its certificate: which laws have one, and the numbers of it."""

from __future__ import annotations

from collections.abc import Iterator
from math import ceil, isinf
from typing import NamedTuple

import numpy as np

from drivers.arrays import Array
from hil.config import (
    ControllerSettings,
    ErrorDynamics,
    ModelBasedSettings,
    MonitorSettings,
    PoseInverseDynamicsSettings,
    RobustInverseDynamicsSettings,
    SlidingModeSettings,
)
from hil.control.law import error_gains
from hil.mathematics.linear_algebra import solve
from hil.robot.geometry import Platform
from hil.robot.kinematics import jacobian
from hil.safety import certificate as rule
from hil.safety.certificate import NO_WATCH, Watch
from hil.stability.error_dynamics import certificate

ACTIONS = {"log": 0.0, "warn": 1.0, "fault": 2.0}
LAGS = 3.0
"""Time constants of the force loop after which a command is forgotten, but for 5 % of it."""
HELD_TICKS = 2
"""A force acts from its tick's end to the next one's: transport and hold."""

REASONS = {
    "pd": "its error dynamics are those of the platform: they change with the pose",
    "pid": "its error dynamics are those of the platform, and its integral is a state that is not measured",
    "pd_gravity": "its energy function belongs to a reference at rest; in motion it may grow",
    "cartesian_pd": "its energy function belongs to a reference at rest; in motion it may grow",
    "feedforward_pd": "its error dynamics J^-T M J^-1 E'' + K_v E' + K_p E = 0 change with the pose",
    "state_space": "its own states are part of the error dynamics",
}
"""By law: why no V of constant gains belongs to its error."""


class ErrorAxes(NamedTuple):
    """The error dynamics e'' + K_D e' + K_P e = d that a law leaves, and where they end.

    Beyond the layer, |de + slope e| > layer, the law asks for steepness (|de + slope e| - layer) less.
    """

    K_P: Array
    K_D: Array
    pose: bool = False
    slope: Array | float = 0.0
    steepness: float = 0.0
    layer: float = 1.0
    shared: bool = False
    """The layer is of all legs at once."""


def error_axes(settings: ControllerSettings) -> ErrorAxes | str:
    """Return the linear error dynamics of a law, or why it has none."""
    if isinstance(settings, ErrorDynamics):
        gains = error_gains(settings.wn_rad_s, settings.damping_ratio)
        return ErrorAxes(*gains, pose=isinstance(settings, PoseInverseDynamicsSettings))
    if isinstance(settings, SlidingModeSettings):
        K_P, K_D = settings.linear_gains
        if isinf(K_D):
            return "without a boundary layer it switches: no gains are its own"
        layer = settings.boundary_layer
        return ErrorAxes(
            np.full(6, K_P), np.full(6, K_D),
            slope=settings.lambda_rad_s, steepness=settings.switching_gain / layer, layer=layer,
        )  # fmt: skip
    if isinstance(settings, RobustInverseDynamicsSettings):
        stiffness, damping = error_gains(settings.wn_rad_s, settings.damping_ratio)
        layer = settings.boundary_layer_m_s
        if layer == 0.0:
            return "without a boundary layer it switches: no gains are its own"
        steepness, slope = settings.bound / layer, damping / 2.0
        return ErrorAxes(
            stiffness + steepness * slope, damping + steepness,
            slope=slope, steepness=steepness, layer=layer, shared=True,
        )  # fmt: skip
    return REASONS[settings.law]


def certified_law(
    monitor: MonitorSettings, controller: ControllerSettings, _: object
) -> Iterator[tuple[tuple[str, str], str]]:
    """Refuse to act on the certificate of a law that has none."""
    reason = error_axes(controller)
    if monitor.action != "log" and isinstance(reason, str):
        message = f"law {controller.law} has no certificate: {reason}, allowed: log, given: {monitor.action}"
        yield ("monitor", "action"), message


def build_watch(
    settings: MonitorSettings,
    controller: ControllerSettings,
    platform: Platform,
    home: tuple[Array, Array],
    period_s: float,
) -> Watch:
    """Return what `hil.safety.certificate` watches; nothing for a law without a certificate.

    home: p (3,) m and R (3, 3), where the noise of the legs is turned into that of the pose.
    """
    axes = error_axes(controller)
    if isinstance(axes, str):
        return NO_WATCH
    K_P, K_D, alpha, P = certificate(axes.K_P, axes.K_D)
    noise = np.ones(6)
    disturbance = np.full(6, settings.disturbance_m_s2)
    if axes.pose:
        disturbance[3:] = settings.disturbance_rad_s2
        J = jacobian(platform, *home)
        columns = [np.abs(solve(J, leg)) for leg in np.eye(6)]
        noise = columns[0] + columns[1] + columns[2] + columns[3] + columns[4] + columns[5]
    h = _horizon_s(controller)
    disturbance *= 1.0 + h * (K_D + K_P * h / 2.0)
    g = np.sqrt(P[:, 1, 1])
    constants = np.zeros((rule.CONSTANTS, 6))
    constants[rule.K_P], constants[rule.K_D] = K_P, K_D
    constants[rule.P_11], constants[rule.P_12], constants[rule.P_22] = P[:, 0, 0], P[:, 0, 1], P[:, 1, 1]
    constants[rule.DISTURBANCE] = disturbance
    constants[rule.NOISE] = noise * (
        np.sqrt(P[:, 0, 0]) * settings.length_noise_m + g * settings.rate_noise_m_s
    )
    constants[rule.RISE] = g * period_s
    constants[rule.DECAY] = [_decay(2.0 * a * period_s) for a in alpha.tolist()]
    constants[rule.SLOPE], constants[rule.STEEPNESS] = axes.slope, axes.steepness
    constants[rule.SCALARS, rule.POSE] = axes.pose
    constants[rule.SCALARS, rule.SHARED] = axes.shared
    constants[rule.SCALARS, rule.LAYER] = axes.layer
    constants[rule.SCALARS, rule.ACTION] = ACTIONS[settings.action]
    constants[rule.SCALARS, rule.CONFIRM] = settings.confirm_ticks
    constants[rule.SCALARS, rule.PERIOD] = period_s
    constants.flags.writeable = False
    return Watch(constants, HELD_TICKS + ceil(1e-3 * settings.drive_lag_ms * LAGS / period_s))


def _horizon_s(settings: ControllerSettings) -> float:
    """Return how far the law looks ahead, s: what disturbs it until then it does not see coming."""
    if not isinstance(settings, ModelBasedSettings) or settings.delay_compensation is None:
        return 0.0
    delay = settings.delay_compensation
    return 1e-3 * (delay.bus_ms + delay.drive_lag_ms + delay.hold_ms)


def _decay(x: float) -> float:
    """Return exp(-x), x >= 0, by the series of exp(x)."""
    total = term = 1.0
    for k in range(1, 60):
        term *= x / k
        total += term
    return 1.0 / total
