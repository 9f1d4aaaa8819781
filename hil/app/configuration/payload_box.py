"""Extreme payloads within the ranges of a payload's mass and centre of mass.

Forces at rest are linear in m and m c, so their extremes are at corners of these ranges. The kinetic energy
of a motion is convex in c: the largest inertia is at a corner. The smallest may be inside, near the place
where the smallest mass is closest to the centre of mass of all the rest. That place is checked, too.
"""

from itertools import product
from typing import NamedTuple

from hil.app.configuration.platform import frame_axes, platform_body, rigid_body
from hil.config.platform import Frame, InertiaReference, PayloadSettings, PlatformSettings
from hil.config.values import Vector3


class Corner(NamedTuple):
    """Platform with one of the payloads that its ranges allow."""

    settings: PlatformSettings
    words: str
    """Description of the payload."""


def corners(settings: PlatformSettings) -> list[Corner]:
    """Platform with the model's payload, then with each extreme of the payload that has ranges.

    Without ranges only the first. Raises GeometryError for an inertia tensor that no body has.
    """
    payload = settings.platform.payload
    ranged = next((k for k, body in enumerate(payload) if body.ranged), None)
    if ranged is None:
        return [Corner(settings, "the model's payload")]
    body = payload[ranged]
    masses = sorted(set(body.mass_range_kg or (body.mass_kg,)))
    places = list(
        product(*(sorted(set(range_m)) for range_m in body.com_range_m or [(x,) for x in body.com_m]))
    )
    inner = _nearest(settings, ranged)
    found = [Corner(settings, "the model's payload")]
    for mass in masses:
        where = places[:1] if mass == 0.0 else [*places, *([inner] if mass == masses[0] else [])]
        for x, y, z in dict.fromkeys(where):
            if mass == body.mass_kg and (mass == 0.0 or (x, y, z) == body.com_m):
                continue  # the model's own
            moved = _moved(body, mass, (x, y, z))
            carried = [*payload[:ranged], *moved, *payload[ranged + 1 :]]
            changed = settings.platform.model_copy(update={"payload": carried})
            words = shown_ranges(moved[0]) if moved else "no payload"
            found.append(Corner(settings.model_copy(update={"platform": changed}), words))
    return found


def _nearest(settings: PlatformSettings, ranged: int) -> Vector3:
    """Place (3,) m within a payload's ranges that is closest to the centre of mass of all the rest."""
    payload = settings.platform.payload
    body, rest = payload[ranged], [*payload[:ranged], *payload[ranged + 1 :]]
    bare = settings.platform.model_copy(update={"payload": rest})
    R, origin = frame_axes(body.frame)
    com = R.T @ (platform_body(settings.model_copy(update={"platform": bare})).com - origin)
    ranges = body.com_range_m or [(x, x) for x in body.com_m]
    x, y, z = (
        min(max(float(one), within[0]), within[1]) for one, within in zip(com, ranges, strict=True)
    )  # fmt: skip
    return (x, y, z)


def _moved(body: PayloadSettings, mass: float, com: Vector3) -> list[PayloadSettings]:
    """The payload with another mass, kg, and place, m, in a list; empty for mass 0."""
    if mass == 0.0:
        return []
    changes: dict[str, object] = {"mass_kg": mass, "com_m": com, "mass_range_kg": None, "com_range_m": None}
    if body.shape is None:  # about the centre of mass, for any reference point of the given tensor
        own = rigid_body(body.model_copy(update={"frame": Frame()}), "platform.payload")
        changes["inertia_kg_m2"] = tuple(map(tuple, (own.inertia * (mass / body.mass_kg)).tolist()))
        changes |= {"inertia_about": InertiaReference(), "products": "negative_integral"}
    return [body.model_copy(update=changes)]


def shown_ranges(body: PayloadSettings) -> str:
    """Mass, kg, and place, m, of a payload as text, with their ranges."""

    def shown(x: float, within: tuple[float, float] | None) -> str:
        return f"{x:g}" if within is None else f"{within[0]:g} to {within[1]:g}"

    ranges = body.com_range_m or (None,) * 3
    place = ", ".join(shown(x, within) for x, within in zip(body.com_m, ranges, strict=True))
    return f"{shown(body.mass_kg, body.mass_range_kg)} kg at ({place}) m"
