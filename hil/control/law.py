"""The contract of a control law, and what the file of one declares.

A law turns estimate and reference of a tick into leg forces. It knows no mode, no limit, no bus and no
clock; the cycle adds the bumpless entry, safety limits the result. How a compiled pass calls it:
`hil.control.pointed_law`.
"""

from typing import Any, ClassVar, Literal, NamedTuple, Protocol

import numpy as np

from drivers.arrays import Array
from drivers.section import Section
from drivers.tick_columns import Record
from hil.config.axis_model import AxisSpace
from hil.config.delay import DelayCompensation
from hil.config.linear_controller import LinearController
from hil.config.model import ModelSettings
from hil.config.values import LegSpin, Positive, SixPositive
from hil.control.model import build_model
from hil.robot.dynamics import Model
from hil.robot.geometry import Platform


class LawContext(NamedTuple):
    """What a law is built for, beside its own settings."""

    platform: Platform
    leg_spin: LegSpin
    period_s: float
    """Between two efforts."""
    controller: LinearController | None = None
    """For the law that runs one from a file."""

    def model(self, settings: ModelSettings) -> Model:
        """Return the model that a law is configured with."""
        return build_model(settings, self.platform, self.leg_spin)


class Law(Protocol):
    """One control law.

    Contract, checked by the suite in ``tests/hil/control``: for finite input the effort is finite, or NaN
    where the law has no answer (singular J), which safety turns into a latched fault; it never raises.
    With zero error and nothing accumulated it is pure feed-forward. `reset` followed by the same inputs
    repeats to the bit. What it integrates does not grow while a limit holds back what it asks for.
    """

    def reset(self) -> None:
        """Forget everything accumulated."""

    def effort(self, tick: Record) -> None:
        """Fill tau_law (6,) N of a tick, > 0 extends, from its estimate, reference and shortfall.

        Where the law looks ahead, estimate and reference are those of the instant at which its force acts.
        """


class ErrorDynamics(NamedTuple):
    """The error dynamics e'' + K_D e' + K_P e = d that a law leaves, and where they end.

    Beyond the layer, |de + slope e| > layer, the law asks for steepness (|de + slope e| - layer) less. With a
    layer of 0 it switches: gains and steepness are infinite.
    """

    K_P: Array
    """(6,) 1/s^2."""
    K_D: Array
    """(6,) 1/s."""
    pose: bool = False
    """Of the pose, not of the legs."""
    slope: Array | float = 0.0
    steepness: float = 0.0
    """1/s; 0: the law has no layer."""
    layer: float = 1.0
    """m/s."""
    shared: bool = False
    """The layer is of all legs at once."""


class DesiredLoop(NamedTuple):
    """What default gains are made of: the loop that a configuration asks for, and its robot at home."""

    wn: float
    """rad/s."""
    zeta: float
    leg_mass: float
    """kg, the largest eigenvalue of J^-T M J^-1: what six legs feel that move together at worst."""
    mass: float
    """kg, the largest eigenvalue of M among translations."""
    inertia: float
    """kg m^2, the same among rotations."""
    force_limit: float
    """N, of a leg."""


class LawSettings(Section):
    """Section `controller` of one law, and what others need to know of the law.

    A law derives from it, adds its keys, and overrides what differs from a law without a model of which
    nothing is proven.
    """

    law: str
    """Control law."""
    axes: ClassVar[AxisSpace | Literal["designed"] | None] = None
    """Axes in which the law linearises the robot; `designed`: those of its controller file."""
    compensates_wrench: ClassVar[bool] = True
    """Of a law that linearises: whether its forces take the external wrench off."""
    uncertified: ClassVar[str] = "no error dynamics of it are known"
    """Why no V of constant gains belongs to its error."""
    tuning: ClassVar[tuple[str, str]] = ("wn_rad_s", "lower it")
    """Keys that set its gains, and what to do where the phase margin is too small."""

    def build(self, context: LawContext) -> Law:
        """Return the law. Raises ConfigurationError where it cannot serve the context."""
        raise NotImplementedError

    @property
    def believed(self) -> ModelSettings | None:
        """The law's model of the robot."""
        return None

    @property
    def lookahead(self) -> DelayCompensation | None:
        """The delay that is compensated by prediction; it takes a model."""
        return None

    def error_dynamics(self) -> ErrorDynamics | str:
        """Return the linear error dynamics that an exact model leaves, or why there are none."""
        return self.uncertified

    def described(self) -> list[str]:
        """Return lines for `hil check`: figures that follow from the settings."""
        return []

    def bandwidth(self, leg_mass: float, mass: float) -> tuple[float, float] | None:
        """Return the natural frequency, rad/s, and damping ratio that the gains ask for; None: not known.

        leg_mass, mass: as in `DesiredLoop`, kg.
        """
        del leg_mass, mass
        return None

    @classmethod
    def derived(cls, loop: DesiredLoop) -> dict[str, Any]:
        """Return the keys, other than `model`, that give this loop, for `hil compare`."""
        del loop
        return {}


class ModelBasedSettings(LawSettings):
    """A law with a model: what it believes of the robot, and whether it uses that to look ahead."""

    model: ModelSettings = ModelSettings()
    delay_compensation: DelayCompensation | None = None
    """State and reference of the instant at which the force acts; left out: of the measurement."""

    @property
    def believed(self) -> ModelSettings:
        """The law's model of the robot."""
        return self.model

    @property
    def lookahead(self) -> DelayCompensation | None:
        """The delay that is compensated by prediction."""
        return self.delay_compensation


class ErrorGains(LawSettings):
    """Error dynamics e'' + K_D e' + K_P e = 0 of a law that linearises the robot."""

    axes: ClassVar[AxisSpace] = "joint"
    wn_rad_s: Positive | SixPositive
    """Natural frequency, K_P = wn^2; one for all, or one per leg (in pose space one each for x, y, z and the
    rotation about them)."""
    damping_ratio: Positive = 1.0
    """K_D = 2 zeta wn."""

    def gains(self) -> tuple[Array, Array]:
        """Return K_P (6,) 1/s^2 and K_D (6,) 1/s."""
        w_n = per_leg(self.wn_rad_s)
        return w_n**2, 2.0 * self.damping_ratio * w_n

    def error_dynamics(self) -> ErrorDynamics | str:
        """Return the error dynamics that an exact model leaves."""
        return ErrorDynamics(*self.gains(), pose=self.axes == "pose")

    def bandwidth(self, leg_mass: float, mass: float) -> tuple[float, float]:
        """Return wn, rad/s, of the fastest error, and the damping ratio."""
        del leg_mass, mass
        return float(np.max(self.wn_rad_s)), self.damping_ratio

    @classmethod
    def derived(cls, loop: DesiredLoop) -> dict[str, Any]:
        """Return frequency and damping of the loop."""
        return {"wn_rad_s": loop.wn, "damping_ratio": loop.zeta}


def per_leg(gain: float | list[float]) -> Array:
    """Return a gain as (6,): one number is the same for all legs."""
    return np.broadcast_to(np.asarray(gain, float), (6,)).copy()


def per_axis(position: float | list[float], rotation: float | list[float]) -> Array:
    """Return gains of position and rotation as (6,): one number is the same for all three axes."""
    return np.concatenate([np.broadcast_to(np.asarray(gain, float), (3,)) for gain in (position, rotation)])
