"""How far a leg may stand from its reference because the frames carry forces in steps.

A step dF leaves e'' + K_D e' + K_P e = d with |d| <= |P| dF, P the accelerations of the legs per force:
at rest |e| <= |P| dF / K_P, leg by leg.
"""

import numpy as np

from drivers import build_protocol
from drivers.arrays import Array
from hil.app.configuration.configuration import Configuration
from hil.app.unknown_payload import unknown_payload
from hil.control.law import ErrorDynamics


def force_steps_N(c: Configuration) -> Array:
    """Return what one step of the command's field is at each leg, (6,) N; 0: as fine as a number is."""
    return build_protocol(c.bus, c.drives).traits.resolution.force


def error_m(P: Array, steps_N: Array, K_P: Array | float) -> float:
    """Return the largest error of a leg at rest, m, from P (..., 6, 6) 1/kg, steps (6,) N and K_P 1/s^2."""
    return float((np.abs(P) @ steps_N / K_P).max())


def stepped_error_m(c: Configuration) -> float | None:
    """Return that error at home, m; None for a law whose error dynamics are not known by themselves."""
    dynamics = c.controller.error_dynamics()
    if not isinstance(dynamics, ErrorDynamics):
        return None
    K_P = float(dynamics.K_P.min()) if dynamics.pose else dynamics.K_P
    P, believed = unknown_payload(c).mobility, c.controller.believed
    if believed is not None:  # rotors and screws move along the legs
        P = np.linalg.inv(np.linalg.inv(P) + believed.reflected_mass_kg * np.eye(6))
    return error_m(P, force_steps_N(c), K_P)
