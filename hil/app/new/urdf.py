"""Robot of a URDF: joints, strokes, and bodies where the file has masses.

A URDF is a tree, so it holds a Stewart platform with open loops: the base is its root; a leg is a chain of
links with rotary joints in one point, a prismatic joint, and rotary joints in one point or a frame at its
end. The platform is a link below one leg, or below the base by a floating joint. With all joints at zero
the robot is assembled.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable
from math import isfinite
from pathlib import Path
from typing import Any, NamedTuple
from xml.etree import ElementTree as ET

import numpy as np

from drivers.arrays import Array
from drivers.errors import ConfigurationError, HilError
from drivers.files import read_regular
from drivers.signals import LEGS
from hil.app.new.template import DIGITS
from hil.config.number import is_allowed
from hil.config.values import rotation_vector_deg
from hil.mathematics.rotations import rotation_from_vector, rotation_vector
from hil.mathematics.rounding import rounded
from hil.robot.geometry import Body, Platform
from hil.robot.inertia import combine, turned
from hil.robot.kinematics import forward_kinematics

IN_A_POINT_m = 1e-4
"""Largest distance between the rotary joints of one universal or ball joint."""
ALONG = 1e-3
"""Largest sine of the angle between a prismatic joint and the line between the two ends of its leg."""
ALIKE = 0.05
"""Largest deviation of a leg's masses from their mean: the model has six equal legs."""
ROTARY = frozenset(("revolute", "continuous", "spherical", "ball"))
PLATFORM = "a link below the last joint of a leg, heavier than all others there, or floating on the base"
"""Links that are recognised as the platform."""


class Joint(NamedTuple):
    """A joint of the file, and its frame in the base frame with all joints at zero."""

    name: str
    kind: str
    parent: str
    child: str
    p: Array
    R: Array
    axis: Array
    """Base frame."""
    limits: tuple[float, float]


class Leg(NamedTuple):
    """One leg: its two ends (3,) m in the base frame, its lengths, and the links of its halves."""

    a: Array
    b: Array
    shortest_m: float
    longest_m: float
    cylinder: list[str]
    rod: list[str]
    beyond: list[str]
    """Links below the joint at the platform."""


class Tree:
    """Links and joints of a file, in its order. Raises ConfigurationError if it is not a tree of links."""

    def __init__(self, path: Path) -> None:
        self.path = path
        root = _parsed(path)
        names = [link.get("name", "") for link in root.findall("link")]
        self.links = dict(zip(names, root.findall("link"), strict=True))
        children = [_link(joint, "child") for joint in root.findall("joint")]
        raw = dict(zip(children, root.findall("joint"), strict=True))
        parents = {child: _link(joint, "parent") for child, joint in raw.items()}
        wrong = [name for each in (names, children) for name, count in Counter(each).items() if count > 1]
        wrong += sorted({*children, *parents.values()} - {*names})
        if wrong:
            what = f"a link is missing or given twice, or two joints lead to it: {', '.join(wrong):.200}"
            raise self.refused(what)
        tops = [name for name in names if name not in parents]
        if len(tops) != 1:
            raise self.refused(f"one link without a parent, the base, is needed, given: {len(tops)}")
        self.base = tops[0]
        self.children: dict[str, list[str]] = {name: [] for name in names}
        for child, parent in parents.items():
            self.children[parent].append(child)
        self.places = {self.base: (np.zeros(3), np.eye(3))}
        joints: dict[str, Joint] = {}
        for child in self.below(self.base)[1:]:
            try:
                joint = _joint(raw[child], parents[child], child, *self.places[parents[child]])
            except ValueError as error:
                raise self.refused(f"joint to {child}: {error}") from None
            joints[child] = joint
            self.places[child] = joint.p, joint.R
        if len(self.places) != len(names):
            raise self.refused("some links are children of each other, and not of the base")
        self.joints = {child: joints[child] for child in raw}

    def refused(self, *problems: str) -> ConfigurationError:
        """Error with every problem."""
        return ConfigurationError(*(f"{self.path}: {problem}" for problem in problems))

    def up(self, link: str) -> list[Joint]:
        """Joints from the base to a link."""
        found: list[Joint] = []
        while link != self.base:
            found.append(self.joints[link])
            link = found[-1].parent
        return found[::-1]

    def down(self, link: str) -> list[Joint]:
        """Joints of which a link is the parent."""
        return [self.joints[child] for child in self.children[link]]

    def below(self, link: str) -> list[str]:
        """The link and all links below it, parents first."""
        found = [link]
        for each in found:
            found += self.children[each]
        return found

    def rigid(self, link: str) -> list[str]:
        """The link and all links below it by fixed joints."""
        found = [link]
        for each in found:
            found += [joint.child for joint in self.down(each) if joint.kind == "fixed"]
        return found

    def bodies(self, links: Iterable[str]) -> list[Body]:
        """Bodies of the links with a mass, in the base frame."""
        found = []
        for link in links:
            try:
                body = _body(self.links[link].find("inertial"), *self.places[link])
            except ValueError as error:
                raise self.refused(f"link {link}: {error}") from None
            found += [body] if body.mass > 0.0 else []
        return found


