"""`hil calibrate CONFIG POSES.csv`: joint centres and length offsets from measured poses and leg lengths."""

import csv
import io
import json
import math
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from drivers.arrays import Array
from drivers.errors import ConfigurationError
from drivers.files import read_regular
from hil.app.configuration.configuration import Configuration, load
from hil.app.configuration.platform import build_platform
from hil.app.files import made_whole, new_file
from hil.app.output import further
from hil.config.number import ALLOWED, is_allowed, plain_number
from hil.config.values import AXES
from hil.lab.calibrate.fit import (
    NAMES,
    WEAK,
    Calibration,
    Combination,
    Measurements,
    calibrate,
    predicted,
    start_offsets,
    suspicion,
)
from hil.robot.geometry import Platform

LENGTHS = ("l1_m", "l2_m", "l3_m", "l4_m", "l5_m", "l6_m")
"""Columns of leg lengths, in the order of the joint lists."""
DEVIATIONS = ("length_std_m", "position_std_m", "rotation_std_deg")
"""Optional columns: standard deviations of each length, coordinate and angle in the row."""
OUTLIER = 5.0
"""A residual beyond this many standard deviations is reported as an outlier."""
DOUBT = 1e-3
"""Probability of chi-square in either tail below which a report calls the given deviations wrong."""
REACH = 0.1
"""A reading is refused if it differs from the length at its pose by more than this share of that length."""
FRAMES = (
    "Joints are in the frames of the measured poses: these define base and platform frame. An error of "
    "either frame against the machine moves all its joints together and cannot be determined here."
)


class Report(NamedTuple):
    """Result of a calibration: lines of text, plain values, and a YAML fragment with the joints."""

    lines: list[str]
    figures: dict[str, Any]
    fragment: str


def run_calibration(path: str | Path, poses: Path, out: Path | None = None) -> Report:
    """Fit the geometry to the CSV file `poses`, and write the YAML fragment to the new file `out`.

    Raises ConfigurationError (configuration, CSV file, units, poses out of reach), CalibrationError (too few
    pairs, no convergence), LogError (`out`). If writing fails at the end, the error is in the figures.
    """
    if out is not None:
        new_file(out)
    configuration = load(path)
    measured, at = read_pairs(poses)
    robot = build_platform(configuration.platform)
    _refuse_strange(configuration, robot, measured, poses, at)
    fit = calibrate(robot, measured)
    report = describe(configuration, robot, measured, poses, at, fit)
    if out is not None:
        with further(report.figures), made_whole(out, overwrite=False) as file:
            file.write_text(report.fragment, encoding="utf-8")
    return report


def read_pairs(path: Path) -> tuple[Measurements, list[int]]:
    """Read the CSV file, columns in any order; return the measurements and the line number of each row.

    Raises ConfigurationError with each problem as `file:line`.
    """
    try:
        reader = csv.reader(io.StringIO(read_regular(path).decode("utf-8-sig"), newline=""))
        header = [word.strip() for word in next(reader, [])]
        lines = [(reader.line_num, words) for words in reader if any(word.strip() for word in words)]
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise ConfigurationError(f"{path}: cannot be read as a CSV file: {error}") from None
    wrong = [f"{path}:1: {problem}" for problem in _header_problems(header)] or [
        f"{path}:{number}: {text}" for number, words in lines if (text := _row_problem(header, words))
    ]
    if not wrong and not lines:
        wrong = [f"{path}: no rows, allowed: at least 8 poses"]
    if wrong:
        raise ConfigurationError(*wrong)
    table = np.array([list(map(plain_number, words)) for _, words in lines])
    columns = dict(zip(header, table.T, strict=True))
    measured = Measurements(
        p=np.stack([columns[name] for name in AXES[:3]], axis=1),
        rotation_vector=np.deg2rad(np.stack([columns[name] for name in AXES[3:]], axis=1)),
        q=np.stack([columns[name] for name in LENGTHS], axis=1),
        length_std=columns.get("length_std_m"),
        position_std=columns.get("position_std_m", 0.0),
        rotation_std=np.deg2rad(columns.get("rotation_std_deg", 0.0)),
    )
    return measured, [number for number, _ in lines]


def _header_problems(header: list[str]) -> list[str]:
    needed, given = (*AXES, *LENGTHS), set(header)
    found = [f"column {name} is missing, needed: {','.join(needed)}" for name in needed if name not in given]
    for name in sorted(given):
        if name not in (*needed, *DEVIATIONS) or header.count(name) > 1:
            found.append(f"column {name!r}, allowed, each once: {','.join((*needed, *DEVIATIONS))}")
    if "length_std_m" not in given and not given.isdisjoint(DEVIATIONS):
        found.append("deviations of the poses need length_std_m, too, for their weight against a length")
    return found


