"""Report of `hil identify payload`: figures, and the YAML keys to paste into the configuration."""

from collections.abc import Iterator
from typing import Any

import numpy as np
import yaml

from drivers.arrays import Array
from hil.app.configuration.payload_box import shown_ranges
from hil.app.files import printable
from hil.lab.identify.estimators.leg_equations import LATE
from hil.lab.identify.estimators.rigid_body import NAMES, SIZE, UNITS, body_of
from hil.lab.identify.payload import DRIVES, HIDDEN, LEAST_PAYLOAD, SURE, Found, drives_of, ranged_body
from hil.robot.geometry import Body

POOR = 0.05
"""Residual, as a share of the leg forces, above which the figures are doubted."""
DIGITS = 1e-7
"""Rounding unit as a share of the largest element; a tensor stays ten times this from an impossible one."""
SIGNIFICANT = 2.0
"""Standard errors, rms over the legs, above which friction and reflected masses differ from zero."""
READ_AS: dict[str, Any] = {
    "shape": None,
    "frame": {"origin_m": [0.0, 0.0, 0.0], "rotation_vector_deg": [0.0, 0.0, 0.0]},
    "inertia_about": {"point_m": None, "rotation_vector_deg": [0.0, 0.0, 0.0]},
    "products": "negative_integral",
}
"""Keys that define how the body's figures in the block are read; they override those of the section."""
REMARK = "# Made by hil identify payload: paste into the configuration, in the place of these keys.\n"


def block(found: Found) -> dict[str, Any]:
    """Keys to paste: the body if the motion shows it and it differs, and the drives' part of the model."""
    c = found.sources[0].configuration
    result: dict[str, Any] = {}
    if body_shown(found) and body_differs(found):
        result["platform"] = {"platform": _body(found)}
    believed = c.controller.believed
    if believed is not None:
        model = _drives(found)
        if found.reflected_kg is not None:
            model["reflected_mass_kg"] = 6 * [found.reflected_kg]
        if body_shown(found):
            if believed.inertia_scale != 1.0:
                model["inertia_scale"] = 1.0
        elif masses := model.get("reflected_mass_kg"):  # the scale stays, and is of these, too
            model["reflected_mass_kg"] = [float(f"{m / believed.inertia_scale:.5g}") for m in masses]
        result["controller"] = {"model": model}
    return result


def body_shown(found: Found) -> bool:
    """True if the motion determines all ten parameters of the body."""
    return bool((found.estimate.unknown[:SIZE] <= HIDDEN).all())


def body_differs(found: Found) -> bool:
    """True if the identified body differs significantly from section `platform`."""
    e = found.estimate
    change = np.abs(found.theta - found.believed)[:SIZE]
    return bool((change > np.maximum(SURE * e.std, LEAST_PAYLOAD * e.scale)[:SIZE]).any())


def _body(found: Found) -> dict[str, Any]:
    """Section `platform.platform`: its payload with the identified one, or a new body without payload."""
    c = found.sources[0].configuration
    payload = c.platform.platform.payload
    if not found.split:
        own = _body_keys(body_of(found.theta[:SIZE])) | READ_AS
        return {**own, "payload": []} if payload else own
    known = [b.model_dump(mode="json", exclude_defaults=True) for b in payload if not b.ranged]
    return {"payload": [*known, _body_keys(body_of(found.theta[:SIZE] - found.carrier))]}


def _body_keys(body: Body) -> dict[str, Any]:
    """mass_kg, com_m and inertia_kg_m2 of a body, rounded so that the body stays physically possible."""
    return {
        "mass_kg": float(f"{body.mass:.7g}"),
        "com_m": [round(float(x), 7) for x in body.com],
        "inertia_kg_m2": _rounded(_thickened(body.inertia)).tolist(),
    }


