"""The interface of a control law, and the base classes of its settings.

A law computes leg forces from estimate and reference of a tick. A law is independent of modes, limits, bus
and clock: the control cycle starts it without a jump of force, and safety rules limit the force. Compiled
code: `hil.control.pointed_law`.
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
    """What a control law is built from in addition to its own settings: robot and sampling period."""

    platform: Platform
    leg_spin: LegSpin
    period_s: float
    """Period of the control loop."""
    controller: LinearController | None = None
    """Linear controller read from a file, for the law that runs one."""

    def model(self, settings: ModelSettings) -> Model:
        """Model of this robot with the variant, friction and scaling in a law's `model` settings."""
        return build_model(settings, self.platform, self.leg_spin)


class Law(Protocol):
    """Control law: computes leg forces from the estimate and the reference of a tick.

    Contract, checked by the suite in ``tests/hil/control``: for finite input the effort is finite, or NaN
    where the law is undefined (singular J); the controller faults on NaN. The law never raises.
    With zero error and zero integrals it is pure feed-forward. `reset` followed by the same inputs
    repeats to the bit. Integrals do not wind up while a limit reduces the force.
    """

    def reset(self) -> None:
        """Set the state of the law, such as integrals, to its initial value."""

    def effort(self, tick: Record) -> None:
        """Fill tau_law (6,) N of a tick, > 0 extends, from the tick's estimate, reference and shortfall.

        The shortfall (6,) N is the force sent minus the force requested, in the last tick. With delay
        compensation, estimate and reference are predicted for the instant at which the force acts.
        """


class ErrorDynamics(NamedTuple):
    """Error dynamics e'' + K_D e' + K_P e = d under a law, valid inside its boundary layer.

    Outside the layer, |de + slope e| > layer, the law saturates: its acceleration is smaller by
    steepness (|de + slope e| - layer). With a layer of 0 the law switches; gains and steepness are infinite.
    """

    K_P: Array
    """(6,) 1/s^2, gain of the error."""
    K_D: Array
    """(6,) 1/s, gain of the error's rate."""
    pose: bool = False
    """True: e is the pose error; False: leg errors."""
    slope: Array | float = 0.0
    steepness: float = 0.0
    """1/s, slope of the correction inside the boundary layer; 0: the law has no boundary layer."""
    layer: float = 1.0
    """m/s, width of the boundary layer."""
    shared: bool = False
    """True: one boundary layer for the norm over all legs; False: one for each leg."""


class DesiredLoop(NamedTuple):
    """Input for computing default gains: the desired closed loop, and the robot's inertia at home."""

    wn: float
    """rad/s, natural frequency."""
    zeta: float
    leg_mass: float
    """kg, the largest eigenvalue of J^-T M J^-1: effective mass of the worst motion of all legs."""
    mass: float
    """kg, the largest eigenvalue of M among translations."""
    inertia: float
    """kg m^2, the largest eigenvalue of M among rotations."""
    force_limit: float
    """N, largest force of one leg."""