def read_urdf(path: Path) -> dict[str, Any]:
    """Answers of `hil new` from a URDF, whose legs are in the order of its prismatic joints.

    Raises ConfigurationError with all that is missing: the file is not read, or not a Stewart platform.
    """
    tree = Tree(path)
    sliding = [joint for joint in tree.joints.values() if joint.kind == "prismatic"]
    if len(sliding) != LEGS:
        raise tree.refused(f"{len(sliding)} prismatic joints, allowed: {LEGS}, one a leg")
    legs: list[Leg] = []
    problems: list[str] = []
    for joint in sliding:
        found = _leg(tree, joint)
        legs += [found] if isinstance(found, Leg) else []
        problems += [] if isinstance(found, Leg) else [f"joint {joint.name}: {found}"]
    platform = _platform(tree, [link for leg in legs for link in leg.beyond])
    if platform is None:
        problems.append(f"no platform, allowed: {PLATFORM}")
    if problems or platform is None:
        raise tree.refused(*problems)
    shortest, longest = max(leg.shortest_m for leg in legs), min(leg.longest_m for leg in legs)
    if not 0.0 < shortest < longest:
        raise tree.refused(f"the legs share no stroke: they begin at {shortest:g} m and end at {longest:g} m")
    p, R = tree.places[platform]
    bodies = tree.bodies({*tree.rigid(platform), *(link for leg in legs for link in leg.beyond)})
    a, b = np.array([leg.a for leg in legs]), np.array([(leg.b - p) @ R for leg in legs])
    low, stroke = rounded(shortest, DIGITS), rounded(longest - shortest, DIGITS)
    answers = {
        "base_joints_m": _rounded(a), "platform_joints_m": _rounded(b),
        "platform_radius_m": rounded(float(np.linalg.norm(b - b.mean(axis=0), axis=1).mean()), DIGITS),
        "length_min_m": low, "stroke_m": stroke,
        **_of_body(bodies, p, R), **_of_legs(tree, legs),
    }  # fmt: skip
    return answers | {"home": _home(tree, answers, p, R)}


def _home(tree: Tree, answers: dict[str, Any], p: Array, R: Array) -> dict[str, Any]:
    """Pose with all legs at mid-stroke, next to the file's."""
    light = {"mass": 1.0, "com": [0, 0, 0], "inertia": np.eye(3)}
    half = {"mass": 0.0, "com": 0.0, "inertia_axial": 0.0, "inertia_transverse": 0.0}
    robot = Platform.from_dict(
        {
            "base_joints": answers["base_joints_m"], "platform_joints": answers["platform_joints_m"],
            "platform": light, "cylinder": half, "rod": half, "gravity": [0, 0, 0],
        }
    )  # fmt: skip
    middle = np.full(LEGS, answers["length_min_m"] + answers["stroke_m"] / 2)
    try:
        home = forward_kinematics(robot, middle, p, R)
    except HilError as error:
        raise tree.refused(f"no pose with all legs at mid-stroke, {middle[0]:g} m: {error}") from error
    turn = np.round(np.rad2deg(rotation_vector(home.R)), 9) + 0.0
    pose = {"position_m": (np.round(home.p, 9) + 0.0).tolist()}
    return pose | ({"rotation_vector_deg": turn.tolist()} if turn.any() else {})


