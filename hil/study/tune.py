"""`hil tune CONFIG`: gains from delay, friction and encoders, within required stability margins."""

from collections.abc import Iterator, Mapping
from itertools import product
from math import hypot, pi, sqrt
from typing import Any, NamedTuple

import numpy as np
from rich.text import Text

from drivers import build_protocol
from drivers.errors import ConfigurationError
from hil.app.configuration.changes import text_of, unattended, with_changes
from hil.app.configuration.configuration import Configuration, loads
from hil.app.configuration.platform import build_platform, pose_arrays
from hil.app.loop_delay import loop_delay, observer_of, stated_delay
from hil.app.new.derive import wn_rad_s
from hil.app.output import show_lines
from hil.app.reachability import span_s
from hil.app.stability.command import SPRINGS, at_home
from hil.app.stability.timing import transport_s
from hil.config.delay import DelayCompensation
from hil.config.reference import LiveReference
from hil.control.law import DesiredLoop
from hil.mathematics.rounding import lowered, rounded
from hil.robot.dynamics import Model
from hil.robot.kinematics import jacobian
from hil.study.compare.laws import changed, desired_loop
from hil.study.compare.measure import Job, measure
from hil.study.table import Column, figure_column, print_rows
from hil.trajectory.build import build_trajectory
from plant_fmu.config import BenchPlant, StewartPlant

PHASE_DEG, GAIN_UP = 45.0, 2.0
"""Least phase margin, and least factor on the loop gain, of tuned gains."""
NOISE_SHARE = 0.01
"""Largest share of `limits.force_N` that the resolution of the encoders may cause, root mean square."""
DAMPING = (1.0, 0.85, 0.7)
OBSERVER = (0.1, 0.2, 0.4)
"""Tried damping ratios, and bandwidths of a configured wrench observer in wn."""
STEPS, SLOWEST = 12, 0.25
"""Bisections of wn between this share of the rule's and the inverse of the delay."""
LOAD_SHARE = 0.1
"""Default of the stated disturbance, as a share of the platform's weight."""
RULE = "rule of hil new"
FRICTION = ("viscous_friction_N_s_m", "coulomb_friction_N")


class Delays(NamedTuple):
    """Delays of the loop, ms, and their source."""

    bus_ms: float
    drive_lag_ms: float
    hold_ms: float
    source: str


def delays_of(c: Configuration) -> Delays:
    """Delays as the configuration states them, else the bus time of its frames and its drives' lag."""
    delay = loop_delay(c)
    bus_s, source = delay.transport_s, "as stated in the configuration"
    if stated_delay(c) is None:
        bus_s = transport_s(c)
        polled = build_protocol(c.bus, c.drives).traits.command_delay_ticks
        source = "from poll to poll" if polled else "the frames of a tick with worst-case stuffing"
        source += "; `hil identify --delay` measures it"
    if not delay.lag_s and c.plant is None:
        source += "; the lag of the drives is unknown"
    return Delays(rounded(1e3 * bus_s), rounded(1e3 * delay.lag_s), rounded(5e2 * delay.period_s), source)


def with_gains(c: Configuration, wn: float, zeta: float) -> Configuration:
    """Law of a configuration with the gains for a natural frequency, rad/s, and a damping ratio at home."""
    law, loop = c.controller, desired_loop(c)
    derived = law.derived(loop._replace(wn=wn, zeta=zeta))
    layers = {key: power for key, power in law.knob.items() if power < 0 or key not in derived}
    found = {key: derived[key] for key in {*law.knob, "damping_ratio"} & derived.keys() - layers.keys()}
    found |= {key: old * (wn / loop.wn) ** layers[key] for key in layers if (old := getattr(law, key))}
    return changed(c, {f"controller.{key}": rounded(value, 4) for key, value in found.items()})


def by_rule(c: Configuration) -> Configuration:
    """Configuration with the gains that `hil new` writes: no friction, no prediction, no observer."""
    law, found = c.controller, _rotors(c)
    if getattr(law, "model", None) is not None:
        found |= {f"controller.model.{key}": 0.0 for key in FRICTION}
    if law.lookahead is not None:
        found["controller.delay_compensation"] = None
    return with_gains(changed(c, found | {"estimation.wrench.source": "none"}), wn_rad_s(c.loop.rate_Hz), 1.0)


