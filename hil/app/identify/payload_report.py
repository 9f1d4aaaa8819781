"""What `hil identify payload` prints, and the block for the configuration."""

from typing import Any

import numpy as np
import yaml

from drivers.arrays import Array
from hil.app.configuration.payload_box import shown_ranges
from hil.app.identify.payload import HIDDEN, REMARK, SURE, Found, drives_of
from hil.identify.leg_equations import LATE
from hil.identify.rigid_body import NAMES, SIZE, UNITS, body_of, from_pseudo_inertia, pseudo_inertia
from hil.robot.geometry import Body

DIGITS = 1e-7
"""Of the largest element: figures are rounded to that, and a tensor is kept as far from being none."""

POOR = 0.05
"""Residual, of the leg forces, from which the figures are doubted."""


def block(found: Found) -> dict[str, Any]:
    """Return the keys to paste: payload or platform, and the drives' part of the law's model."""
    c = found.sources[0].configuration
    settings = c.platform.platform
    carrier = found.believed[:SIZE]
    if found.split:
        known = [b.model_dump(mode="json", exclude_defaults=True) for b in settings.payload]
        body: dict[str, Any] = {"payload": [*known, body_keys(found.theta[:SIZE] - carrier)]}
    else:
        body = body_keys(found.theta[:SIZE])
        if settings.payload:
            body["payload"] = []
    result: dict[str, Any] = {"platform": {"platform": body}}
    believed = c.controller.believed
    if believed is not None:
        model: dict[str, Any] = {key: _drives(value, std) for key, (value, std) in drives_of(found).items()}
        if found.reflected_kg is not None:
            model["reflected_mass_kg"] = 6 * [found.reflected_kg]
        if believed.inertia_scale != 1.0:
            model["inertia_scale"] = 1.0
        result["controller"] = {"model": model}
    return result


def body_keys(theta: Array) -> dict[str, Any]:
    """Return mass_kg, com_m and inertia_kg_m2 of a body, rounded so that it stays one."""
    body = body_of(_thickened(theta))
    inertia = _rounded(body.inertia)
    return {
        "mass_kg": float(f"{body.mass:.7g}"),
        "com_m": [round(float(x), 7) for x in body.com],
        "inertia_kg_m2": inertia.tolist(),
    }


def _thickened(theta: Array) -> Array:
    """Return theta whose body is not thinner than the rounding about its centre of mass."""
    body = body_of(theta)
    values, vectors = np.linalg.eigh(0.5 * np.trace(body.inertia) * np.eye(3) - body.inertia)
    values = np.maximum(values, 10.0 * DIGITS * max(float(values.max()), DIGITS))
    P = pseudo_inertia(theta)
    P[:3, :3] = vectors @ np.diag(values) @ vectors.T + body.mass * np.outer(body.com, body.com)
    return from_pseudo_inertia(P)


def _rounded(x: Array) -> Array:
    unit = 10.0 ** np.floor(np.log10(DIGITS * np.abs(x).max()))
    rounded = np.round(np.round(x / unit) * unit, 12)
    return np.asarray(0.5 * (rounded + rounded.T) + 0.0, np.float64)


def _drives(value: Array, std: Array) -> list[float]:
    """Return what a configuration takes: not negative, and nothing that is within two standard errors."""
    return [float(f"{v:.5g}") if v > 2.0 * s else 0.0 for v, s in zip(value, std, strict=True)]


def block_text(found: Found) -> str:
    """Return the block as YAML."""
    return yaml.safe_dump(block(found), sort_keys=False, default_flow_style=None, width=110)


def file_text(found: Found) -> str:
    """Return the file of `-o`."""
    logs = "".join(f"# {s.path}\n" for s in found.sources)
    return REMARK + logs + block_text(found)


def unseen(found: Found) -> list[str]:
    """Return the unknowns that the motion does not show."""
    unknown = found.estimate.unknown
    viscous, coulomb, reflected = (
        [f"{name} of leg {k}" for k in range(6)]
        for name in ("viscous friction", "Coulomb friction", "reflected mass")
    )
    names = [*NAMES, *viscous, *coulomb, "delay of the forces", *reflected]
    return [name for name, share in zip(names, unknown, strict=True) if share > HIDDEN]


def summary(found: Found) -> dict[str, Any]:
    """Return the result as plain values."""
    e = found.estimate
    body = body_of(found.theta[:SIZE])
    payload = None
    if found.split:
        payload = _plain(body_of(found.theta[:SIZE] - found.believed[:SIZE]))
    return {
        "success": True,
        "kind": "identify",
        "logs": [str(s.path) for s in found.sources],
        "forces": ["reported" if s.reported else "commanded" for s in found.sources],
        "seconds": sum(s.seconds for s in found.sources),
        "samples": e.samples,
        "parameters": dict(zip(NAMES, found.theta[:SIZE].tolist(), strict=True)),
        "parameters_std": dict(zip(NAMES, e.std[:SIZE].tolist(), strict=True)),
        "parameters_believed": dict(zip(NAMES, found.believed[:SIZE].tolist(), strict=True)),
        "platform": _plain(body),
        "payload": payload,
        **{key: value.tolist() for key, (value, _) in drives_of(found).items()},
        **{f"{key}_std": std.tolist() for key, (_, std) in drives_of(found).items()},
        "reflected_mass": "identified" if found.reflected_kg is None else "given",
        "late_ms": 1e3 * float(found.theta[LATE]),
        "late_std_ms": 1e3 * float(e.std[LATE]),
        "condition": e.condition,
        "not_shown": unseen(found),
        "least_squares_is_a_body": found.whole.smallest > 0.0,
        "payload_alone_is_a_body": None if found.payload is None else found.payload.smallest > 0.0,
        "residual_N": e.residual_N.tolist(),
        "believed_residual_N": found.rms_believed_N,
        "forces_N": found.rms_force_N,
        "held_out_N": {name: list(pair) for name, pair in found.held_out.items()},
        "block": block(found),
    }