def _leg(tree: Tree, sliding: Joint) -> Leg | str:
    """Leg of a prismatic joint, or what is missing."""
    above = [joint for joint in tree.up(sliding.parent) if joint.kind != "fixed"]
    if not above or not {joint.kind for joint in above} <= ROTARY:
        return "no rotary joints between it and the base, allowed: one or more, in one point"
    a = above[0].p
    if any(np.linalg.norm(joint.p - a) > IN_A_POINT_m for joint in above):
        return f"its joints at the base ({', '.join(joint.name for joint in above)}) are not in one point"
    rod = tree.rigid(sliding.child)
    ends = [joint for link in rod for joint in tree.down(link) if joint.kind != "fixed"]
    if len(ends) > 1 or not {joint.kind for joint in ends} <= ROTARY:
        return f"one rotary joint or a frame at the end of its leg is needed, given: {len(ends)} joints"
    leaves = [link for link in rod[1:] if not tree.children[link]]
    if not ends and len(leaves) != 1:
        return "no end of its leg: neither a rotary joint nor one link on a fixed joint"
    b = ends[0].p if ends else tree.places[leaves[0]][0]
    length = float(np.linalg.norm(b - a))
    s = (b - a) / length if length > IN_A_POINT_m else np.zeros(3)
    if not np.linalg.norm(np.cross(sliding.axis, s)) <= ALONG or not s.any():
        return "does not slide along the line between the two ends of its leg"
    low, high = sliding.limits if sliding.axis @ s > 0.0 else (-sliding.limits[1], -sliding.limits[0])
    if not low < high:
        return "no limits: lower less than upper is needed, m"
    inside = [joint.child for joint in tree.up(sliding.parent)]
    first = inside.index(above[0].child)
    beyond = tree.below(ends[0].child) if ends else []
    return Leg(a, b, length + low, length + high, inside[first:], rod, beyond)


def _platform(tree: Tree, beyond: list[str]) -> str | None:
    floating = [joint.child for joint in tree.joints.values() if joint.kind == "floating"]
    if floating:
        return floating[0] if len(floating) == 1 else None
    masses = {link: sum(body.mass for body in tree.bodies([link])) for link in beyond}
    heaviest = max(masses, key=masses.__getitem__, default=None)
    return heaviest if heaviest and 2.0 * masses[heaviest] > sum(masses.values()) else None


def _of_body(bodies: list[Body], p: Array, R: Array) -> dict[str, Any]:
    """Mass, centre of mass and tensor of the platform in its frame; nothing without masses."""
    if not bodies:
        return {}
    body = combine(bodies)
    return {
        "mass_kg": rounded(body.mass, DIGITS),
        "com_m": _rounded((body.com - p) @ R),
        "inertia_kg_m2": _rounded(turned(body.inertia, R.T)),
    }


def _of_legs(tree: Tree, legs: list[Leg]) -> dict[str, Any]:
    """Mean halves of the legs; nothing if a half has no mass. Raises ConfigurationError: unequal legs."""
    found: dict[str, Any] = {}
    for name in ("cylinder", "rod"):
        halves = [tree.bodies(getattr(leg, name)) for leg in legs]
        if not all(halves):
            return {}
        rows = []
        for leg, bodies in zip(legs, halves, strict=True):
            body, s = combine(bodies), (leg.b - leg.a) / np.linalg.norm(leg.b - leg.a)
            com = float(s @ (body.com - leg.a if name == "cylinder" else leg.b - body.com))
            rows.append((body.mass, com, float(np.trace(body.inertia) - s @ body.inertia @ s) / 2))
        mass, com, across = np.array(rows).mean(axis=0).tolist()
        if any(abs(row[0] - mass) > ALIKE * mass for row in rows):
            raise tree.refused(
                f"the six {name}s have different masses, allowed: up to {100 * ALIKE:g} % from the mean"
            )
        if com < 0.0:
            raise tree.refused(f"the centre of mass of the {name}s lies beyond the end of the legs")
        found |= {f"{name}_kg": mass, f"{name}_com": com, f"{name}_inertia": across}
    return found | {"leg_mass_kg": rounded(found["cylinder_kg"] + found["rod_kg"], DIGITS)}