def _rotors(c: Configuration, more: tuple[str, ...] = ()) -> dict[str, Any]:
    """Changes that give the law's model the rotor mass of the virtual plant, and more of its keys."""
    if getattr(c.controller, "model", None) is None or not (
        c.plant is not None and isinstance(c.plant.model, StewartPlant)
    ):
        return {}
    plant = c.plant.model
    return {f"controller.model.{key}": getattr(plant, key) for key in ("reflected_mass_kg", *more)}


def informed(c: Configuration, delays: Delays) -> Configuration:
    """Configuration whose law knows friction and rotors of the virtual plant, and the delays of the loop."""
    law, found = c.controller, _rotors(c, FRICTION)
    model = getattr(law, "model", None)
    if getattr(model, "frozen_at", 0) is None:  # a variant that is not frozen, if any
        found["controller.model.variant"] = "full"
    given = dict(zip(delays._fields[:3], delays[:3], strict=True))
    if hasattr(law, "delay_compensation") and not isinstance(c.reference, LiveReference):
        found["controller.delay_compensation"] = DelayCompensation(**given)
    if observer_of(c) is not None:
        found |= {f"estimation.wrench.{key}": given[key] for key in ("bus_ms", "drive_lag_ms")}
    return changed(c, found)


def figures_of(c: Configuration, delays: Delays, force_N: float = 0.0) -> dict[str, Any]:
    """Figures of a law's loop at home: gains, margins at `delays`, noise, and the error by an unknown force.

    The error is the peak gain of the loop, whatever the course of the force; None if the loop is not stable.
    """
    loop = desired_loop(c)
    try:
        sampled = at_home(c).figures.get("sampled", {})
    except np.linalg.LinAlgError:  # so slow that the errors of its bound reach a singular pose
        sampled = {}
    per_force, per_push_s2 = sampled.get("peak_m_N"), sampled.get("peak_gain_s2")
    if per_push_s2 is not None:
        per_force = per_push_s2 * _leg_push(c)
    margin, later_ms = sampled.get("delay_margin_ms"), 1e3 * loop_delay(c).transport_s - delays.bus_ms
    return {
        "wn_rad_s": loop.wn,
        "damping_ratio": loop.zeta,
        "crossover_rad_s": sampled.get("cross_over_rad_s"),
        "delay_margin_ms": None if margin is None else margin + later_ms,
        "phase_margin_deg": sampled.get("phase_margin_deg"),
        "gain_margin": sampled.get("gain_margin"),
        "force_noise_N": _noise_N(c, loop),
        "error_per_force_m_N": per_force,
        "disturbed_error_mm": None if per_force is None else 1e3 * per_force * force_N,
    }


def _leg_push(c: Configuration) -> float:
    """Largest acceleration of a leg per unit of force on the platform at home, m/s^2 per N."""
    platform, home = build_platform(c.platform), pose_arrays(c.platform.home)
    reflected = getattr(getattr(c.controller, "model", None), "reflected_mass_kg", 0.0)
    M = Model(platform, leg_spin=c.platform.leg_spin, reflected_mass=reflected).mass_matrix(*home)
    pushed = jacobian(platform, *home) @ np.linalg.inv(M)[:, :3]
    return float(np.linalg.norm(pushed, axis=1).max())


def _noise_N(c: Configuration, loop: DesiredLoop) -> float:
    """Root mean square of a leg's force, N, by the steps of encoder and frames."""
    read = build_protocol(c.bus, c.drives).traits.resolution.at(c.loop.rate_Hz)
    half = 0.0 if c.plant is None else 0.5 * c.plant.drives.encoder_resolution_m
    length, rate = hypot(half, float(np.max(read.length))), float(np.max(read.rate))
    return loop.leg_mass * hypot(loop.wn**2 * length, 2.0 * loop.zeta * loop.wn * rate) / sqrt(3.0)


