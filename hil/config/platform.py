"""Section `platform`: geometry and inertia of the robot."""

from typing import Annotated, Literal, Self

from pydantic import AfterValidator, Field, model_validator

from drivers.section import Section
from hil.config.values import (
    JointAngle,
    LegSpin,
    Matrix3,
    NonNegative,
    Orientation,
    Pose,
    Positive,
    Six,
    SixVectors,
    Vector3,
)


class JointCircle(Section):
    """Six joints on a circle about z: by six angles, or in three pairs."""

    radius_m: Positive
    z_m: float = 0.0
    angles_deg: Six | None = None
    """One angle per leg, from x towards y."""
    pair_centres_deg: Vector3 | None = None
    """Instead of angles: direction of each pair of joints."""
    pair_half_angle_deg: Annotated[float, Field(ge=0, lt=60)] | None = None
    """Angle of the joints of a pair, minus and plus, from its centre."""
    pair_spacing_m: NonNegative | None = None
    """Instead of the half angle: distance between the two joints of a pair."""
    pairs_begin: Literal["first_leg", "second_leg"] = "first_leg"
    """Pairs are legs 0-1, 2-3, 4-5 of the list, or 1-2, 3-4, 5-0."""

    @model_validator(mode="after")
    def _angles_or_pairs(self) -> Self:
        halves = (self.pair_half_angle_deg, self.pair_spacing_m)
        if (self.angles_deg is None) == (self.pair_centres_deg is None):
            raise ValueError("allowed: either angles_deg or pair_centres_deg")
        if self.angles_deg is not None and (halves != (None, None) or self.pairs_begin != "first_leg"):
            raise ValueError("angles_deg excludes keys of pairs, allowed: radius_m, z_m and angles_deg alone")
        if self.pair_centres_deg is not None and halves.count(None) != 1:
            raise ValueError("pair_centres_deg needs exactly one of pair_half_angle_deg and pair_spacing_m")
        if self.pair_spacing_m is not None and not self.pair_spacing_m < 2 * self.radius_m:
            allowed = f"less than 2 radius_m, {2 * self.radius_m:g}, given: {self.pair_spacing_m:g}"
            raise ValueError(f"pair_spacing_m does not fit on the circle, allowed: {allowed}")
        return self


class Frame(Orientation):
    """Coordinate system in the platform frame: x_platform = origin + R x."""

    origin_m: Vector3 = (0.0, 0.0, 0.0)


class InertiaReference(Orientation):
    """Point and axes of an inertia tensor, if not the centre of mass and the axes of the body's frame.

    The rotation leads from the axes of the body's frame to those of the tensor, for example principal axes.
    """

    point_m: Vector3 | None = None
    """Point of the body's frame to which the tensor refers; default: the centre of mass."""


class BoxShape(Section):
    """Homogeneous box, sides along the axes of the body's frame, centred on com_m."""

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
            allowed = f"less than radius_m, {self.radius_m:g}, given: {self.inner_radius_m:g}"
            raise ValueError(f"inner_radius_m leaves no wall thickness, allowed: {allowed}")
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
    """About the centre of mass in the axes of the body's frame, unless inertia_about is set."""
    shape: Shape | None = None
    """Instead of inertia_kg_m2."""
    frame: Frame = Frame()
    """Coordinate system of the values above, in the platform frame; default: the platform frame."""
    inertia_about: InertiaReference = InertiaReference()
    products: Literal["negative_integral", "positive_integral"] = "negative_integral"
    """Off-diagonal elements of inertia_kg_m2: minus or plus the integral of x y dm."""

    @model_validator(mode="after")
    def _tensor_or_shape(self) -> Self:
        if (self.inertia_kg_m2 is None) == (self.shape is None):
            raise ValueError("allowed: either inertia_kg_m2 or shape")
        lost = sorted(self.model_fields_set & {"inertia_about", "products"})
        if self.shape is not None and lost:
            raise ValueError(f"{', '.join(lost)} has no meaning with shape, allowed: with inertia_kg_m2")
        return self


