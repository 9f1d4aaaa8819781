"""`hil identify sensors`: frame, lever arm, time offset, offset and scale of sensors from a log of a run."""

from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import yaml
from scipy.spatial.transform import Rotation

from drivers.arrays import Array, Rows
from drivers.errors import HilError, IdentificationError
from drivers.sensing.calibration import Calibration
from hil.app.configuration.platform import build_platform
from hil.app.files import printable
from hil.lab.identify.estimators.leg_motion import LegSignals, legs_alone, platform_motion
from hil.lab.identify.estimators.sensor_fit import Fit, Samples, fit
from hil.lab.identify.estimators.sensor_models import MODELS
from hil.lab.identify.payload import HIDDEN
from hil.lab.identify.runs import SAME_S, brakes_open, episode, recorded_run

COLUMNS = {
    "tracker": "tracker_pose", "imu": "imu", "inclination": "inclination",
    "lengths": "length_sensor", "forces": "force_sensor",
}  # fmt: skip
SMOOTHING_S = 0.03
"""Half window over the lengths; noise of the accelerations would make lever arms of an IMU too short."""
SAME_READING = 1e-9
"""Smallest step between two readings of a drive, as a share of the largest; less is rounding."""
REDUCED = ("imu", "lever_arm_m")
"""Printed only: an IMU is to reduce its readings to the platform's origin by itself."""
REMARK = "# Made by hil identify sensors: paste into the configuration, in the place of these keys.\n"


class Found(NamedTuple):
    """Calibration of each configured sensor of a log."""

    path: Path
    fits: dict[str, Fit]
    refused: dict[str, str]
    """Role -> reason why there is no calibration."""

    def parameters(self, role: str) -> dict[str, tuple[Array, Array, bool]]:
        """{key: (values, standard errors, determined)}, in the unit of the key."""
        parameters, of = MODELS[role].parameters, self.fits[role]
        ends = np.cumsum([each.number for each in parameters])[:-1]
        parts = zip(parameters, *(np.split(x, ends) for x in (of.x, of.std, of.unknown)), strict=True)
        return {p.key: (p.factor * x, p.factor * std, bool((u <= HIDDEN).all())) for p, x, std, u in parts}


def identify_sensors(path: Path) -> Found:
    """Calibrate the sensors of a log of `hil run` or `hil sim` against the pose by the leg lengths.

    Raises LogError for another kind of file or a run that never opened its brakes, IdentificationError if no
    sensor can be calibrated.
    """
    recorded = recorded_run(path)
    c, period = recorded.configuration, 1.0 / recorded.rate_Hz
    try:
        brakes_open(recorded.rows)
        rows, p, R, good = episode(recorded.rows)
        length, late_s = _at_one_instant(rows, period)
        force = np.ascontiguousarray(rows["drive_force"])
        signals = LegSignals(period, length, length, force, p, R, good & brakes_open(rows))
        motion = platform_motion(build_platform(c.platform), signals, SMOOTHING_S)
        legs = legs_alone(motion, signals)
    except HilError as error:
        raise type(error)(f"{path}: {error}") from None
    reading = {"lengths": rows["q"], "forces": force}
    fits, refused = {}, {}
    for role, settings in c.sensors:
        if settings is None:
            continue
        if role not in MODELS:
            refused[role] = "the pose of the legs does not show its load"
        elif role == "forces" and not force.any():
            refused[role] = "the drives do not report their forces"
        else:
            samples = samples_of(rows, COLUMNS[role], settings.calibration, period, late_s)
            seen, against = (legs, reading[role]) if role in reading else (motion, None)
            try:
                found = fit(MODELS[role], seen, period, samples, np.array(c.platform.gravity_m_s2))
                fits[role] = found if against is None else _with_half_steps(found, against)
            except IdentificationError as error:
                refused[role] = str(error)
    if not fits:
        why = "; ".join(f"{role}: {text}" for role, text in refused.items()) or "section sensors is empty"
        raise IdentificationError(f"{path}: no sensor to calibrate: {why}")
    return Found(path, fits, refused)


def _at_one_instant(rows: Rows, period_s: float) -> tuple[Array, float]:
    """Lengths (n, 6) of all legs at one instant of each tick, and its time in s after the first encoder."""
    t, latch_s = np.arange(len(rows)) * period_s, 1e-9 * rows["latch_ns"]
    first_s = np.where(latch_s > 0.0, latch_s, np.inf).min(axis=1, keepdims=True)  # 0: not known
    latch_s = np.maximum(latch_s - np.where(np.isfinite(first_s), first_s, 0.0), 0.0)
    late_s = float(latch_s.mean())
    legs = [np.interp(t + late_s, t + latch_s[:, k], rows["q"][:, k]) for k in range(latch_s.shape[1])]
    return np.ascontiguousarray(np.array(legs).T), late_s