class LawSettings(Section):
    """Section `controller` of one law, and properties of the law for other modules.

    A law's settings derive from this class, add keys, and override the defaults. The defaults describe a law
    without a model and without a known Lyapunov function.
    """

    law: str
    """Name of the control law."""
    axes: ClassVar[AxisSpace | Literal["designed"] | None] = None
    """Axes in which the law linearises the robot; `designed`: the axes of its controller file."""
    compensates_wrench: ClassVar[bool] = True
    """For a law that linearises: True if its forces compensate the external wrench."""
    uncertified: ClassVar[str] = "its error dynamics are unknown"
    """Reason why no Lyapunov function with constant gains is known for the law."""
    tuning: ClassVar[tuple[str, str]] = ("wn_rad_s", "lower it")
    """Keys that set the gains, and the advice for a phase margin that is too small."""
    knob: ClassVar[dict[str, int]] = {}
    """Keys of the gains, with the power of a factor on the bandwidth that scales each; empty: fixed gains."""

    def build(self, context: LawContext) -> Law:
        """Build the control law. Raises ConfigurationError if it cannot run on this robot or at this rate."""
        raise NotImplementedError

    @property
    def believed(self) -> ModelSettings | None:
        """Settings of the robot model that the law computes with; None for a law without a model."""
        return None

    @property
    def lookahead(self) -> DelayCompensation | None:
        """Settings of the delay compensation by prediction, which needs a model; None without it."""
        return None

    def error_dynamics(self) -> ErrorDynamics | str:
        """Error dynamics under an exact model, or the reason why no linear error dynamics are known."""
        return self.uncertified

    def described(self) -> list[str]:
        """Lines that `hil check` prints: figures derived from the settings, such as a bound or a layer."""
        return []

    def bandwidth(self, leg_mass: float, mass: float) -> tuple[float, float] | None:
        """Natural frequency, rad/s, and damping ratio that result from the gains; None: unknown.

        leg_mass, mass: as in `DesiredLoop`, kg.
        """
        del leg_mass, mass
        return None

    @classmethod
    def derived(cls, loop: DesiredLoop) -> dict[str, Any]:
        """Configuration keys, except `model`, with which `hil compare` gives this law the desired loop."""
        del loop
        return {}


class ModelBasedSettings(LawSettings):
    """Settings of a law with a model of the robot, optionally with delay compensation."""

    model: ModelSettings = ModelSettings()
    delay_compensation: DelayCompensation | None = None
    """Predict state and reference to the instant at which the force acts; omitted: no prediction."""

    @property
    def believed(self) -> ModelSettings:
        """Settings of the robot model that the law computes with."""
        return self.model

    @property
    def lookahead(self) -> DelayCompensation | None:
        """Settings of the delay compensation by prediction; None without it."""
        return self.delay_compensation


class ErrorGains(LawSettings):
    """Settings of a law that linearises the robot: its error dynamics e'' + K_D e' + K_P e = 0."""

    axes: ClassVar[AxisSpace] = "joint"
    knob = {"wn_rad_s": 1}
    wn_rad_s: Positive | SixPositive
    """Natural frequency, K_P = wn^2: one for all axes, or one each (legs, or x, y, z and rotations about
    them)."""
    damping_ratio: Positive = 1.0
    """Damping ratio zeta, K_D = 2 zeta wn."""

    def gains(self) -> tuple[Array, Array]:
        """Gains K_P (6,) 1/s^2 and K_D (6,) 1/s of the error dynamics."""
        w_n = per_leg(self.wn_rad_s)
        return w_n**2, 2.0 * self.damping_ratio * w_n

    def error_dynamics(self) -> ErrorDynamics | str:
        """Error dynamics e'' + K_D e' + K_P e = d under an exact model, of leg errors or pose errors."""
        return ErrorDynamics(*self.gains(), pose=self.axes == "pose")

    def bandwidth(self, leg_mass: float, mass: float) -> tuple[float, float]:
        """Largest natural frequency wn, rad/s, of the error dynamics, and their damping ratio."""
        del leg_mass, mass
        return float(np.max(self.wn_rad_s)), self.damping_ratio

    @classmethod
    def derived(cls, loop: DesiredLoop) -> dict[str, Any]:
        """Keys of these settings that give the natural frequency and damping ratio of the desired loop."""
        return {"wn_rad_s": loop.wn, "damping_ratio": loop.zeta}


def per_leg(gain: float | list[float]) -> Array:
    """Gains of the legs (6,) in the unit given; a single number applies to all legs."""
    return np.broadcast_to(np.asarray(gain, float), (6,)).copy()


def per_axis(position: float | list[float], rotation: float | list[float]) -> Array:
    """Gains (6,) of position, then rotation, in the units given; one number applies to all three axes."""
    return np.concatenate([np.broadcast_to(np.asarray(gain, float), (3,)) for gain in (position, rotation)])