def _rising(pair: tuple[float, float]) -> tuple[float, float]:
    if not pair[0] <= pair[1]:
        raise ValueError(f"allowed: the lower end first, then the upper end, given: {pair[0]:g}, {pair[1]:g}")
    return pair


MassRange = Annotated[tuple[NonNegative, NonNegative], AfterValidator(_rising)]
PlaceRange = Annotated[tuple[float, float], AfterValidator(_rising)]


class PayloadSettings(RigidBodySettings):
    """A body carried by the platform. The model uses its values; ranges state how far they may vary."""

    mass_kg: NonNegative
    """0: the model does not include the body; then `shape` and `mass_range_kg` are required."""
    mass_range_kg: MassRange | None = None
    """Range of the mass. The tensor, or shape, scales with it."""
    com_range_m: tuple[PlaceRange, PlaceRange, PlaceRange] | None = None
    """Range of the centre of mass: from, to, along each axis of the body's frame."""

    @property
    def ranged(self) -> bool:
        """True if the mass or the centre of mass has a range."""
        return self.mass_range_kg is not None or self.com_range_m is not None

    @model_validator(mode="after")
    def _the_model_is_within(self) -> Self:
        if self.mass_kg == 0.0 and (self.shape is None or self.mass_range_kg is None):
            raise ValueError("mass_kg 0 needs shape and mass_range_kg, allowed: more than 0 without them")
        ranges = (self.mass_range_kg, *(self.com_range_m or (None,) * 3))
        keys = ("mass_kg", "com_m", "com_m", "com_m")
        for key, figure, within in zip(keys, (self.mass_kg, *self.com_m), ranges, strict=True):
            if within is not None and not within[0] <= figure <= within[1]:
                allowed = f"allowed: {within[0]:g} to {within[1]:g}, given: {figure:g}"
                raise ValueError(f"{key} lies outside its range, {allowed}")
        return self


class BodySettings(RigidBodySettings):
    """The moving platform, and the bodies mounted on it."""

    payload: list[PayloadSettings] = []
    """Further bodies; all are combined into one."""

    @model_validator(mode="after")
    def _one_range(self) -> Self:
        ranged = [k for k, body in enumerate(self.payload) if body.ranged]
        if len(ranged) > 1:
            raise ValueError(f"payload: bodies {', '.join(map(str, ranged))} have ranges, allowed: one body")
        return self


class LegBodySettings(Section):
    """Cylinder or rod, the two parts of a leg; equal for all six legs."""

    mass_kg: NonNegative
    com_m: NonNegative
    """Centre of mass along the leg. Cylinder: from the base joint. Rod: from the platform joint."""
    inertia_axial_kg_m2: NonNegative | None = None
    """About the leg's own axis; no effect unless the legs spin."""
    inertia_transverse_kg_m2: NonNegative


class PlatformSettings(Section):
    """Geometry and inertia of the robot."""

    base_joints_m: SixVectors | JointCircle
    """Joint centres a_i in the base frame."""
    platform_joints_m: SixVectors | JointCircle
    """Joint centres b_i in the platform frame."""
    platform: BodySettings
    cylinder: LegBodySettings
    rod: LegBodySettings
    gravity_m_s2: Vector3 = (0.0, 0.0, -9.81)
    leg_spin: LegSpin = "none"
    universal_joint_base_axes: SixVectors | None = None
    home: Pose
    """Initial pose of forward kinematics and of the virtual plant."""
    length_min_m: Positive
    """Hard end of the stroke, joint centre to joint centre."""
    length_max_m: Positive
    base_joint_angle_max_deg: JointAngle | None = None
    """Largest angle between leg and axis of the base joint, for `hil workspace`. Default: not checked."""
    platform_joint_angle_max_deg: JointAngle | None = None
    """Largest angle between leg and axis of the platform joint. Default: not checked."""
    base_joint_axes: SixVectors | None = None
    """Axes of the base joints' cones, base to platform, base frame. Default: each leg's direction at home."""
    platform_joint_axes: SixVectors | None = None
    """Axes of the platform joints' cones, base to platform, platform frame. Default: each leg's direction at
    home."""

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
