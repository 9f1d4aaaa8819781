"""Run-time monitor of a law's Lyapunov function: which laws have one, and the monitor's constants."""

from collections.abc import Iterator
from math import ceil, isinf

import numpy as np

from drivers.arrays import Array
from hil.config.delay import DelayCompensation
from hil.config.limits import MonitorSettings
from hil.control import ControllerSettings
from hil.control.law import ErrorDynamics, LawSettings
from hil.design.stability.error_dynamics import certificate
from hil.mathematics.linear_algebra import solve
from hil.robot.geometry import Platform
from hil.robot.kinematics import jacobian
from hil.safety import certificate as rule
from hil.safety.certificate import NO_WATCH, Watch

ACTIONS = {"log": 0.0, "warn": 1.0, "fault": 2.0}
LAGS = 3.0
"""Time constants of the force loop after which 5 % of a command's effect remains."""


def certified(controller: LawSettings) -> ErrorDynamics | str:
    """Error dynamics that have a Lyapunov function with constant gains; else, as text, why they have none."""
    dynamics = controller.error_dynamics()
    if isinstance(dynamics, ErrorDynamics) and isinf(dynamics.steepness):
        return "without a boundary layer it switches: its gains are infinite"
    return dynamics


def certified_law(
    monitor: MonitorSettings, controller: ControllerSettings, _: object
) -> Iterator[tuple[tuple[str, str], str]]:
    """Yield an error for a monitor action other than log if the law has no Lyapunov function."""
    reason = certified(controller)
    if monitor.action != "log" and isinstance(reason, str):
        message = f"law {controller.law} has no certificate: {reason}, allowed: log, given: {monitor.action}"
        yield ("monitor", "action"), message


def build_watch(
    settings: MonitorSettings,
    controller: LawSettings,
    platform: Platform,
    home: tuple[Array, Array],
    period_s: float,
    transport_ticks: int = 1,
    lag_s: float = 0.0,
) -> Watch:
    """Constants of the monitor `hil.safety.certificate`; NO_WATCH for a law without Lyapunov function.

    home: p (3,) m and R (3, 3), the pose at which leg noise is converted to pose noise.
    transport_ticks: from a measurement to the force computed from it. lag_s: of the drives' force loop, if
    known.
    """
    dynamics = certified(controller)
    if isinstance(dynamics, str):
        return NO_WATCH
    K_P, K_D, alpha, P = certificate(dynamics.K_P, dynamics.K_D)
    noise = np.ones(6)
    disturbance = np.full(6, settings.disturbance_m_s2)
    if dynamics.pose:
        disturbance[3:] = settings.disturbance_rad_s2
        J = jacobian(platform, *home)
        noise = sum((np.abs(solve(J, leg)) for leg in np.eye(6)), np.zeros(6))
    h = horizon_s(controller.lookahead)
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
    constants[rule.SLOPE], constants[rule.STEEPNESS] = dynamics.slope, dynamics.steepness
    constants[rule.SCALARS, rule.POSE] = dynamics.pose
    constants[rule.SCALARS, rule.SHARED] = dynamics.shared
    constants[rule.SCALARS, rule.LAYER] = dynamics.layer
    constants[rule.SCALARS, rule.ACTION] = ACTIONS[settings.action]
    constants[rule.SCALARS, rule.CONFIRM] = settings.confirm_ticks
    constants[rule.SCALARS, rule.PERIOD] = period_s
    constants.flags.writeable = False
    lag_s = max(1e-3 * settings.drive_lag_ms, lag_s)
    held = max(transport_ticks, 1) + 1  # from its tick's end to the next one's
    return Watch(constants, held + ceil(lag_s * LAGS / period_s))


def horizon_s(delay: DelayCompensation | None) -> float:
    """Prediction horizon of the law, s: it cannot react to a disturbance within this time."""
    return 0.0 if delay is None else 1e-3 * (delay.bus_ms + delay.drive_lag_ms + delay.hold_ms)


def _decay(x: float) -> float:
    """exp(-x), x >= 0, by the series of exp(x)."""
    total = term = 1.0
    for k in range(1, 60):
        term *= x / k
        total += term
    return 1.0 / total
