"""Section `platform` as the argument of `Platform.from_dict`.

Rule of the room: renames keys, computes nothing.
"""

from __future__ import annotations

from typing import Any

from hil.config import LegBodySettings, PlatformSettings


def platform_dict(settings: PlatformSettings) -> dict[str, Any]:
    """Return the argument of `Platform.from_dict` (SI, keys without unit)."""

    def leg(body: LegBodySettings) -> dict[str, Any]:
        return {
            "mass": body.mass_kg,
            "com": body.com_m,
            "inertia_axial": body.inertia_axial_kg_m2,
            "inertia_transverse": body.inertia_transverse_kg_m2,
        }

    result = {
        "base_joints": settings.base_joints_m,
        "platform_joints": settings.platform_joints_m,
        "platform": {
            "mass": settings.platform.mass_kg,
            "com": settings.platform.com_m,
            "inertia": settings.platform.inertia_kg_m2,
        },
        "cylinder": leg(settings.cylinder),
        "rod": leg(settings.rod),
        "gravity": settings.gravity_m_s2,
    }
    if settings.universal_joint_base_axes is not None:
        result["universal_joint_base_axes"] = settings.universal_joint_base_axes
    return result
