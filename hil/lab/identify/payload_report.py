"""What `hil identify payload` prints beside the block."""

from collections.abc import Iterator
from typing import Any

import numpy as np

from drivers.arrays import Array
from hil.app.configuration.payload_box import shown_ranges
from hil.config.platform import PayloadSettings
from hil.lab.identify.estimators.leg_equations import LATE
from hil.lab.identify.estimators.rigid_body import NAMES, SIZE, UNITS, body_of
from hil.lab.identify.payload import HIDDEN, LEAST_PAYLOAD, SURE, Found, drives_of, ranged_body
from hil.lab.identify.payload_block import block, body_differs, body_shown

POOR = 0.05
"""Residual, of the leg forces, from which the figures are doubted."""


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
    drives = drives_of(found)
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
        "platform": _plain(found.theta[:SIZE]),
        "payload": _plain(found.theta[:SIZE] - found.carrier) if found.split else None,
        **{key: value.tolist() for key, (value, _) in drives.items()},
        **{f"{key}_std": std.tolist() for key, (_, std) in drives.items()},
        "reflected_mass": "identified" if found.reflected_kg is None else "given",
        "late_ms": 1e3 * float(found.theta[LATE]),
        "late_std_ms": 1e3 * float(e.std[LATE]),
        "condition": e.condition,
        "not_shown": unseen(found),
        "least_squares_is_a_body": found.whole.smallest > 0.0,
        "payload_alone_is_a_body": None if found.payload is None else found.payload.smallest > 0.0,
        "residual_N": e.residual_N.tolist(),
        "believed_residual_N": found.rms_believed_N,
        "believed_leaves_out_inertia_scale": believed_scale(found),
        "forces_N": found.rms_force_N,
        "held_out_N": {name: list(pair) for name, pair in found.held_out.items()},
        "block": block(found),
    }


def _plain(theta: Array) -> dict[str, Any]:
    body = body_of(theta)
    return {
        "mass_kg": body.mass, "com_m": body.com.tolist(), "inertia_kg_m2": body.inertia.tolist()
    }  # fmt: skip


def report(found: Found) -> Iterator[str]:
    """Return what the user reads before the block."""
    e, hidden = found.estimate, unseen(found)
    rms = float(np.sqrt(np.mean(e.residual_N**2)))
    reported, seconds = all(s.reported for s in found.sources), sum(s.seconds for s in found.sources)
    forces = "as the drives report them" if reported else "as sent, late by the configured delay"
    yield f"From {seconds:.1f} s with open brakes, {e.samples} instants; forces {forces}"
    yield "Platform with all it carries, about its origin (+- two standard errors):"
    for k, (name, unit) in enumerate(zip(NAMES, UNITS, strict=True)):
        error = f"+- {2.0 * e.std[k]:<8.2g}" if e.unknown[k] <= HIDDEN else "not shown  "
        yield f"  {name:5} {found.theta[k]:11.3f} {error} {unit:7} believed {found.believed[k]:.3f}"
    yield "Drives, leg 0 to 5:"
    for key, (value, std) in drives_of(found).items():
        figures = ", ".join(f"{v:.2f} +- {2.0 * s:.2g}" for v, s in zip(value, std, strict=True))
        yield f"  {_WORDS[key]}: {figures}"
    if found.reflected_kg is not None:
        yield f"  reflected mass: {found.reflected_kg:g} kg each, given, not identified"
    late_ms, late_std_ms = 1e3 * found.theta[LATE], 1e3 * e.std[LATE]
    yield f"Forces are {late_ms:.3f} +- {2.0 * late_std_ms:.2g} ms late against the lengths"
    residual = f"Residual {rms:.3g} N rms, {found.rms_believed_N:.3g} N as believed"
    for name, (r, b) in found.held_out.items():
        residual += f"; {name} from the rest {r:.3g} N ({b:.3g} N as believed)"
    yield residual
    scale = believed_scale(found)
    if scale != 1.0:
        yield f"As believed: without the inertia_scale {scale:g} of controller.model"
    if rms > POOR * found.rms_force_N:
        yield (
            f"That is {100.0 * rms / found.rms_force_N:.0f} % of the forces, {100.0 * POOR:g} % are common: "
            "another robot, a load on the platform, or drives that do not make the force they report"
        )
    names = ", ".join(hidden)
    shown = f"not shown about the platform's origin: {names}" if names else "the motion shows every unknown"
    yield f"Condition number {e.condition:.3g}; {shown}"
    yield from _physics(found)


_WORDS = {
    "viscous_friction_N_s_m": "viscous friction, N s/m",
    "coulomb_friction_N": "Coulomb friction, N",
    "reflected_mass_kg": "reflected mass, kg, identified",
}


def believed_scale(found: Found) -> float:
    """Return the scale of all masses that stands beside what is said to be believed; 1: there is none."""
    believed = found.sources[0].configuration.controller.believed
    return 1.0 if believed is None else believed.inertia_scale


def _physics(found: Found) -> Iterator[str]:
    """Return what body that is, and what the block makes of it."""
    payload = found.payload
    for what, fit in (("all of it", found.whole), ("the payload", payload if found.split else None)):
        if fit is not None and fit.smallest <= 0.0:
            yield (
                f"Least squares alone gives {what} what no body has (pseudo-inertia not positive definite); "
                f"the nearest body is printed, {fit.shift:.1f} standard errors away"
            )
    c = found.sources[0].configuration
    ranged = ranged_body(c)
    carrier = "section platform" if ranged is None else "section platform without the one known by ranges"
    if payload is None:
        yield f"No payload beyond what {carrier} has"
    elif found.split:
        body = body_of(found.theta[:SIZE] - found.carrier)
        x, y, z = body.com
        yield f"Payload {body.mass:.2f} kg at ({x:.4f}, {y:.4f}, {z:.4f}) m of the platform"
    else:
        yield (
            f"{found.theta[0] - found.carrier[0]:.2f} kg more than {carrier}, but no payload alone explains "
            f"the rest (the nearest one is {payload.shift:.1f} standard errors away, allowed: {SURE:g}): the "
            "figures of the platform itself are off"
        )
    yield _in_block(found, ranged)


def _in_block(found: Found, ranged: PayloadSettings | None) -> str:
    """Return what the block has of the body, and why."""
    if not body_shown(found):
        return (
            "The block leaves the body out, this motion does not show all of it: log motion along and about "
            "all three axes"
        )
    if not body_differs(found):
        return (
            f"The block leaves the body out: it is that of section platform within {SURE:g} standard errors "
            f"or {100.0 * LEAST_PAYLOAD:g} % of the platform's size"
        )
    if not found.split:
        lost = "" if ranged is None else f"; state the ranges of {shown_ranges(ranged)} again beside it"
        return f"The block has the ten parameters of all of it, in platform axes, and no payload{lost}"
    if ranged is None:
        return "The block has it as one more body"
    wide = block(found)["platform"]["platform"]["payload"][-1]
    before = ranged.model_dump(mode="json", include={"mass_range_kg", "com_range_m"})
    wider = any(wide.get(key, value) != value for key, value in before.items())
    return (
        f"The block has it in the place of {shown_ranges(ranged)}; its ranges stay"
        + ", wide enough for it now: was the range wrong, or is this another payload?" * wider
    )