def _row_problem(header: list[str], words: list[str]) -> str:
    if len(words) != len(header):
        return f"{len(words)} values, allowed: {len(header)}, one for each column"
    values = dict(zip(header, map(plain_number, words), strict=True))
    for (name, number), word in zip(values.items(), words, strict=True):
        positive = name in LENGTHS or name == "length_std_m"
        if not (math.isfinite(number) and is_allowed(number)):
            return f"{name}: allowed: a finite number, in size {ALLOWED}, given: {word.strip()!r:.60}"
        if (positive and number <= 0) or (name in DEVIATIONS and number < 0):
            return f"{name}: allowed: {'greater than' if positive else 'at least'} 0, given: {number:g}"
    angle = math.hypot(*(values[name] for name in AXES[3:]))
    if angle > 180 * (1 + 1e-12):
        return f"rotation vector of {angle:g} deg, allowed: at most half a turn, 180 deg"
    return ""


def _refuse_strange(
    c: Configuration, robot: Platform, measured: Measurements, poses: Path, at: list[int]
) -> None:
    """Refuse readings in another unit or of another robot: a fit would distort the joints."""
    guess = suspicion(robot, measured)
    if guess is not None:
        raise ConfigurationError(f"{poses}: lengths and poses do not match; they would match if {guess}")
    expected = predicted(robot, measured)
    away = measured.q - start_offsets(robot, measured) - expected
    low, high = c.platform.length_min_m, c.platform.length_max_m
    beyond = np.maximum(low - expected, expected - high)
    found = []
    for row, leg in np.argwhere(np.abs(away) > REACH * expected):
        q = measured.q[row, leg]
        text = f"{LENGTHS[leg]} is {q:.4f}, but at this pose it should be {q - away[row, leg]:.4f}"
        found.append(f"{poses}:{at[row]}: {text} (configured joints, offset of the other rows)")
    for row in np.flatnonzero(beyond.max(axis=1) > REACH * (high - low)):
        leg = int(np.argmax(beyond[row]))
        text = f"the pose needs {expected[row, leg]:.4f} m of {_leg(leg)}, stroke {low:g} to {high:g} m"
        found.append(f"{poses}:{at[row]}: out of reach: {text}")
    if found:
        raise ConfigurationError(*found[:10], *[f"{poses}: and {len(found) - 10} more"][: len(found) > 10])


def describe(
    c: Configuration, robot: Platform, measured: Measurements, poses: Path, at: list[int], fit: Calibration
) -> Report:
    """Report on a fit: changes, uncertainties, undetermined parameters; at: CSV line of each pose."""
    n = len(at)
    before = measured.q - predicted(robot, measured)
    before = before - before.mean(axis=0)
    rms, rms_before = (1e3 * float(np.sqrt(np.mean(e**2))) for e in (fit.residuals, before))
    row, leg = (int(i) for i in np.unravel_index(np.argmax(np.abs(fit.residuals)), fit.residuals.shape))
    largest = f"{poses.name}:{at[row]} {_leg(leg)}"
    lines = [
        f"calibration of {c.name} from {poses.name}",
        f"  poses        {n}, {6 * n} equations",
        f"  parameters   {6 * n - fit.dof} of 42 determined, {fit.dof} degrees of freedom",
        f"  residuals    rms {rms:.4g} mm (offsets alone fitted: {rms_before:.4g} mm)",
        f"  largest      {1e3 * fit.residuals[row, leg]:.4g} mm at {largest}",
    ]
    if fit.chi_square is None:
        lines.append(f"  reading      standard deviation {1e3 * fit.sigma:.4g} mm, from the residuals")
    else:
        lines.append(f"  chi-square   {fit.chi_square:.1f} for {fit.dof} (p {fit.p_value:.3g})")
    lines += _table(robot, fit)
    lines += ["frames", f"  {FRAMES}"]
    warnings = list(_warnings(poses, at, fit))
    lines += [f"warning: {w}" for w in warnings]
    return Report(lines, _figures(c, poses, fit, rms, rms_before, warnings), _fragment(c, poses, fit, rms, n))


def _table(robot: Platform, fit: Calibration) -> Iterator[str]:
    """Lines with changes in mm and their standard deviations, two per leg."""
    change = np.hstack([
        fit.base_joints - robot.base_joints, fit.platform_joints - robot.platform_joints, fit.offsets[:, None]
    ])  # fmt: skip
    yield "changes and offsets, mm (+- one standard deviation; ? not determined)"
    yield "        base x     y       z     platform x  y       z      offset"
    for leg in range(6):
        yield f"  {_leg(leg)}  " + " ".join(f"{1e3 * x:8.3f}" for x in change[leg])
        yield "   +-" + " ".join(f"{1e3 * s:8.3f}" if s == s else f"{'?':>8}" for s in fit.std[leg])  # noqa: PLR0124


