"""What safety has to allow for a payload that is known by ranges: accelerations and mobility at home."""

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from drivers.arrays import Array
from hil.app.configuration.configuration import Configuration
from hil.app.configuration.payload_box import corners
from hil.app.configuration.platform import build_platform, pose_arrays
from hil.config.limits import MonitorSettings
from hil.mathematics.linear_algebra import solve
from hil.robot.dynamics import Model
from hil.robot.kinematics import jacobian


class UnknownPayload(NamedTuple):
    """The robot with the model's payload and at each corner of its ranges, at home."""

    mobility: Array
    """(n, 6, 6) 1/kg, J M^-1 J^T: how forces on the legs accelerate legs."""
    leg: float
    """m/s^2, largest acceleration of a leg under the forces that hold the model's payload."""
    position: float
    """m/s^2, of one coordinate of the platform's position."""
    rotation: float
    """rad/s^2, of one of its rotations."""
    holding_N: Array
    """(6,) N, largest force that a leg bears at home."""

    def allowed(self, monitor: MonitorSettings) -> MonitorSettings:
        """Return the stated disturbances of legs, with what the payload does to them added."""
        return monitor.model_copy(update={"disturbance_m_s2": monitor.disturbance_m_s2 + self.leg})

    def allowed_of_the_pose(self, monitor: MonitorSettings) -> MonitorSettings:
        """Return the stated disturbances of a pose, with what the payload does to it added."""
        update = {
            "disturbance_m_s2": monitor.disturbance_m_s2 + self.position,
            "disturbance_rad_s2": monitor.disturbance_rad_s2 + self.rotation,
        }
        return monitor.model_copy(update=update)


def unknown_payload(c: Configuration, along_legs_kg: ArrayLike = 0.0) -> UnknownPayload:
    """Mobility and accelerations by a payload within its ranges; those of the model where it has none.

    along_legs_kg: (6,) kg or one for all legs, what motor and screw add along each.
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