def _with_half_steps(of: Fit, readings: Array) -> Fit:
    """A fit of scales and offsets, whose standard errors count that drives may truncate readings (n, 6).

    Makers truncate or round; truncation shifts all readings by half a step, which no residual shows.
    """
    std = of.std.copy()
    for leg in range(readings.shape[1]):
        steps = np.diff(np.unique(readings[:, leg]))
        least = steps[steps > SAME_READING * np.abs(readings[:, leg]).max()].min(initial=np.inf)
        half = 0.5 * least if np.isfinite(least) else 0.0
        std[leg - 6] = np.hypot(std[leg - 6], half)
    return of._replace(std=std)


def samples_of(rows: Rows, column: str, of: Calibration, period_s: float, late_s: float) -> Samples:
    """Samples in a column of a log without gaps, without the calibration of the log's own configuration.

    A row where any device has a new one. late_s: from the first encoder, which ages refer to, to the motion.
    """
    age_s = rows[column.removesuffix("_pose") + "_age"].reshape(len(rows), -1)
    t = np.arange(len(rows))[:, None] * period_s - late_s - age_s
    new = np.isfinite(t)
    with np.errstate(invalid="ignore"):
        new[1:] &= ~(np.abs(np.diff(t, axis=0)) < SAME_S)
    there = new.any(axis=1)
    t = np.where(new, t + 1e-3 * of.time_offset_ms, np.nan)[there]
    return Samples(_readings(np.asarray(rows[column], np.float64)[there], of, t.shape[1]), t)


def _readings(values: Array, of: Calibration, devices: int) -> Array:
    """Readings (m, k) of devices before the correction `of` made them `values`."""
    readings = values.copy()
    for leg in range(devices):
        columns = [leg] if devices > 1 else [*range(values.shape[1])]
        c, v = of.correction(leg), values[:, columns]
        if c.placed:
            R = Rotation.from_rotvec(v[:, 3:])
            turned = Rotation.from_matrix(c.frame.T) * R * Rotation.from_matrix(c.target.T)
            v = np.hstack([v[:, :3] + R.apply(c.lever), turned.as_rotvec()])
        for k in range(0, len(columns), 3):  # a device may lack one of two triples
            part = slice(k, min(k + 3, len(columns)))
            readings[:, columns[part]] = (v[:, part] - c.shift[part]) @ np.linalg.inv(c.mix[part, part]).T
    return readings


def _plain(x: Array) -> Any:
    values = [float(f"{each:.9g}") for each in x]
    return values[0] if len(values) == 1 else values


def block_text(found: Found) -> str:
    """Keys to paste, YAML: section `calibration` of each sensor, with all that the motion determines."""
    keys: dict[str, Any] = {}
    for role in found.fits:
        of = found.parameters(role).items()
        known = {key: _plain(x) for key, (x, _, shown) in of if shown and (role, key) != REDUCED}
        if known:
            keys[role] = {"calibration": known}
    block = {"sensors": keys}
    return yaml.safe_dump(block, sort_keys=False, default_flow_style=None, width=110) if keys else ""


def file_text(found: Found) -> str:
    """Content of the file that option `-o` writes: remark, log, and the keys to paste."""
    return f"{REMARK}# {printable(found.path)}\n{block_text(found)}"


def summary(found: Found) -> dict[str, Any]:
    """Calibrations with their standard errors as plain values for the JSON summary."""
    sensors = {
        role: {
            key: {"value": _plain(x), "std": _plain(std), "determined": shown}
            for key, (x, std, shown) in found.parameters(role).items()
        }
        | {"samples": of.used, "left_out": of.left_out}
        for role, of in found.fits.items()
    }
    plain = {"success": True, "kind": "identify", "log": str(found.path)}
    return plain | {"sensors": sensors, "refused": found.refused}


def report(found: Found) -> list[str]:
    """Lines of text: each parameter with two standard errors, or that this motion does not determine it."""
    lines = []
    for role, of in found.fits.items():
        lines.append(f"{role}: {of.used} samples, {of.left_out} outliers left out (+- two standard errors)")
        units = {each.key: each.unit for each in MODELS[role].parameters}
        for key, (x, std, shown) in found.parameters(role).items():
            figures = ", ".join(f"{a:.5g} +- {2.0 * s:.2g}" for a, s in zip(x, std, strict=True))
            text = f"{figures} {units[key]}".strip() if shown else "not determined by this motion"
            lines.append(f"  {key:<24} {text}")
    return [*lines, *(f"{role}: not calibrated: {why}" for role, why in found.refused.items())]
