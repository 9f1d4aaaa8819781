"""Configuration sections of the controller: platform, loop, controller, reference, limits, recording."""

from __future__ import annotations

import math
from typing import Annotated, Literal, Self

from pydantic import AfterValidator, Field, model_validator

from drivers.config import Section

Vector3 = tuple[float, float, float]
Matrix3 = tuple[Vector3, Vector3, Vector3]
Six = Annotated[list[float], Field(min_length=6, max_length=6)]
SixVectors = Annotated[list[Vector3], Field(min_length=6, max_length=6)]
Positive = Annotated[float, Field(gt=0)]
NonNegative = Annotated[float, Field(ge=0)]
JointAngle = Annotated[float, Field(gt=0, le=180)]
LegSpin = Literal["none", "universal"]
SixPositive = Annotated[list[Positive], Field(min_length=6, max_length=6)]
SixNonNegative = Annotated[list[NonNegative], Field(min_length=6, max_length=6)]


class Pose(Section):
    """Platform pose: origin in the base frame and rotation vector."""

    position_m: Vector3
    rotation_vector_deg: Vector3 = (0.0, 0.0, 0.0)


class JointCircle(Section):
    """Six joints on a circle about z: by six angles, or in three pairs."""

    radius_m: Positive
    z_m: float = 0.0
    angles_deg: Six | None = None
    """One angle a leg, from x towards y."""
    pair_centres_deg: Vector3 | None = None
    """Instead of angles: direction of each pair of joints."""
    pair_half_angle_deg: Annotated[float, Field(ge=0, lt=60)] | None = None
    """The joints of a pair stand at its centre minus and plus this."""
    pair_spacing_m: NonNegative | None = None
    """Instead of the half angle: distance between the two joints of a pair."""
    pairs_begin: Literal["first_leg", "second_leg"] = "first_leg"
    """Pairs are legs 1-2, 3-4, 5-6 of the list, or 2-3, 4-5, 6-1."""

    @model_validator(mode="after")
    def _angles_or_pairs(self) -> Self:
        halves = (self.pair_half_angle_deg, self.pair_spacing_m)
        if (self.angles_deg is None) == (self.pair_centres_deg is None):
            raise ValueError("allowed: either angles_deg or pair_centres_deg")
        if self.angles_deg is not None and (halves != (None, None) or self.pairs_begin != "first_leg"):
            raise ValueError("angles_deg needs no pairs, allowed: radius_m, z_m and angles_deg alone")
        if self.pair_centres_deg is not None and halves.count(None) != 1:
            raise ValueError("allowed with pair_centres_deg: either pair_half_angle_deg or pair_spacing_m")
        if self.pair_spacing_m is not None and not self.pair_spacing_m < 2 * self.radius_m:
            raise ValueError(
                f"pair_spacing_m does not fit on the circle, allowed: less than {2 * self.radius_m:g} "
                f"(2 radius_m), given: {self.pair_spacing_m:g}"
            )
        return self


def _at_most_half_a_turn(vector: Vector3) -> Vector3:
    angle = math.hypot(*vector)
    if angle > 180 * (1 + 1e-12):
        raise ValueError(f"more than half a turn, allowed: a length of at most 180 deg, given: {angle:g} deg")
    return vector


RotationVector = Annotated[Vector3, AfterValidator(_at_most_half_a_turn)]


class Frame(Section):
    """A coordinate system in the platform frame: x_platform = origin + R x."""

    origin_m: Vector3 = (0.0, 0.0, 0.0)
    rotation_vector_deg: RotationVector = (0.0, 0.0, 0.0)


class InertiaReference(Section):
    """What a tensor refers to, where that is not the centre of mass and the axes of the body's frame."""

    point_m: Vector3 | None = None
    """The tensor is about this point of the body's frame; default: the centre of mass."""
    rotation_vector_deg: RotationVector = (0.0, 0.0, 0.0)
    """Turns the axes of the body's frame into those of the tensor (principal axes, say)."""


class BoxShape(Section):
    """Homogeneous box, its sides along the axes of the body's frame, centred on com_m."""

    type: Literal["box"]
    size_m: tuple[Positive, Positive, Positive]