def violations(c: Configuration, figures: dict[str, Any], delay_margin_ms: float) -> Iterator[str]:
    """Each requirement that a loop violates, with value and limit."""
    if figures["crossover_rad_s"] is None:
        yield "loop that is not stable, or errors as large as the robot"
    for key, least, unit in (
        ("delay_margin_ms", delay_margin_ms, "ms (--delay-margin)"),
        ("phase_margin_deg", PHASE_DEG, "deg"),
        ("gain_margin", GAIN_UP, "times"),
    ):
        if figures[key] is not None and figures[key] < least:
            name = " ".join(key.split("_")[:2])
            yield f"{name} {figures[key]:.4g}, allowed: at least {least:.4g} {unit}"
    noise, most = figures["force_noise_N"], NOISE_SHARE * c.limits.force_N
    if noise > most:
        yield f"force noise {noise:.3g} N, allowed: at most {most:.3g} N, {NOISE_SHARE:.0%} of limits.force_N"


def fastest(
    c: Configuration, delays: Delays, delay_margin_ms: float, zeta: float, share: float | None
) -> tuple[Configuration, float, list[str]] | None:
    """(configuration, error by a disturbance, limit of faster gains) at the highest wn that is allowed.

    share: bandwidth of the wrench observer in wn; None: no observer. None: no wn is allowed.
    """

    def at(wn: float) -> tuple[Configuration, float, list[str]]:
        tried = with_gains(c, wn, zeta)
        if share is not None:
            tried = changed(tried, {"estimation.wrench.bandwidth_Hz": rounded(share * wn / (2.0 * pi))})
        figures = figures_of(tried, delays)
        return tried, figures["error_per_force_m_N"], list(violations(c, figures, delay_margin_ms))

    low, high = SLOWEST * wn_rad_s(c.loop.rate_Hz), 1e3 / sum(delays[:3])
    best, limit = at(low), ["natural frequency above 1 / delay"]
    if best[2]:
        return None
    for _ in range(STEPS):
        wn = lowered(sqrt(low * high), 3)
        found = at(wn)
        low, high = (low, wn) if found[2] else (wn, high)
        best, limit = (best, found[2]) if found[2] else (found, limit)
    return best[0], best[1], limit


def tune(
    c: Configuration, *, delay_margin_ms: float | None = None, force_N: float | None = None
) -> dict[str, Any]:
    """Summary of `hil tune`: gains, margins, the path in simulation, before and after, and the YAML block.

    delay_margin_ms: required; default: the margin of the gains that `hil new` writes, and of feedback that is
    too old. force_N: unknown force on the platform; default: `LOAD_SHARE` of its weight. Raises
    ConfigurationError: a law with fixed gains, or no gains fulfil the requirements.
    """
    c = unattended(c).model_copy(update={"feedforward": None})  # learned with other gains
    law = c.controller.law
    _refuse(c)
    delays, rule = delays_of(c), by_rule(c)
    weight_N = c.platform.platform.mass_kg * float(np.linalg.norm(c.platform.gravity_m_s2))
    force = LOAD_SHARE * weight_N if force_N is None else force_N
    tolerated_ms = 1e3 * (c.limits.stale_fault_ticks - 1) / c.loop.rate_Hz  # older feedback faults
    usual_ms = max(tolerated_ms, figures_of(rule, delays)["delay_margin_ms"] or 0.0)
    least = usual_ms if delay_margin_ms is None else delay_margin_ms
    knowing = informed(c, delays)
    shares: tuple[float | None, ...] = (None,) if observer_of(knowing) is None else OBSERVER
    tried = [fastest(knowing, delays, least, *each) for each in product(DAMPING, shares)]
    if not (found := [each for each in tried if each is not None]):
        raise ConfigurationError(
            f"{c.source}: controller: no gains of law {law} have a delay margin of {least:.3g} ms, a phase "
            f"margin of {PHASE_DEG:g} deg and a gain margin of {GAIN_UP:g}: lower --delay-margin or the delay"
        )
    tuned, _, limit = min(found, key=lambda each: each[1])
    block = block_of(tuned)
    loads(with_changes(c.text, block), c.source, c.folder)  # refuses a block that is not valid
    rows = {"as configured": c, RULE: rule, "tuned": tuned}
    runs = simulated(rows)
    return {
        "success": not runs.get("tuned", {}).get("fault"),
        "kind": "tune",
        "configuration": c.source,
        "law": law,
        "delays": delays._asdict(),
        "delay_margin_ms": least,
        "force_N": force,
        "gains": {name: figures_of(each, delays, force) | runs.get(name, {}) for name, each in rows.items()},
        "limit": limit,
        "block": block,
    }