def _thickened(inertia: Array) -> Array:
    """Inertia tensor (3, 3) about the centre of mass, thick enough to stay possible after rounding."""
    values, vectors = np.linalg.eigh(0.5 * np.trace(inertia) * np.eye(3) - inertia)
    values = np.maximum(values, 10.0 * DIGITS * max(float(values.max()), DIGITS))
    return np.asarray(values.sum() * np.eye(3) - vectors @ np.diag(values) @ vectors.T, np.float64)


def _rounded(x: Array) -> Array:
    unit = 10.0 ** np.floor(np.log10(DIGITS * np.abs(x).max()))
    rounded = np.round(np.round(x / unit) * unit, 12)
    return np.asarray(0.5 * (rounded + rounded.T) + 0.0, np.float64)


def _drives(found: Found) -> dict[str, Any]:
    """Drive keys of `controller.model` that the motion determines for every leg, without negative values.

    Friction within two standard errors of zero is set to zero. Motors are alike: their reflected masses are
    all zero or none is.
    """
    keys: dict[str, Any] = {}
    for key, (value, std) in drives_of(found).items():
        at = DRIVES[key][0]
        if (found.estimate.unknown[at : at + 6] > HIDDEN).any():
            continue
        sure = value > SIGNIFICANT * std
        if key == "reflected_mass_kg":
            sure[:] = np.sum((value / std) ** 2) > len(value) * SIGNIFICANT**2
        keys[key] = [float(f"{v:.5g}") for v in np.where(sure, np.maximum(value, 0.0), 0.0)]
    return keys


def block_text(found: Found) -> str:
    """The keys to paste as YAML; empty if everything is as configured."""
    keys = block(found)
    return yaml.safe_dump(keys, sort_keys=False, default_flow_style=None, width=110) if keys else ""


def file_text(found: Found) -> str:
    """Content of the file that option `-o` writes: remark, logs, and the keys to paste."""
    logs = "".join(f"# {printable(s.path)}\n" for s in found.sources)
    return REMARK + logs + block_text(found)


def unseen(found: Found) -> list[str]:
    """Names of the parameters that the motion does not determine."""
    names = dict(enumerate(NAMES)) | {LATE: "delay of the forces"}
    parts = [DRIVES[key] for key in drives_of(found)]
    names |= {at + k: f"{what} of leg {k}" for at, what, _ in parts for k in range(6)}
    return [names[k] for k in np.flatnonzero(found.estimate.unknown > HIDDEN).tolist() if k in names]


