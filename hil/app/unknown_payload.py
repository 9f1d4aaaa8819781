"""Accelerations of the legs at home by forces and an uncertain payload, and the tolerance for safety.

A step dF of the forces in frames leaves e'' + K_D e' + K_P e = d with |d| <= |P| dF. P (6, 6) 1/kg is the
acceleration of the legs per force. At rest |e| <= |P| dF / K_P, leg by leg.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from drivers import build_protocol
from drivers.arrays import Array
from hil.app.configuration.configuration import Configuration
from hil.app.configuration.payload_box import corners
from hil.app.configuration.platform import build_platform, pose_arrays
from hil.config.limits import MonitorSettings
from hil.control.law import ErrorDynamics
from hil.mathematics.linear_algebra import solve
from hil.robot.dynamics import Model
from hil.robot.kinematics import jacobian


class UnknownPayload(NamedTuple):
    """Robot at home with the payload of the model, and at each corner of the payload's ranges."""

    mobility: Array
    """(n, 6, 6) 1/kg, J M^-1 J^T: acceleration of the legs per force on the legs."""
    leg: float
    """m/s^2, largest acceleration of a leg by an uncertain payload under the model's holding forces."""
    position: float
    """m/s^2, largest acceleration by it of a coordinate of the platform's position."""
    rotation: float
    """rad/s^2, largest angular acceleration of the platform by it."""
    holding_N: Array
    """(6,) N, largest holding force of each leg at home."""

    def allowed(self, monitor: MonitorSettings) -> MonitorSettings:
        """Monitor settings with the effect of the payload added to the disturbance of the legs."""
        return monitor.model_copy(update={"disturbance_m_s2": monitor.disturbance_m_s2 + self.leg})

    def allowed_of_the_pose(self, monitor: MonitorSettings) -> MonitorSettings:
        """Monitor settings with the effect of the payload added to the disturbances of the pose."""
        update = {
            "disturbance_m_s2": monitor.disturbance_m_s2 + self.position,
            "disturbance_rad_s2": monitor.disturbance_rad_s2 + self.rotation,
        }
        return monitor.model_copy(update=update)


def unknown_payload(c: Configuration, along_legs_kg: ArrayLike = 0.0) -> UnknownPayload:
    """Mobility and accelerations by a payload within its ranges; those of the model without ranges.

    along_legs_kg: (6,) kg or one for all legs, reflected mass of motor and screw along each.
    """
    home = pose_arrays(c.platform.home)
    platforms = [build_platform(corner.settings) for corner in corners(c.platform)]
    spin = c.platform.leg_spin
    models = [Model(platform, leg_spin=spin, reflected_mass=along_legs_kg) for platform in platforms]
    J, G = jacobian(models[0].platform, *home), models[0].gravity(*home)
    mobility, twists, held = [], [np.zeros(6)], []
    for model in models:
        held.append(np.abs(solve(np.ascontiguousarray(J.T), model.gravity(*home))))
        M = model.mass_matrix(*home)
        moved = [solve(M, leg) for leg in J]
        mobility.append([[float((row * twist).sum()) for twist in moved] for row in J])
        if model is not models[0]:
            twists.append(solve(M, G - model.gravity(*home)))
    accelerations = np.abs(twists)
    legs = max(float(abs((leg * twist).sum())) for leg in J for twist in twists)
    return UnknownPayload(
        np.array(mobility),
        legs,
        float(accelerations[:, :3].max()),
        float(accelerations[:, 3:].max()),
        np.max(held, axis=0),
    )


def force_steps_N(c: Configuration) -> Array:
    """Resolution of the force command at each leg, (6,) N; 0: floating point."""
    return build_protocol(c.bus, c.drives).traits.resolution.force


def error_m(P: Array, steps_N: Array, K_P: Array | float) -> float:
    """Largest error of a leg at rest, m, from P (..., 6, 6) 1/kg, steps (6,) N and K_P 1/s^2."""
    return float((np.abs(P) @ steps_N / K_P).max())


def stepped_error_m(c: Configuration) -> float | None:
    """Largest error at rest at home by the force resolution, m; None where error dynamics are unknown."""
    dynamics = c.controller.error_dynamics()
    if not isinstance(dynamics, ErrorDynamics):
        return None
    K_P = float(dynamics.K_P.min()) if dynamics.pose else dynamics.K_P
    P, believed = unknown_payload(c).mobility, c.controller.believed
    if believed is not None:  # with rotors and screws
        P = np.linalg.inv(np.linalg.inv(P) + believed.reflected_mass_kg * np.eye(6))
    return error_m(P, force_steps_N(c), K_P)