def _refuse(c: Configuration) -> None:
    """Raise ConfigurationError if the law or the plant has no gains that can be tuned here."""
    if c.plant is not None and isinstance(c.plant.model, BenchPlant):
        raise ConfigurationError(
            f"{c.source}: plant.model: uncoupled legs, not the robot of section platform"
        )
    law = c.controller.law
    if law == "state_space":
        raise ConfigurationError(f"{c.source}: controller: law {law} has fixed gains; see `hil design`")
    if not c.controller.knob or (isinstance(c.controller.error_dynamics(), str) and law not in SPRINGS):
        raise ConfigurationError(
            f"{c.source}: controller: the loop of law {law} is unknown; its settings need `knob`, `derived`, "
            "`bandwidth` and `error_dynamics`: see docs/guides/own-laws.md"
        )


def block_of(c: Configuration) -> dict[str, Any]:
    """Sections of a tuned configuration to paste, as plain data."""
    law = c.controller
    keys = [*law.knob, "damping_ratio", "delay_compensation", "model"]
    given = {key: value for key in keys if (value := getattr(law, key, None)) is not None}
    for key in given.keys() & {"model", "delay_compensation"}:
        variant = {"variant": given[key].variant} if hasattr(given[key], "variant") else {}
        given[key] = variant | given[key].model_dump(exclude_defaults=True)
    block: dict[str, Any] = {"controller": {"law": law.law, **given}}
    if observer_of(c) is not None:
        w = c.estimation.wrench
        keys = ["source", "bandwidth_Hz", "bus_ms", "drive_lag_ms"]
        block["estimation"] = {"wrench": {key: getattr(w, key) for key in keys}}
    return block


def simulated(rows: Mapping[str, Configuration]) -> dict[str, dict[str, Any]]:
    """Errors of each configuration along one period of the reference in simulation, against the plant.

    Empty without a plant, or if the reference has no end.
    """
    c = next(iter(rows.values()))
    duration = span_s(build_trajectory(c.reference, c.platform.home, c.folder))
    if c.plant is None or not duration:
        return {}
    work = [Job(name, "own", each, duration, None, None, 0.0) for name, each in rows.items()]
    return {o.law: {"fault": o.fault, **o.figures} for o in map(measure, work)}


_COLUMNS = (
    Column("", lambda row: row[0], left=True),
    figure_column("wn\nrad/s", "wn_rad_s", ".3g"),
    figure_column("damping", "damping_ratio", ".3g"),
    figure_column("crossover\nrad/s", "crossover_rad_s", ".0f"),
    figure_column("delay\nmargin ms", "delay_margin_ms", ".3g"),
    figure_column("phase\ndeg", "phase_margin_deg", ".0f"),
    figure_column("gain\ntimes", "gain_margin", ".3g"),
    figure_column("noise\nN", "force_noise_N", ".2g"),
    figure_column("load\nmm", "disturbed_error_mm", ".3g"),
    figure_column("peak\nerror mm", "peak_true_leg_error_mm", ".3g"),
    figure_column("RMS\nmm", "rms_true_leg_error_mm", ".3g"),
    Column("", lambda row: Text(row[1].get("fault") or "", "red"), left=True),
)


def show(summary: dict[str, Any]) -> None:
    """Print the table of gains, what limits them, the error under the stated force, and the YAML block."""
    print_rows(_COLUMNS, summary["gains"].items())
    d, tuned, rule = summary["delays"], summary["gains"]["tuned"], summary["gains"][RULE]
    lines = [
        f"load    {summary['force_N']:.4g} N unknown on the platform at home: a leg error up to column load",
        f"delays  bus {d['bus_ms']:g}, lag {d['drive_lag_ms']:g}, hold {d['hold_ms']:g} ms: {d['source']}",
        f"limit   faster gains have a {'; '.join(summary['limit'])}",
    ]
    if fault := tuned.get("fault"):
        lines.append(f"fault   {fault} with the tuned gains on the path, in simulation: do not use them")
    elif (peak := tuned.get("peak_true_leg_error_mm")) and not rule["fault"]:
        ratio = rule["peak_true_leg_error_mm"] / peak
        lines.append(f"peak    {ratio:.3g} times smaller than with {RULE}, in simulation, against the plant")
    show_lines(["", *lines, "", *text_of(summary["block"]).splitlines()])