def summary(found: Found) -> dict[str, Any]:
    """Identified parameters and their uncertainties as plain values for the JSON summary."""
    e = found.estimate
    drives = drives_of(found)
    return {
        "success": True,
        "kind": "identify",
        "logs": [str(s.path) for s in found.sources],
        "forces": ["commanded" if s.sent else "reported" for s in found.sources],
        "seconds": sum(s.seconds for s in found.sources),
        "samples": e.samples,
        "parameters": dict(zip(NAMES, found.theta[:SIZE].tolist(), strict=True)),
        "parameters_std": dict(zip(NAMES, e.std[:SIZE].tolist(), strict=True)),
        "parameters_believed": dict(zip(NAMES, found.believed[:SIZE].tolist(), strict=True)),
        "platform": _body_keys(body_of(found.theta[:SIZE])),
        "payload": _body_keys(body_of(found.theta[:SIZE] - found.carrier)) if found.split else None,
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


def report(found: Found) -> Iterator[str]:
    """Lines of text about the identified parameters, printed before the keys to paste."""
    e, hidden = found.estimate, unseen(found)
    rms = float(np.sqrt(np.mean(e.residual_N**2)))
    sent, seconds = any(s.sent for s in found.sources), sum(s.seconds for s in found.sources)
    forces = "as sent, late by the configured delay" if sent else "as the drives report them"
    yield f"From {seconds:.1f} s with open brakes, {e.samples} instants; forces {forces}"
    yield "Platform with all it carries, about its origin (+- two standard errors):"
    for k, (name, unit) in enumerate(zip(NAMES, UNITS, strict=True)):
        error = f"+- {2.0 * e.std[k]:<8.2g}" if e.unknown[k] <= HIDDEN else "not shown  "
        yield f"  {name:5} {found.theta[k]:11.3f} {error} {unit:7} configured {found.believed[k]:.3f}"
    yield "Drives, leg 0 to 5:"
    for key, (value, std) in drives_of(found).items():
        figures = ", ".join(f"{v:.2f} +- {2.0 * s:.2g}" for v, s in zip(value, std, strict=True))
        _, what, unit = DRIVES[key]
        yield f"  {what}, {unit}: {figures}"
    if found.reflected_kg is not None:
        yield f"  reflected mass, kg: {found.reflected_kg:g} each, given"
    late_ms, late_std_ms = 1e3 * found.theta[LATE], 1e3 * e.std[LATE]
    yield f"Forces are {late_ms:.3f} +- {2.0 * late_std_ms:.2g} ms late against the lengths"
    residual = f"Residual {rms:.3g} N rms, {found.rms_believed_N:.3g} N as configured"
    for name, (r, b) in found.held_out.items():
        residual += f"; {name} from the rest {r:.3g} N ({b:.3g} N as configured)"
    yield residual
    scale = believed_scale(found)
    if scale != 1.0:
        yield f"As configured: without the inertia_scale {scale:g} of controller.model"
    if rms > POOR * found.rms_force_N:
        yield (
            f"That is {100.0 * rms / found.rms_force_N:.0f} % of the forces, {100.0 * POOR:g} % are common: "
            "another robot, a load on the platform, or drives that report a wrong force"
        )
    names = ", ".join(hidden)
    shown = f"not shown about the platform's origin: {names}" if names else "the motion shows every unknown"
    yield f"Condition number {e.condition:.3g}; {shown}"
    yield from _physics(found)


def believed_scale(found: Found) -> float:
    """Configured `controller.model.inertia_scale`, which scales all masses of the law's model; 1: unset."""
    believed = found.sources[0].configuration.controller.believed
    return 1.0 if believed is None else believed.inertia_scale


def _physics(found: Found) -> Iterator[str]:
    """Lines of text: whether the identified bodies are physically possible, and what to paste."""
    payload = found.payload
    for what, fit in (("all of it", found.whole), ("the payload", payload if found.split else None)):
        if fit is not None and fit.smallest <= 0.0:
            yield (
                f"Least squares alone gives {what} an impossible inertia; the nearest possible body is "
                f"printed, {fit.shift:.1f} standard errors away"
            )
    ranged = ranged_body(found.sources[0].configuration)
    ranges = "" if ranged is None else shown_ranges(ranged)
    carrier = "section platform" + f" without {ranges}" * bool(ranges)
    if payload is None:
        yield f"No payload in addition to {carrier}"
    elif found.split:
        body = body_of(found.theta[:SIZE] - found.carrier)
        x, y, z = body.com
        yield f"Payload {body.mass:.2f} kg at ({x:.4f}, {y:.4f}, {z:.4f}) m of the platform"
    else:
        yield (
            f"{found.theta[0] - found.carrier[0]:.2f} kg more than {carrier}, but no payload alone explains "
            f"the rest (the nearest one is {payload.shift:.1f} standard errors away, allowed: {SURE:g}): the "
            "data of the platform itself are wrong"
        )
    if not body_shown(found):
        yield "The block leaves the body out: log motion along and about all three axes to show all of it"
    elif not body_differs(found):
        size = f"{SURE:g} standard errors or {100.0 * LEAST_PAYLOAD:g} % of the platform's size"
        yield f"The block leaves the body out: it equals section platform within {size}"
    else:
        whole = "the ten parameters of the whole, in platform axes, and no payload"
        lost = f"; state the ranges of {ranges} again next to it" if ranges else ""
        yield f"The block has {'it as one more body' if found.split else whole}{lost}"