class CylinderShape(Section):
    """Homogeneous cylinder or tube along z of the body's frame, centred on com_m."""

    type: Literal["cylinder"]
    radius_m: Positive
    length_m: Positive
    inner_radius_m: NonNegative = 0.0

    @model_validator(mode="after")
    def _wall(self) -> Self:
        if self.inner_radius_m >= self.radius_m:
            raise ValueError(
                f"inner_radius_m leaves no wall, allowed: less than {self.radius_m:g} (radius_m), "
                f"given: {self.inner_radius_m:g}"
            )
        return self


class SphereShape(Section):
    """Homogeneous sphere centred on com_m."""

    type: Literal["sphere"]
    radius_m: Positive


class PointShape(Section):
    """A point mass at com_m."""

    type: Literal["point"]


Shape = Annotated[BoxShape | CylinderShape | SphereShape | PointShape, Field(discriminator="type")]


class RigidBodySettings(Section):
    """A rigid body fixed to the platform."""

    mass_kg: Positive
    com_m: Vector3
    """Centre of mass in the body's frame."""
    inertia_kg_m2: Matrix3 | None = None
    """About the centre of mass in the axes of the body's frame, unless inertia_about says otherwise."""
    shape: Shape | None = None
    """Instead of the tensor."""
    frame: Frame = Frame()
    """The coordinate system of the figures above, in the platform frame; default: the platform frame."""
    inertia_about: InertiaReference = InertiaReference()
    products: Literal["negative_integral", "positive_integral"] = "negative_integral"
    """What stands off the diagonal of inertia_kg_m2: minus or plus the integral of x y dm."""

    @model_validator(mode="after")
    def _tensor_or_shape(self) -> Self:
        if (self.inertia_kg_m2 is None) == (self.shape is None):
            raise ValueError("allowed: either inertia_kg_m2 or shape")
        lost = sorted(self.model_fields_set & {"inertia_about", "products"})
        if self.shape is not None and lost:
            raise ValueError(f"{', '.join(lost)} has no meaning with shape, allowed: with inertia_kg_m2")
        return self


class BodySettings(RigidBodySettings):
    """The moving platform, and what is mounted on it."""

    payload: list[RigidBodySettings] = []
    """Further bodies; all are put together into one."""


class LegBodySettings(Section):
    """One half of every leg."""

    mass_kg: NonNegative
    com_m: NonNegative
    """Cylinder: from the base joint. Rod: from the platform joint. Along the leg."""
    inertia_axial_kg_m2: NonNegative | None = None
    """About the leg's own axis; has no effect unless the legs spin."""
    inertia_transverse_kg_m2: NonNegative


class PlatformSettings(Section):
    """Geometry and inertia of the robot."""

    base_joints_m: SixVectors | JointCircle
    """a_i in the base frame."""
    platform_joints_m: SixVectors | JointCircle
    """b_i in the platform frame."""
    platform: BodySettings
    cylinder: LegBodySettings
    rod: LegBodySettings
    gravity_m_s2: Vector3 = (0.0, 0.0, -9.81)
    leg_spin: LegSpin = "none"
    universal_joint_base_axes: SixVectors | None = None
    home: Pose
    """Where forward kinematics is seeded and the virtual plant starts."""
    length_min_m: Positive
    """Hard end of the stroke, joint centre to joint centre."""
    length_max_m: Positive
    base_joint_angle_max_deg: JointAngle | None = None
    """Largest angle of a leg to the axis of its base joint; left out: not looked at. `hil workspace`."""
    platform_joint_angle_max_deg: JointAngle | None = None
    """The same for the platform joint."""
    base_joint_axes: SixVectors | None = None
    """Axes of the base joints' cones: directions from base to platform, base frame. Default: each leg's own
    direction at home."""
    platform_joint_axes: SixVectors | None = None
    """Axes of the platform joints' cones: directions from base to platform, platform frame. Same default."""

    @model_validator(mode="after")
    def _joint_axes_are_directions(self) -> Self:
        for key in ("base_joint_axes", "platform_joint_axes"):
            axes: list[Vector3] | None = getattr(self, key)
            if axes is not None and not all(any(x != 0 for x in axis) for axis in axes):
                raise ValueError(f"{key} has a direction of length zero")
        return self

    @model_validator(mode="after")
    def _spinning_legs_are_known(self) -> Self:
        if self.leg_spin == "universal":
            halves = {"cylinder": self.cylinder, "rod": self.rod}
            lacking = [f"{n}.inertia_axial_kg_m2" for n, h in halves.items() if h.inertia_axial_kg_m2 is None]
            if self.universal_joint_base_axes is None:
                lacking.append("universal_joint_base_axes")
            if lacking:
                raise ValueError(f"leg_spin universal needs {', '.join(lacking)}")
        return self


