"""From a configuration to what the theorems speak of: robot, belief, reference, loop."""

from dataclasses import dataclass

import numpy as np

from drivers.arrays import Array
from drivers.errors import ConfigurationError, HilError
from hil.app.configuration.configuration import Configuration
from hil.app.configuration.platform import build_platform
from hil.app.loop_delay import loop_delay
from hil.app.reachability import span_s
from hil.config.axis_model import AxisSpace
from hil.config.model import ModelSettings
from hil.control.law import per_leg
from hil.control.model import build_model
from hil.mathematics.linear_algebra import condition_kernel
from hil.robot.dynamics import Model
from hil.robot.kinematics_kernels import jacobian_kernel, leg_lengths_kernel
from hil.stability.disturbance import Friction, Linearised, Load
from hil.stability.sampled import Axis
from hil.trajectory.build import build_trajectory
from hil.trajectory.path import PoseSample
from plant_fmu.config import StewartPlant

SAMPLES = 101
"""Instants of the reference at which the robot is looked at."""


NO_LOAD = Load()


@dataclass(frozen=True)
class Stated:
    """What the user says the law does not know."""

    load: Load = NO_LOAD
    model_error: float = 0.0
    """alpha: believed masses are off by this share, either way."""

    @property
    def nothing(self) -> bool:
        """Tell whether nothing is stated."""
        return self.load.force_N == self.load.torque_N_m == self.model_error == 0.0


class Subject:
    """A configuration as the theorems see it."""

    def __init__(self, c: Configuration, stated: Stated) -> None:
        self.c = c
        self.stated = stated
        self.platform = build_platform(c.platform)
        plant = c.plant.model if c.plant is not None else None
        self.plant = plant if isinstance(plant, StewartPlant) else None
        reflected = 0.0 if self.plant is None else self.plant.reflected_mass_kg
        self.robot = Model(self.platform, leg_spin=c.platform.leg_spin, reflected_mass=reflected)
        self.path = self._path()
        self.axis = Axis(*loop_delay(c))

    @property
    def rest(self) -> bool:
        """Tell whether the reference never moves."""
        return len(self.path) == 1

    @property
    def delay(self) -> str:
        """The delay of the loop, in milliseconds, and whether the lag of the drives is in it."""
        lag = "" if self.axis.lag_s > 0.0 else ", no lag of the drives known"
        return f"{1e3 * self.axis.transport_s:g} ms from measurement to force{lag}"

    def believed(self, settings: ModelSettings, scale: float = 1.0) -> Model:
        """Return the law's model without its friction, masses times `scale` once more."""
        bare = {
            "inertia_scale": settings.inertia_scale * scale,
            "viscous_friction_N_s_m": 0.0,
            "coulomb_friction_N": 0.0,
        }
        return build_model(settings.model_copy(update=bare), self.platform, self.c.platform.leg_spin)

    def friction(self, settings: ModelSettings) -> Friction:
        """Return what the law's friction is wrong by; where the plant is none of ours, nothing is known."""
        if self.plant is None:
            return Friction(np.zeros(6), np.zeros(6))
        viscous = np.abs(self.plant.viscous_friction_N_s_m - per_leg(settings.viscous_friction_N_s_m))
        coulomb = np.abs(self.plant.coulomb_friction_N - per_leg(settings.coulomb_friction_N))
        return Friction(viscous, coulomb)

    def linearised(self, settings: ModelSettings, axes: AxisSpace) -> list[Linearised]:
        """Return the robot under a law with this model, at each end of the stated model error."""
        alpha, load, friction = self.stated.model_error, self.stated.load, self.friction(settings)
        believed = [self.believed(settings, scale) for scale in sorted({1.0 - alpha, 1.0 + alpha})]
        return [Linearised(self.robot, model, axes, load, friction) for model in believed]

    def outside(self, p: Array, R: Array) -> str | None:
        """Say which limit a pose breaks: the soft ends of a leg, or the condition of J."""
        s, limits = self.c.platform, self.c.limits
        a, b = self.platform.base_joints, self.platform.platform_joints
        q = leg_lengths_kernel(a, b, p, R)
        if q.min() < s.length_min_m + limits.stroke_margin_m:
            return f"leg {int(np.argmin(q))} at its lower soft end"
        if q.max() > s.length_max_m - limits.stroke_margin_m:
            return f"leg {int(np.argmax(q))} at its upper soft end"
        number = condition_kernel(jacobian_kernel(a, b, p, R), self.platform.radius)
        return None if number <= limits.condition else f"condition of J {limits.condition:g}"

    def _path(self) -> list[PoseSample]:
        """Return the reference at instants of even distance, one where it rests."""
        c = self.c
        try:
            trajectory = build_trajectory(c.reference, c.platform.home, c.folder)
            span = span_s(trajectory)
            # Just inside the end, where the path still moves: outside it rests.
            times = np.linspace(0.0, span * (1 - 1e-12), SAMPLES if span > 0.0 else 1)
            path = [PoseSample(*(np.array(part) for part in trajectory.sample(float(t)))) for t in times]
        except ConfigurationError:
            raise
        except HilError as error:
            raise ConfigurationError(f"{c.source}: reference: {error}") from error
        moves = any(np.abs(s.twist).max() > 0.0 or np.abs(s.dtwist).max() > 0.0 for s in path)
        return path if moves else path[:1]
