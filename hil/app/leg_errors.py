"""From a configuration to what the fused pose believes of lengths, rates and forces of the legs."""

from math import hypot, sqrt

import numpy as np

from hil.app.configuration.configuration import Configuration
from hil.app.encoder_limits import friction_N, read_noise, steps
from hil.estimation.fusion_layout import LegErrors

NOISE = sqrt(12.0)
"""Largest deviation by standard deviation: a step, or 3 to 4 standard deviations of white noise."""
UNKNOWN = sqrt(3.0)
"""The same of a constant that may be anything from the bound to its negative."""


def leg_errors(c: Configuration) -> LegErrors:
    """Return the errors of the legs as the sections estimation, monitor and plant state them."""
    s, monitor = c.estimation.fusion, c.monitor
    length_std_m, rate_std_m_s, force_std_N = s.length_std_m, s.rate_std_m_s, s.leg_force_std_N
    if length_std_m is None:
        length_std_m = _length_std_m(c)
    if rate_std_m_s is None:
        rate_std_m_s = read_noise(c, c.loop.rate_Hz).rate_m_s / NOISE
    if force_std_N is None:
        force_std_N = max(0.0, friction_N(c) - float(np.min(s.model.coulomb_friction_N)))
    return LegErrors(
        length_std_m,
        rate_std_m_s,
        rate_skew_std_s=1e-6 * monitor.rate_skew_us / UNKNOWN,
        rate_scale_std=1e-2 * monitor.rate_error_percent / UNKNOWN,
        force_std_N=force_std_N,
        force_time_s=1e-3 * s.leg_force_time_ms,
    )


def _length_std_m(c: Configuration) -> float:
    """Return the standard deviation of a length from the steps in which it comes."""
    if c.plant is None:
        return read_noise(c, c.loop.rate_Hz).length_m / NOISE
    encoder_m = c.plant.drives.encoder_resolution_m
    return hypot(encoder_m, steps(c, c.loop.rate_Hz).length_m - encoder_m) / NOISE
