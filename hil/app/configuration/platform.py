"""Resolves section `platform`: joints from circles; CAD data, shapes and payload as one rigid body."""

from typing import Any

import numpy as np

from drivers.arrays import Array
from hil.config.platform import (
    BoxShape,
    CylinderShape,
    Frame,
    InertiaReference,
    JointCircle,
    LegBodySettings,
    PlatformSettings,
    RigidBodySettings,
    Shape,
    SphereShape,
)
from hil.config.reference import Waypoint
from hil.config.values import Pose, Vector3
from hil.mathematics.rotations import rotation_from_vector
from hil.robot import inertia, joints
from hil.robot.geometry import Body, Platform


def platform_dict(settings: PlatformSettings) -> dict[str, Any]:
    """Robot of section `platform` as the argument of `Platform.from_dict` (SI, keys without unit).

    Raises GeometryError for a tensor that no body has; `where` is the path below `platform`.
    """

    def leg(body: LegBodySettings) -> dict[str, Any]:
        return {
            "mass": body.mass_kg,
            "com": body.com_m,
            "inertia_axial": body.inertia_axial_kg_m2,
            "inertia_transverse": body.inertia_transverse_kg_m2,
        }

    body = platform_body(settings)
    result = {
        "base_joints": joint_list(settings.base_joints_m),
        "platform_joints": joint_list(settings.platform_joints_m),
        "platform": {"mass": body.mass, "com": body.com.tolist(), "inertia": body.inertia.tolist()},
        "cylinder": leg(settings.cylinder),
        "rod": leg(settings.rod),
        "gravity": settings.gravity_m_s2,
    }
    if settings.universal_joint_base_axes is not None:
        result["universal_joint_base_axes"] = settings.universal_joint_base_axes
    return result


def build_platform(settings: PlatformSettings) -> Platform:
    """Robot of section `platform`, as the controller models it. Raises GeometryError as `platform_dict`."""
    return Platform.from_dict(platform_dict(settings))


def pose_arrays(pose: Pose | Waypoint) -> tuple[Array, Array]:
    """Position p (3,) m and rotation matrix R (3, 3) of a configured pose."""
    return np.array(pose.position_m, float), _rotation(pose.rotation_vector_deg)


def joint_list(given: list[Vector3] | JointCircle) -> list[list[float]]:
    """Six joint centres (x, y, z) in m, from the list or the circle in a configuration."""
    if not isinstance(given, JointCircle):
        return [list(joint) for joint in given]
    if given.angles_deg is not None:
        return _lists(joints.on_circle(given.radius_m, given.angles_deg, given.z_m))
    spacing = given.pair_spacing_m
    if spacing is None:
        assert given.pair_half_angle_deg is not None
        spacing = joints.chord(given.radius_m, given.pair_half_angle_deg)
    assert given.pair_centres_deg is not None
    return _lists(
        joints.in_pairs(given.radius_m, given.pair_centres_deg, spacing, given.z_m, given.pairs_begin)
    )


def platform_body(settings: PlatformSettings) -> Body:
    """Platform and payload as one rigid body: inertia about its centre of mass, platform axes.

    Raises GeometryError as `platform_dict`.
    """
    own = rigid_body(settings.platform, "platform")
    carried = [(k, body) for k, body in enumerate(settings.platform.payload) if body.mass_kg > 0.0]
    load = [rigid_body(body, f"platform.payload.{k}") for k, body in carried]
    return inertia.combine([own, *load]) if load else own


def rigid_body(settings: RigidBodySettings, where: str) -> Body:
    """A configured body as a rigid body in the platform frame.

    com = origin + R c; I = R I_c R^T, I_c about the centre of mass in the axes of the body's frame. Raises
    GeometryError if no body has this inertia tensor; `where` names the body in the message.
    """
    com = np.array(settings.com_m)
    if settings.inertia_kg_m2 is None:
        assert settings.shape is not None
        I = _shape(settings.shape, settings.mass_kg)
    else:
        I = np.array(settings.inertia_kg_m2)
        if settings.products == "positive_integral":
            I = inertia.with_positive_products(I)
        about = settings.inertia_about
        if about.rotation_vector_deg != InertiaReference().rotation_vector_deg:
            I = inertia.turned(I, _rotation(about.rotation_vector_deg))
        I = inertia.about_centre_of_mass(f"{where}.inertia", settings.mass_kg, com, I, about.point_m)
    frame = settings.frame
    if frame.rotation_vector_deg != Frame().rotation_vector_deg:
        R = _rotation(frame.rotation_vector_deg)
        com, I = R[:, 0] * com[0] + R[:, 1] * com[1] + R[:, 2] * com[2], inertia.turned(I, R)
    return Body(settings.mass_kg, com + np.array(frame.origin_m), I)


def frame_axes(frame: Frame) -> tuple[Array, Array]:
    """Rotation matrix R (3, 3) and origin (3,) m of a body's frame: x_platform = origin + R x."""
    return _rotation(frame.rotation_vector_deg), np.array(frame.origin_m, float)


def _shape(shape: Shape, mass: float) -> Array:
    if isinstance(shape, BoxShape):
        return inertia.box(mass, shape.size_m)
    if isinstance(shape, CylinderShape):
        return inertia.cylinder(mass, shape.radius_m, shape.length_m, shape.inner_radius_m)
    if isinstance(shape, SphereShape):
        return inertia.sphere(mass, shape.radius_m)
    return np.zeros((3, 3))


def _rotation(vector_deg: Vector3) -> Array:
    return rotation_from_vector(np.deg2rad(np.array(vector_deg, float)))


def _lists(rows: Array) -> list[list[float]]:
    return [[float(x) for x in row] for row in rows]