class LoopSettings(Section):
    """The fixed-rate loop."""

    rate_Hz: Positive = 1000.0
    feedback_window_us: Positive | None = None
    """Longest wait for the six feedbacks after SYNC; default 65 % of the period."""
    cpu: int | None = None
    """CPU to pin the loop to (only together with SCHED_FIFO)."""
    priority: Annotated[int, Field(ge=1, le=99)] = 80
    """SCHED_FIFO priority."""
    spin_us: NonNegative = 100.0
    """Busy-wait this long before each deadline."""
    without_realtime: Literal["slow", "refuse"] = "slow"
    """Without SCHED_FIFO: drop to a rate that can be held, or refuse to run."""

    def window_s(self, rate_Hz: float) -> float:
        """Return the longest wait for the six feedbacks at a rate, s."""
        return 0.65 / rate_Hz if self.feedback_window_us is None else self.feedback_window_us * 1e-6


class ModelSettings(Section):
    """The controller's model of the robot."""

    variant: Literal["full", "no_H", "printed", "constant", "constant_MG", "massless_legs"] = "full"
    inertia_scale: Positive = 1.0
    """All masses, all inertias and the platform's centre of mass times this. The centres of mass along the
    legs stay exact, as do lengths, J, its rate, gravity and friction."""
    reflected_mass_kg: NonNegative | SixNonNegative = 0.0
    """Motor and screw inertia seen along each leg: rotary inertia times (2 pi / lead)^2. One for all legs,
    or one per leg; so are the frictions."""
    viscous_friction_N_s_m: NonNegative | SixNonNegative = 0.0
    coulomb_friction_N: NonNegative | SixNonNegative = 0.0
    sliding_speed_m_s: NonNegative = 1e-3
    """Leg rate from which Coulomb friction counts in full; below, it grows linearly. 0: sgn of the rate."""
    frozen_at: Pose | None = None
    """Pose of the constant variants."""

    @model_validator(mode="after")
    def _frozen_somewhere(self) -> Self:
        constant = self.variant in {"constant", "constant_MG"}
        if constant and self.frozen_at is None:
            raise ValueError(
                f"frozen_at is missing: variant {self.variant} needs the pose at which it is frozen"
            )
        if self.frozen_at is not None and not constant:
            raise ValueError(
                f"frozen_at has no meaning for variant {self.variant}, allowed: constant, constant_MG"
            )
        return self


class PDSettings(Section):
    """Decentralised PD on leg lengths: tau = Kp (q_d - q) + Kv (dq_d - dq)."""

    law: Literal["pd"]
    kp_N_m: Positive | SixPositive
    """One for all legs, or one per leg."""
    kv_N_s_m: Positive | SixPositive


class InverseDynamicsSettings(Section):
    """Exact inverse dynamics in joint space."""

    law: Literal["inverse_dynamics"]
    wn_rad_s: Positive | SixPositive
    """Natural frequency of the error dynamics, K_P = wn^2; one for all legs, or one per leg."""
    damping_ratio: Positive = 1.0
    """K_D = 2 zeta wn."""
    model: ModelSettings = ModelSettings()


ControllerSettings = Annotated[PDSettings | InverseDynamicsSettings, Field(discriminator="law")]