def _plain(body: Body) -> dict[str, Any]:
    return {
        "mass_kg": body.mass, "com_m": body.com.tolist(), "inertia_kg_m2": body.inertia.tolist()
    }  # fmt: skip


def report(found: Found) -> list[str]:
    """Return what the user reads before the block."""
    e = found.estimate
    rms = float(np.sqrt(np.mean(e.residual_N**2)))
    seconds = sum(s.seconds for s in found.sources)
    lines = [
        f"From {seconds:.1f} s with open brakes, {e.samples} instants; {_forces(found)}",
        "Platform with all it carries, about its origin (+- two standard errors):",
    ]
    for k, (name, unit) in enumerate(zip(NAMES, UNITS, strict=True)):
        off = " not shown" if e.unknown[k] > HIDDEN else ""
        lines.append(
            f"  {name:5} {found.theta[k]:11.3f} +- {2.0 * e.std[k]:<8.2g} {unit:7} "
            f"believed {found.believed[k]:.3f}{off}"
        )
    lines.append("Drives, leg 0 to 5:")
    words = {
        "viscous_friction_N_s_m": "viscous friction, N s/m",
        "coulomb_friction_N": "Coulomb friction, N",
        "reflected_mass_kg": "reflected mass, kg, identified",
    }
    for key, (value, std) in drives_of(found).items():
        figures = ", ".join(f"{v:.2f} +- {2.0 * s:.2g}" for v, s in zip(value, std, strict=True))
        lines.append(f"  {words[key]}: {figures}")
    if found.reflected_kg is not None:
        lines.append(f"  reflected mass: {found.reflected_kg:g} kg each, given, not identified")
    lines.append(
        f"Forces are {1e3 * found.theta[LATE]:.3f} +- {2e3 * e.std[LATE]:.2g} ms late against the lengths"
    )
    lines.append(
        f"Residual {rms:.3g} N rms, {found.rms_believed_N:.3g} N as believed"
        + "".join(
            f"; {name} from the rest {r:.3g} N ({b:.3g} N as believed)"
            for name, (r, b) in found.held_out.items()
        )
    )
    if rms > POOR * found.rms_force_N:
        lines.append(
            f"That is {100.0 * rms / found.rms_force_N:.0f} % of the forces, {100.0 * POOR:g} % are common: "
            "another robot than the model's, a load on the platform, or drives that do not make the "
            "force they report"
        )
    hidden = unseen(found)
    lines.append(
        f"Condition number {e.condition:.3g}; "
        + (
            f"not shown about the platform's origin: {', '.join(hidden)}"
            if hidden
            else "the motion shows every unknown"
        )
    )
    if hidden:
        lines.append(
            "Do not paste the body of the block: beside what a motion does not show, what it hardly shows "
            "may be wrong by far more than its error. Log motion along and about all three axes"
        )
    return [*lines, *_physics(found)]


def _forces(found: Found) -> str:
    if all(s.reported for s in found.sources):
        return "forces as the drives report them"
    return "forces as sent, late by what the configuration says of the delay"


def _physics(found: Found) -> list[str]:
    lines = []
    if found.whole.smallest <= 0.0:
        lines.append(
            "Least squares alone gave what no body has (pseudo-inertia not positive definite); the nearest "
            f"body is printed, {found.whole.shift:.1f} standard errors away"
        )
    if found.payload is None:
        words = "No payload beyond what section platform has; the ten parameters of all of it follow"
        return [*lines, words, *_ranges_lost(found)]
    if found.split:
        body = body_of(found.theta[:SIZE] - found.believed[:SIZE])
        x, y, z = body.com
        lines.append(f"Payload {body.mass:.2f} kg at ({x:.4f}, {y:.4f}, {z:.4f}) m of the platform")
        if found.payload.smallest <= 0.0:
            lines.append(
                "By least squares alone the difference to the platform is no body; the nearest payload is "
                f"printed, {found.payload.shift:.1f} standard errors away"
            )
        return [*lines, *_ranges_doubled(found)]
    more = found.theta[0] - found.believed[0]
    lines.append(
        f"{more:.2f} kg more than believed, but no payload alone explains the rest (the nearest one is "
        f"{found.payload.shift:.1f} standard errors away, allowed: {SURE:g}): the figures of the platform "
        "itself are off, and all ten parameters follow"
    )
    return [*lines, *_ranges_lost(found)]


def _ranged(found: Found) -> list[str]:
    settings = found.sources[0].configuration.platform.platform
    return [shown_ranges(body) for body in settings.payload if body.ranged]


def _ranges_lost(found: Found) -> list[str]:
    """Say that a payload's ranges are not in a block of the whole platform."""
    return [
        f"The block has no payload: state the ranges of {words} anew beside it, or check, stability and "
        "safety allow for them no longer"
        for words in _ranged(found)
    ]


def _ranges_doubled(found: Found) -> list[str]:
    """Say that what was found may be the payload that is known by ranges."""
    return [
        f"The payload known by ranges, {words}, stays in the block, and this one comes on top: if it is that "
        "very payload, give it the sum as mass_kg and com_m instead"
        for words in _ranged(found)
    ]