def _parsed(path: Path) -> ET.Element:
    try:
        text = read_regular(path).decode("utf-8-sig")
        if "<!DOCTYPE" in text or "<!ENTITY" in text:
            raise ConfigurationError(f"{path}: has a DOCTYPE or entities, which are not read")
        root = ET.fromstring(text)  # noqa: S314 - without a DOCTYPE no entity is defined
    except OSError as error:
        raise ConfigurationError(f"{path}: cannot be read: {error.strerror}") from error
    except (UnicodeDecodeError, ET.ParseError, ValueError) as error:
        raise ConfigurationError(f"{path}: not XML in UTF-8: {error}") from error
    if root.tag != "robot":
        raise ConfigurationError(f"{path}: not a URDF: its first element is {root.tag:.60}, allowed: robot")
    return root


def _link(joint: ET.Element, end: str) -> str:
    there = joint.find(end)
    return "" if there is None else there.get("link", "")


def _numbers(element: ET.Element | None, key: str, count: int) -> list[float]:
    """Finite numbers of an attribute, 0 where it is missing. Raises ValueError."""
    text = None if element is None else element.get(key)
    if element is None or text is None:
        return [0.0] * count
    try:
        found = [float(word) for word in text.split()]
    except ValueError:
        found = []
    if len(found) != count or not all(isfinite(x) and is_allowed(x) for x in found):
        raise ValueError(f"<{element.tag} {key}>: allowed: {count} finite numbers, given: {text:.60}")
    return found


def _frame(origin: ET.Element | None) -> tuple[Array, Array]:
    """Translation (3,) m and rotation (3, 3) of an <origin>; rpy: R = Rz Ry Rx, rad."""
    roll, pitch, yaw = np.rad2deg(_numbers(origin, "rpy", 3)).tolist()
    R = rotation_from_vector(np.deg2rad(rotation_vector_deg(roll, pitch, yaw)))
    return np.array(_numbers(origin, "xyz", 3)), R


def _body(given: ET.Element | None, p: Array, R: Array) -> Body:
    """Body of an <inertial>, by default of mass 0, in the base frame."""
    mass, origin, inertia = (
        None if given is None else given.find(tag) for tag in ("mass", "origin", "inertia")
    )
    c, Q = _frame(origin)
    xx, xy, xz, yy, yz, zz = (_numbers(inertia, f"i{k}", 1)[0] for k in ("xx", "xy", "xz", "yy", "yz", "zz"))
    I = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
    return Body(_numbers(mass, "value", 1)[0], p + R @ c, turned(I, R @ Q))


def _joint(given: ET.Element, parent: str, child: str, p: Array, R: Array) -> Joint:
    c, Q = _frame(given.find("origin"))
    axis = np.array(_numbers(given.find("axis"), "xyz", 3))
    axis = axis / np.linalg.norm(axis) if axis.any() else np.array([1.0, 0.0, 0.0])
    lower, upper = (_numbers(given.find("limit"), key, 1)[0] for key in ("lower", "upper"))
    name, kind = given.get("name", "without a name"), given.get("type", "")
    return Joint(name, kind, parent, child, p + R @ c, R @ Q, R @ Q @ axis, (lower, upper))


def _rounded(x: Array) -> Any:
    unit = 10.0 ** (np.ceil(np.log10(np.abs(x).max())) - DIGITS) if x.any() else 1.0
    return (np.round(x / unit) * unit + 0.0).tolist()