class EngageSettings(Section):
    """From rest to the first reference sample, without a bump."""

    force_ramp_s: NonNegative = 0.3
    """The static holding force builds up against the closed brakes; 0 starts with the law at once."""
    brake_release_s: NonNegative = 0.1
    """Time given to the brakes to open."""
    approach_speed_m_s: Positive = 0.2
    """Mean leg speed of the quintic move from the measured pose to the reference's start."""
    stop_s: Positive = 0.5
    """Time in which a controlled stop comes to rest along the path."""
    blend_s: NonNegative = 0.5
    """Time over which the holding-force offset fades into the law."""


class HoldReference(Section):
    """Stay at a pose."""

    type: Literal["hold"]
    pose: Pose | None = None
    """Default: home."""
    duration_s: Positive | None = None
    """Default: until stopped."""


class Waypoint(Section):
    """One way-point: pose at a time after the start."""

    t_s: NonNegative
    position_m: Vector3
    rotation_vector_deg: Vector3 = (0.0, 0.0, 0.0)


class WaypointReference(Section):
    """Rest-to-rest segments through way-points; position and rotation vector interpolated."""

    type: Literal["waypoints"]
    interpolation: Literal["cubic", "quintic"] = "quintic"
    points: Annotated[list[Waypoint], Field(min_length=2)]
    periods: Annotated[int, Field(ge=1)] | None = 1
    """How many times the list is run through; null is for ever."""


class Sinusoid(Section):
    """amplitude * sin(2 pi frequency t + phase) on one axis."""

    axis: Literal["x_m", "y_m", "z_m", "rx_deg", "ry_deg", "rz_deg"]
    amplitude: float
    """In the axis' unit."""
    frequency_Hz: Positive
    phase_rad: float = 0.0


class SinusoidReference(Section):
    """Sum of sinusoids about a centre pose, faded in and out by quintics."""

    type: Literal["sinusoids"]
    centre: Pose | None = None
    """Default: home."""
    components: Annotated[list[Sinusoid], Field(min_length=1)]
    ramp_s: NonNegative = 1.0
    duration_s: Positive


class SampledReference(Section):
    """A CSV file: t_s, x_m, y_m, z_m, rx_deg, ry_deg, rz_deg (rotation vector), cubic spline through it."""

    type: Literal["sampled"]
    path: str
    """Relative to the configuration file."""
    periods: Annotated[int, Field(ge=1)] = 1


ReferenceSettings = Annotated[
    HoldReference | WaypointReference | SinusoidReference | SampledReference,
    Field(discriminator="type"),
]


class LimitSettings(Section):
    """Safety limits of the controller."""

    force_N: Positive
    """Per leg."""
    force_step_N: Positive
    """Largest change of a leg's force from one tick to the next."""
    force_window_N: Positive
    """Largest change of a leg's force within 250 ms."""
    speed_m_s: Positive
    """Leg speed; faults above."""
    deceleration_m_s2: Positive
    """The square-root speed cap before the soft ends: |dq| <= sqrt(2 a distance)."""
    stroke_margin_m: NonNegative = 0.0
    """Soft ends lie this far inside length_min_m and length_max_m."""
    following_error_m: Positive
    """Leg error that faults at rest."""
    following_error_s: NonNegative = 0.0
    """Added per m/s of reference leg rate."""
    consistency_m: Positive = 1e-4
    """Residual of forward kinematics that faults."""
    condition: Positive = 50.0
    """Condition number of J (lengths made comparable) that faults."""
    stale_warn_ticks: Annotated[int, Field(ge=1)] = 2
    stale_fault_ticks: Annotated[int, Field(ge=1)] = 5

    @model_validator(mode="after")
    def _warn_before_fault(self) -> Self:
        if self.stale_warn_ticks > self.stale_fault_ticks:
            raise ValueError(
                f"stale_warn_ticks is above stale_fault_ticks, allowed: at most {self.stale_fault_ticks}, "
                f"given: {self.stale_warn_ticks}"
            )
        return self


class RecordingSettings(Section):
    """The log."""

    folder: str = "runs"
    on_recorder_loss: Literal["continue", "stop"] = "continue"
    """What the daemon does when the recorder dies."""
    ring_ticks: Annotated[int, Field(ge=256)] = 8192
    """Length of the shared-memory ring."""