def _warnings(poses: Path, at: list[int], fit: Calibration) -> Iterator[str]:
    legs: dict[str, list[int]] = {}
    for leg in range(6):
        if lost := sorted(_sum(x) for x in fit.undetermined if x.leg == leg):
            legs.setdefault("; ".join(lost), []).append(leg)
    for names, where in legs.items():
        yield (
            f"{', '.join(map(_leg, where))}: not observable with these poses: {names}. In these directions "
            f"the joints stay as configured. {_advice([x for x in fit.undetermined if x.leg in where])}"
        )
    if weak := _weak(fit):
        each = "; ".join(f"{leg}: {', '.join(names)}" for leg, names in weak.items())
        yield (
            f"weak, uncertain by more than {1e3 * WEAK:g} mm: {each}. Measure poses further apart, tilted "
            "about all axes. Lengths and poses close to the measured ones are better known than these"
        )
    if fit.p_value is not None and fit.chi_square is not None and not DOUBT < fit.p_value < 1 - DOUBT:
        yield (
            f"residuals are {math.sqrt(fit.chi_square / fit.dof):.2f} times the given standard deviations, "
            "which is not chance: the deviations in the file are wrong, or the robot is not ideal (joint "
            "play, bending)"
        )
    for row, leg in np.argwhere(np.abs(fit.standardised) > OUTLIER)[:10]:
        yield (
            f"{poses.name}:{at[row]}: {_leg(leg)} is {abs(fit.standardised[row, leg]):.1f} standard "
            "deviations off: possible outlier, check this measurement"
        )


def _weak(fit: Calibration) -> dict[str, list[str]]:
    """Names of the parameters of each leg, `l1` to `l6`, with a standard deviation above WEAK."""
    names = {_leg(leg): [NAMES[k] for k in np.flatnonzero(fit.std[leg] > WEAK)] for leg in range(6)}
    return {leg: some for leg, some in names.items() if some}


def _advice(lost: list[Combination]) -> str:
    names = {name for x in lost for name in x.coefficients}
    if any("offset" in x.coefficients for x in lost):
        return "An offset acts like joints further apart along the leg: measure longer and shorter legs."
    if any(n.startswith("base") for n in names) and any(n.startswith("platform") for n in names):
        return "Base and platform joint move together: measure poses that tilt about all axes."
    return "Measure poses further apart."


def _sum(x: Combination) -> str:
    """A linear combination of parameters as text, e.g. `base x + 0.5 platform x - offset`."""
    text = ""
    for name, share in x.coefficients.items():
        sign = "-" if share < 0 else "+"
        factor = "" if abs(abs(share) - 1) < 0.05 else f"{abs(share):.1f} "
        text += f" {sign} {factor}{name}" if text else f"{'-' * (share < 0)}{factor}{name}"
    return text


def _leg(leg: int) -> str:
    return f"l{leg + 1}"


def _figures(
    c: Configuration, poses: Path, fit: Calibration, rms: float, rms_before: float, warnings: list[str]
) -> dict[str, Any]:
    return {
        "configuration": c.name,
        "poses": str(poses),
        "equations": int(fit.residuals.size),
        "degrees_of_freedom": fit.dof,
        "residual_rms_m": rms / 1e3,
        "residual_rms_offsets_alone_m": rms_before / 1e3,
        "residual_max_m": float(np.abs(fit.residuals).max()),
        "reading_std_m": fit.sigma,
        "chi_square": fit.chi_square,
        "p_value": fit.p_value,
        "base_joints_m": fit.base_joints.tolist(),
        "platform_joints_m": fit.platform_joints.tolist(),
        "length_offsets_m": fit.offsets.tolist(),
        "parameters": list(NAMES),
        "std_m": fit.std.tolist(),
        "covariance_m2": fit.covariance.tolist(),
        "undetermined": [{"leg": _leg(x.leg), "coefficients": x.coefficients} for x in fit.undetermined],
        "weak": _weak(fit),
        "weak_std_m": WEAK,
        "warnings": warnings,
    }


def _fragment(c: Configuration, poses: Path, fit: Calibration, rms: float, n: int) -> str:
    """YAML that replaces the joints of the configuration; length offsets are comments, for the drives."""
    lines = [
        f"# Joints of {json.dumps(c.name)}, calibrated from {json.dumps(poses.name)}: {n} poses,",
        f"# residual rms {rms:.4g} mm. In the frames of the measured poses; after each joint the standard",
        "# deviations of x, y, z in mm.",
    ]
    if fit.undetermined:
        lines.append("# ?: not determined by these poses, this part is kept as configured.")
    lines.append("platform:")
    for key, rows, first in (
        ("base_joints_m", fit.base_joints, 0),
        ("platform_joints_m", fit.platform_joints, 3),
    ):
        lines.append(f"  {key}:")
        for leg in range(6):
            joint = ", ".join(f"{x:.7f}" for x in rows[leg])
            lines.append(f"    - [{joint}]  # {_leg(leg)} +- {_deviations(fit.std[leg, first : first + 3])}")
    lines += [
        "# Reading less distance of the joint centres, m; subtract it in the drive of the leg (homing):",
        *(
            f"#   {_leg(leg)} {fit.offsets[leg]:+.7f}  # +- {_deviations(fit.std[leg, 6:])} mm"
            for leg in range(6)
        ),
    ]
    return "\n".join(lines) + "\n"


def _deviations(std: Array) -> str:
    return " ".join("?" if math.isnan(s) else f"{1e3 * s:.3f}" for s in std)
