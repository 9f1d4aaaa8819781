"""`hil workspace CONFIG`: reachable poses of the platform within its limits, as figures and a picture."""

import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from drivers.arrays import Array
from drivers.errors import ConfigurationError
from hil.app.configuration.configuration import Configuration
from hil.app.configuration.platform import build_platform, pose_arrays
from hil.app.configuration.yaml_positions import Problem, parse
from hil.app.output import further, picture_path
from hil.study.workspace.kernels import FORCE, LENGTH
from hil.study.workspace.limits import CHUNK, KINDS, Limits, Surveyor, WorkspaceError
from hil.study.workspace.maps import Workspace, explore
from hil.study.workspace.plot import draw


def map_workspace(
    c: Configuration,
    *,
    resolution: int = 60,
    position: tuple[float, float, float] | None = None,
    payload_kg: float = 0.0,
    payload_at: tuple[float, float, float] = (0.0, 0.0, 0.0),
    leg_diameter_m: float | None = None,
    picture: Path | None = None,
    progress: Callable[[str], None] = lambda _: None,
) -> dict[str, Any]:
    """Map the reachable workspace of a configuration, draw it, and return the summary.

    resolution: steps across; position (3,) m: where orientations are mapped. Raises ConfigurationError: home
    is outside the limits; WorkspaceError: `position` cannot be reached; LogError: no picture can be made.
    """
    begun = time.perf_counter()
    path = picture_path(c.recording.folder, f"{c.name}-workspace", picture)
    surveyor = build_surveyor(c, payload_kg, payload_at, leg_diameter_m)
    w = explore(surveyor, resolution, position, progress)
    result: dict[str, Any] = {
        "success": True,
        "kind": "workspace",
        "configuration": c.source,
        "resolution": resolution,
        **figures(c, w),
    }
    progress("drawing")
    result["picture"] = None
    with further(result):
        draw(w, path, f"{c.name}: workspace within stroke, joint angle and force limits")
        result["picture"] = str(path)
    return {**result, "wall_s": time.perf_counter() - begun}


def build_surveyor(
    c: Configuration,
    payload_kg: float = 0.0,
    payload_at: tuple[float, float, float] = (0.0, 0.0, 0.0),
    leg_diameter_m: float | None = None,
) -> Surveyor:
    """Surveyor that tests poses against a configuration's limits; the stroke ends at its soft ends.

    Raises ConfigurationError if home is outside the limits.
    """
    s = c.platform
    angles = (s.base_joint_angle_max_deg, s.platform_joint_angle_max_deg)
    base_angle, platform_angle = (np.pi if angle is None else float(np.deg2rad(angle)) for angle in angles)
    limits = Limits(
        s.length_min_m + c.limits.stroke_margin_m,
        s.length_max_m - c.limits.stroke_margin_m,
        c.limits.force_N,
        c.limits.condition,
        base_angle,
        platform_angle,
        leg_diameter_m,
    )
    try:
        return Surveyor(
            build_platform(s),
            limits,
            *pose_arrays(s.home),
            base_axes=s.base_joint_axes,
            platform_axes=s.platform_joint_axes,
            payload=payload_kg,
            payload_at=payload_at,
        )
    except WorkspaceError as error:
        where = ("platform", "home")
        line = Problem(parse(c.text).key_position(where), where, str(error)).line(c.source)
        raise ConfigurationError(line + "; the map begins at home") from error


