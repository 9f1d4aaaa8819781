"""The block for the configuration that `hil identify payload` prints: what is known now, not before."""

from typing import Any

import numpy as np
import yaml

from drivers.arrays import Array
from hil.app.configuration.platform import frame_axes
from hil.app.files import printable
from hil.config.platform import PayloadSettings
from hil.lab.identify.estimators.rigid_body import SIZE, body_of
from hil.lab.identify.payload import DRIVES, HIDDEN, LEAST_PAYLOAD, SURE, Found, drives_of, ranged_body
from hil.robot.geometry import Body
from hil.robot.inertia import turned

DIGITS = 1e-7
"""Of the largest element: figures are rounded to that, and a tensor is kept as far from being none."""
SIGNIFICANT = 2.0
"""Standard errors, rms over the legs, from which friction and reflected masses are not zero."""
READ_AS: dict[str, Any] = {
    "shape": None,
    "frame": {"origin_m": [0.0, 0.0, 0.0], "rotation_vector_deg": [0.0, 0.0, 0.0]},
    "inertia_about": {"point_m": None, "rotation_vector_deg": [0.0, 0.0, 0.0]},
    "products": "negative_integral",
}
"""How the figures of a body in the block are read, whatever the section says."""
REMARK = "# Made by hil identify payload: paste into the configuration, in the place of these keys.\n"


def block(found: Found) -> dict[str, Any]:
    """Return the keys to paste: the body where it is shown and another, and the drives' part of the model."""
    c = found.sources[0].configuration
    result: dict[str, Any] = {}
    if body_shown(found) and body_differs(found):
        result["platform"] = {"platform": _body(found)}
    believed = c.controller.believed
    if believed is not None:
        model = _drives(found)
        if found.reflected_kg is not None:
            model["reflected_mass_kg"] = 6 * [found.reflected_kg]
        if believed.inertia_scale != 1.0:
            if body_shown(found):
                model["inertia_scale"] = 1.0
            elif "reflected_mass_kg" in model:  # the scale stays, and is of these, too
                model["reflected_mass_kg"] = [
                    float(f"{m / believed.inertia_scale:.5g}") for m in model["reflected_mass_kg"]
                ]
        result["controller"] = {"model": model}
    return result


def body_shown(found: Found) -> bool:
    """Tell whether the motion shows all ten parameters of the body."""
    return bool((found.estimate.unknown[:SIZE] <= HIDDEN).all())


def body_differs(found: Found) -> bool:
    """Tell whether the body is another one than section `platform` has."""
    e = found.estimate
    change = np.abs(found.theta - found.believed)[:SIZE]
    return bool((change > np.maximum(SURE * e.std, LEAST_PAYLOAD * e.scale)[:SIZE]).any())


def _body(found: Found) -> dict[str, Any]:
    """Return section `platform.platform`: with one more payload, or with that of the ranges; else its own."""
    c = found.sources[0].configuration
    payload = c.platform.platform.payload
    if not found.split:
        own = body_keys(body_of(found.theta[:SIZE])) | READ_AS
        return {**own, "payload": []} if payload else own
    known = [b.model_dump(mode="json", exclude_defaults=True) for b in payload if not b.ranged]
    body, ranged = body_of(found.theta[:SIZE] - found.carrier), ranged_body(c)
    return {"payload": [*known, body_keys(body) if ranged is None else _in_ranges(ranged, body)]}


def _in_ranges(ranged: PayloadSettings, body: Body) -> dict[str, Any]:
    """Return the body in the frame of the one that is known by ranges, with these, wide enough for it."""
    R, origin = frame_axes(ranged.frame)
    keys = body_keys(Body(body.mass, R.T @ (body.com - origin), turned(body.inertia, R.T)))
    if ranged.mass_range_kg is not None:
        keys["mass_range_kg"] = _widened(ranged.mass_range_kg, keys["mass_kg"])
    if ranged.com_range_m is not None:
        keys["com_range_m"] = [
            _widened(within, x) for within, x in zip(ranged.com_range_m, keys["com_m"], strict=True)
        ]
    frame = ranged.frame.model_dump(mode="json", exclude_defaults=True)
    return {**keys, "frame": frame} if frame else keys


def _widened(within: tuple[float, float], value: float) -> list[float]:
    return [min(within[0], value), max(within[1], value)]


def body_keys(body: Body) -> dict[str, Any]:
    """Return mass_kg, com_m and inertia_kg_m2 of a body, rounded so that it stays one."""
    return {
        "mass_kg": float(f"{body.mass:.7g}"),
        "com_m": [round(float(x), 7) for x in body.com],
        "inertia_kg_m2": _rounded(_thickened(body.inertia)).tolist(),
    }


def _thickened(inertia: Array) -> Array:
    """Return the tensor of a body that is not thinner about its centre of mass than the rounding."""
    values, vectors = np.linalg.eigh(0.5 * np.trace(inertia) * np.eye(3) - inertia)
    values = np.maximum(values, 10.0 * DIGITS * max(float(values.max()), DIGITS))
    return np.asarray(values.sum() * np.eye(3) - vectors @ np.diag(values) @ vectors.T, np.float64)


def _rounded(x: Array) -> Array:
    unit = 10.0 ** np.floor(np.log10(DIGITS * np.abs(x).max()))
    rounded = np.round(np.round(x / unit) * unit, 12)
    return np.asarray(0.5 * (rounded + rounded.T) + 0.0, np.float64)


def _drives(found: Found) -> dict[str, Any]:
    """Return the drives' keys that the motion shows of every leg, none negative.

    Friction within two standard errors of zero is none. Motors are alike: their reflected masses are zero
    together, or none is.
    """
    keys: dict[str, Any] = {}
    for key, at in DRIVES.items():
        value, std = drives_of(found).get(key, (None, None))
        if value is None or std is None or (found.estimate.unknown[at : at + 6] > HIDDEN).any():
            continue
        sure = value > SIGNIFICANT * std
        if key == "reflected_mass_kg":
            sure[:] = np.sum((value / std) ** 2) > len(value) * SIGNIFICANT**2
        keys[key] = [float(f"{v:.5g}") for v in np.where(sure, np.maximum(value, 0.0), 0.0)]
    return keys


def block_text(found: Found) -> str:
    """Return the block as YAML; nothing where all is as believed."""
    keys = block(found)
    return yaml.safe_dump(keys, sort_keys=False, default_flow_style=None, width=110) if keys else ""


def file_text(found: Found) -> str:
    """Return the file of `-o`."""
    logs = "".join(f"# {printable(s.path)}\n" for s in found.sources)
    return REMARK + logs + block_text(found)
