"""The robot as numbers: joint positions, masses, inertias, gravity; checked once, then read-only.

This module contains no mathematics except the checks.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, fields
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from drivers.arrays import Array
from drivers.errors import ModelError

TOLERANCE = 1e-9
"""Relative tolerance of inertia tensors (symmetry, triangle inequality); in m: distance of equal joints."""


class GeometryError(ModelError):
    """A platform that is not physical, or that no leg forces can control.

    Attributes
    ----------
    where : str
        The invalid key, for example ``platform.inertia``.
    value : object
        The value given, or the quantity that violates the limit.
    """

    def __init__(self, where: str, value: object, allowed: str) -> None:
        super().__init__(f"{where}: got {value}, allowed is {allowed}")
        self.where = where
        self.value = value


@dataclass(frozen=True)
class Body:
    """The moving platform: mass (kg), com (3,) m, inertia (3, 3) kg m^2 about com, in platform axes."""

    mass: float
    com: Array
    inertia: Array


@dataclass(frozen=True)
class LegBody:
    """One of the two parts of a leg: mass (kg), com (m along the leg), inertias about com (kg m^2).

    ``com`` is measured from the base joint for a cylinder, from the platform joint for a rod.
    """

    mass: float
    com: float
    inertia_axial: float
    inertia_transverse: float


@dataclass(frozen=True)
class Platform:
    """A Stewart-Gough platform.

    Attributes
    ----------
    base_joints : (6, 3) m
        a_i in the base frame.
    platform_joints : (6, 3) m
        b_i in the platform frame.
    platform : Body
    cylinder, rod : LegBody
        The same for all six legs.
    gravity : (3,) m/s^2
        Base frame.
    universal_joint_base_axes : (6, 3) or None
        Unit directions, base frame, of the hinge between base and leg i; required where legs spin.

    Raises GeometryError for a value that is missing, not finite, of the wrong shape or not physical.
    """

    base_joints: Array
    platform_joints: Array
    platform: Body
    cylinder: LegBody
    rod: LegBody
    gravity: Array
    universal_joint_base_axes: Array | None = None

    def __post_init__(self) -> None:
        """Check all values and store read-only copies of the arrays."""
        keep = object.__setattr__
        keep(self, "base_joints", _array("base_joints", self.base_joints, (6, 3)))
        keep(self, "platform_joints", _array("platform_joints", self.platform_joints, (6, 3)))
        keep(self, "gravity", _array("gravity", self.gravity, (3,)))
        if self.universal_joint_base_axes is not None:
            axes = unit_rows("universal_joint_base_axes", self.universal_joint_base_axes)
            keep(self, "universal_joint_base_axes", axes)
        keep(self, "platform", _body(self.platform))
        keep(self, "cylinder", _leg_body("cylinder", self.cylinder))
        keep(self, "rod", _leg_body("rod", self.rod))
        _check_legs(self.base_joints, self.platform_joints)

    @property
    def radius(self) -> float:
        """Mean distance, m, of the platform joints from the platform origin; converts rad to m."""
        return float(np.mean(np.sqrt((self.platform_joints**2).sum(axis=1))))

    @classmethod
    def from_dict(cls, d: Mapping[str, Any]) -> Platform:
        """Create a platform from plain numbers.

        Keys: ``base_joints``, ``platform_joints``, ``platform {mass, com, inertia}``, ``cylinder`` and
        ``rod {mass, com, inertia_axial, inertia_transverse}``, ``gravity``, optionally
        ``universal_joint_base_axes``. ``inertia_axial`` may be None, which counts as 0. Other keys at the
        top level (a name, a source) are ignored.

        Raises GeometryError for a missing key or an invalid value.
        """
        return cls(
            base_joints=_get(d, "base_joints"),
            platform_joints=_get(d, "platform_joints"),
            platform=_section(d, "platform", Body),
            cylinder=_section(d, "cylinder", LegBody),
            rod=_section(d, "rod", LegBody),
            gravity=_get(d, "gravity"),
            universal_joint_base_axes=d.get("universal_joint_base_axes"),
        )

    def to_dict(self) -> dict[str, Any]:
        """Platform as nested lists and floats, SI units, with the keys that ``from_dict`` reads."""
        axes = self.universal_joint_base_axes
        return {
            "base_joints": self.base_joints.tolist(),
            "platform_joints": self.platform_joints.tolist(),
            "platform": {
                "mass": self.platform.mass,
                "com": self.platform.com.tolist(),
                "inertia": self.platform.inertia.tolist(),
            },
            "cylinder": asdict(self.cylinder),
            "rod": asdict(self.rod),
            "gravity": self.gravity.tolist(),
            **({} if axes is None else {"universal_joint_base_axes": axes.tolist()}),
        }


def _get(d: Mapping[str, Any], key: str, inside: str = "") -> Any:
    try:
        return d[key]
    except KeyError:
        raise GeometryError(inside + key, "nothing", "a value: the key is required") from None


def _section(d: Mapping[str, Any], name: str, kind: type[Body | LegBody]) -> Any:
    section, keys = _get(d, name), [field.name for field in fields(kind)]
    if not isinstance(section, Mapping):
        raise GeometryError(name, section, "a mapping with " + ", ".join(keys))
    unknown = set(section) - set(keys)
    if unknown:
        raise GeometryError(name, ", ".join(sorted(map(str, unknown))), "only " + ", ".join(keys))
    if section.get("inertia_axial") is None and "inertia_axial" in keys:
        section = {**section, "inertia_axial": 0.0}
    return kind(**{key: _get(section, key, name + ".") for key in keys})


def _array(where: str, value: ArrayLike, shape: tuple[int, ...]) -> Array:
    try:
        array = np.array(value, np.float64, order="C")
    except (TypeError, ValueError):
        raise GeometryError(where, value, f"numbers in the shape {shape}") from None
    if array.shape != shape:
        raise GeometryError(where, f"shape {array.shape}", f"shape {shape}")
    if not np.isfinite(array).all():
        raise GeometryError(where, array.tolist(), "finite numbers")
    array.flags.writeable = False
    return array


def _number(where: str, value: Any, *, positive: bool = False) -> float:
    number = float(_array(where, value, ()))
    if number < 0 or (positive and number == 0):
        raise GeometryError(where, number, "a number > 0" if positive else "a number >= 0")
    return number


def _body(body: Body) -> Body:
    inertia = _array("platform.inertia", body.inertia, (3, 3))
    size = float(np.abs(inertia).max())
    if float(np.abs(inertia - inertia.T).max()) > TOLERANCE * size:
        raise GeometryError("platform.inertia", inertia.tolist(), "a symmetric matrix")
    inertia = _array("platform.inertia", (inertia + inertia.T) / 2, (3, 3))
    small, middle, large = np.linalg.eigvalsh(inertia)
    if not small > 0:
        raise GeometryError(
            "platform.inertia", [float(small), float(middle), float(large)], "three principal moments > 0"
        )
    if small + middle < large * (1 - TOLERANCE):
        raise GeometryError(
            "platform.inertia",
            f"principal moments {small:.9g}, {middle:.9g}, {large:.9g} kg m^2",
            "the largest at most the sum of the other two, as for every rigid body",
        )
    return Body(
        _number("platform.mass", body.mass, positive=True), _array("platform.com", body.com, (3,)), inertia
    )


def _leg_body(name: str, body: LegBody) -> LegBody:
    axial = _number(f"{name}.inertia_axial", body.inertia_axial)
    transverse = _number(f"{name}.inertia_transverse", body.inertia_transverse)
    if axial > 2 * transverse * (1 + TOLERANCE):
        raise GeometryError(
            f"{name}.inertia_axial", axial, f"at most twice inertia_transverse, {2 * transverse}"
        )
    return LegBody(_number(f"{name}.mass", body.mass), _number(f"{name}.com", body.com), axial, transverse)


def unit_rows(where: str, value: ArrayLike) -> Array:
    """Six direction vectors (6, 3) scaled to length 1; GeometryError at the key `where` for a length of 0."""
    axes = _array(where, value, (6, 3))
    length = np.sqrt((axes**2).sum(axis=1, keepdims=True))
    if not (length > TOLERANCE).all():
        raise GeometryError(where, axes.tolist(), "six directions, none of length zero")
    return _array(where, axes / length, (6, 3))


def _check_legs(a: Array, b: Array) -> None:
    for i in range(6):
        for j in range(i):
            gap = max(float(np.abs(a[i] - a[j]).max()), float(np.abs(b[i] - b[j]).max()))
            if gap < TOLERANCE:
                raise GeometryError(
                    "base_joints, platform_joints",
                    f"legs {j} and {i} with both joints in common",
                    "legs that differ in at least one joint",
                )
    for name, joints in (("base_joints", a), ("platform_joints", b)):
        spread = np.linalg.svd(joints - joints.mean(axis=0), compute_uv=False)
        if spread[1] < TOLERANCE:
            raise GeometryError(
                name, "six joints on one line", "joints that span a plane, else J is singular everywhere"
            )