def figures(c: Configuration, w: Workspace) -> dict[str, Any]:
    """Figures of a mapped workspace as plain values."""
    s, m, o, lim = w.surveyor, w.positions, w.orientations, w.surveyor.limits
    counts = np.bincount(m.kinds, minlength=len(KINDS))
    numbers, leasts = s.dexterity(m.nodes, s.R)
    level = o.kinds[len(o.torsion) // 2]
    return {
        "step_m": m.step,
        "limits": {
            "length_m": [lim.length_min, lim.length_max],
            "force_N": lim.force,
            "condition": lim.condition,
            "base_joint_angle_deg": c.platform.base_joint_angle_max_deg,
            "platform_joint_angle_deg": c.platform.platform_joint_angle_max_deg,
            "leg_diameter_m": lim.leg_diameter,
            "payload_kg": float(s.payload[0]),
            "payload_at_m": s.payload[1:].tolist(),
        },
        "home": _home(s),
        "positions": {
            "volume_m3": m.volume,
            "volume_error_m3": m.volume_error,
            "convergence": [{"step_m": h, "volume_m3": v} for h, v in m.volumes],
            "extents_m": dict(zip("xyz", m.extents.tolist(), strict=True)),
            "nodes": len(m.nodes),
            "boundary_points": dict(zip(KINDS, counts.tolist(), strict=True)),
            "boundary_shares": m.shares,
        },
        "largest_sphere": {
            "radius_m": w.sphere.radius,
            "direction": w.sphere.direction.tolist(),
            "limit": _kind(w.sphere.kind),
        },
        "largest_cylinder": {
            "radius_m": w.cylinder.radius,
            "z_m": [w.cylinder.low + float(s.p[2]), w.cylinder.high + float(s.p[2])],
            "volume_m3": w.cylinder.volume,
        },
        "dexterity": {
            "condition_number": _range(numbers),
            "smallest_singular_value": _range(leasts),
            "mean_inverse_condition": float(np.mean(1.0 / numbers)),
        },
        "largest_static_force_N": max(
            float(np.abs(s.survey(m.nodes[k : k + CHUNK], s.R)[:, FORCE : FORCE + 6]).max())
            for k in range(0, len(m.nodes), CHUNK)
        ),
        "orientations": {
            "position_m": o.position.tolist(),
            "tilt_every_direction_deg": float(np.rad2deg(o.level.min())),
            "tilt_best_direction_deg": float(np.rad2deg(o.level.max())),
            "torsion_deg": np.rad2deg(o.torsion[[0, -1]]).tolist(),
            "torsion_limits": [_kind(k) for k in o.torsion_kinds],
            "tilt_limits": {k: int((level == i).sum()) for i, k in enumerate(KINDS)},
            "largest_guaranteed_tilt_deg": float(np.rad2deg(o.guaranteed.max())),
            "at_torsion_deg": float(np.rad2deg(o.torsion[int(np.argmax(o.guaranteed))])),
        },
    }


def _home(s: Surveyor) -> dict[str, Any]:
    """Figures of the home pose as plain values."""
    home = s.survey(s.p, s.R)[0]
    (number,), (least,) = s.dexterity(s.p[None], s.R)
    return {
        "position_m": s.p.tolist(),
        "rotation": s.R.tolist(),
        "leg_lengths_m": home[LENGTH : LENGTH + 6].tolist(),
        "static_forces_N": home[FORCE : FORCE + 6].tolist(),
        "condition_number": float(number),
        "smallest_singular_value": float(least),
        "largest_payload_kg": s.largest_payload(),
    }


def shown(summary: dict[str, Any]) -> dict[str, Any]:
    """Summarise for the terminal: a sentence for each figure that an engineer needs."""
    m, o, d, home = (summary[key] for key in ("positions", "orientations", "dexterity", "home"))
    sphere, cylinder = summary["largest_sphere"], summary["largest_cylinder"]
    low, high = cylinder["z_m"]
    extents = ", ".join(f"{k} {low:.3f} to {high:.3f}" for k, (low, high) in m["extents_m"].items())
    number, least = d["condition_number"], d["smallest_singular_value"]
    at = ", ".join(f"{x:g}" for x in o["position_m"])
    return {
        "success": summary["success"],
        "configuration": summary["configuration"],
        "resolution": f"{summary['resolution']} steps of {1e3 * summary['step_m']:.1f} mm",
        "volume": f"{m['volume_m3']:.4g} m^3, within about {m['volume_error_m3']:.1g}; "
        f"{m['convergence'][-2]['volume_m3']:.4g} at twice the step",
        "extents": f"{extents} m",
        "boundary": ", ".join(f"{k} {100 * x:.1f} %" for k, x in m["boundary_shares"].items() if x > 0),
        "largest sphere": f"radius {sphere['radius_m']:.4f} m about home, then {sphere['limit']}",
        "largest cylinder": f"radius {cylinder['radius_m']:.4f} m, z {low:.3f} to {high:.3f} m",
        "condition of J": f"{home['condition_number']:.2f} at home, {number['min']:.2f} to "
        f"{number['max']:.2f}",
        "singularity measure": f"{home['smallest_singular_value']:.3f} at home, down to {least['min']:.3f} "
        "(smallest singular value of J with lengths / r)",
        "static leg force": f"up to {summary['largest_static_force_N']:.0f} N; at home the legs hold "
        f"a payload of up to {home['largest_payload_kg']:.0f} kg in total, at its place",
        "tilt": f"{o['tilt_every_direction_deg']:.2f} deg in every direction, "
        f"{o['tilt_best_direction_deg']:.2f} in the best, at ({at}) m",
        "torsion": f"{o['torsion_deg'][0]:.2f} to {o['torsion_deg'][1]:.2f} deg",
        "picture": summary["picture"],
        "wall": f"{summary['wall_s']:.1f} s",
    }


def _range(values: Array) -> dict[str, float]:
    return {"min": float(values.min()), "mean": float(values.mean()), "max": float(values.max())}


def _kind(kind: int) -> str | None:
    return KINDS[kind] if kind >= 0 else None
