"""`hil identify --delay`, and what all of `hil identify` shares: runs made for it, and logs."""

from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import yaml

from drivers.arrays import Rows
from drivers.errors import ConfigurationError, LogError
from drivers.files import open_regular
from drivers.signals import DriveState
from hil.app.check.command import refuse_unreachable
from hil.app.configuration.configuration import Configuration, loads
from hil.app.configuration.platform import build_platform
from hil.app.configuration.unattended import unattended
from hil.app.configuration.yaml_positions import parse
from hil.app.replay import open_run
from hil.app.run.command import run_daemon
from hil.app.sim.command import simulate
from hil.config.model import ModelSettings
from hil.config.reference import Evaluated, HoldReference
from hil.config.values import Pose
from hil.control.model import build_model
from hil.lab.identify.estimators.axis_fit import Fit
from hil.lab.identify.estimators.excitation import delay_excitation
from hil.lab.identify.estimators.force_delay import Delay, Motion, force_delay
from hil.record.mcap_file import MAGIC
from hil.robot.dynamics import Model
from hil.robot.dynamics_kernels import COULOMB, VISCOUS

DURATION_S = 4.0
FORCE_SHARE = 0.02
"""Excitation as a share of limits.force_N ..."""
STEP_SHARE = 0.1
"""... and at most of limits.force_step_N and limits.force_window_N."""


class Excited(NamedTuple):
    """A configuration with its reference replaced by an excitation."""

    configuration: Configuration
    force_N: float
    """Largest leg force of the excitation."""


class Recorded(NamedTuple):
    """A log of a run."""

    configuration: Configuration
    rows: Rows
    rate_Hz: float
    attachments: dict[str, bytes]


def is_log(source: Path) -> bool:
    """Tell whether a file is a log (MCAP) rather than a configuration."""
    try:
        with open_regular(source) as file:
            return file.read(len(MAGIC)) == MAGIC
    except OSError:
        return False


def excited(configuration: Configuration, force_N: float | None, duration_s: float | None) -> Excited:
    """Return the configuration with a small excitation about the held pose (else home) for its reference.

    Raises ConfigurationError: a fused pose, a force that the limits would cut, or a pose that cannot be
    reached.
    """
    c = configuration
    refuse_fused(c, c.source)
    force = excitation_force(c, force_N)
    reference = delay_excitation(
        exact_model(c), excitation_pose(c), c.loop.rate_Hz, force, duration_s or DURATION_S
    )
    return excited_by(c, reference, force)


def refuse_fused(c: Configuration, where: object, task: str = "identify") -> None:
    """Raise ConfigurationError where a log has another motion than that of the encoders; it lacks theirs.

    task: what is done from the run.
    """
    if c.estimation.pose == "fused":
        raise ConfigurationError(
            f"{where}: estimation.pose: fused, so that lengths, pose and rates of the log are the filter's, "
            "drawn to what the controller believes of masses and forces; allowed: legs, in the run to "
            f"{task} from"
        )


def excitation_force(c: Configuration, force_N: float | None) -> float:
    """Return the largest leg force of an excitation: what was asked for, or what the limits leave room for.

    Raises ConfigurationError: a force that the limits would cut.
    """
    most = STEP_SHARE * min(c.limits.force_step_N, c.limits.force_window_N)
    force = min(FORCE_SHARE * c.limits.force_N, most) if force_N is None else force_N
    if force > 5 * most:
        raise ConfigurationError(
            f"--force {force:g}: more than half of limits.force_step_N or limits.force_window_N, which would "
            f"cut it, allowed: up to {5 * most:g}"
        )
    return force


def excitation_pose(c: Configuration) -> Pose:
    """Return the pose that is held, else home."""
    held = c.reference.pose if isinstance(c.reference, HoldReference) else None
    return held or c.platform.home


def excited_by(c: Configuration, reference: Evaluated, force_N: float) -> Excited:
    """Return the configuration with another reference.

    Raises ConfigurationError for one that cannot be reached.
    """
    document = dict(parse(c.text).value or {})
    document["name"] = f"{c.name[:80]}-identify"
    document["reference"] = reference.model_dump(mode="json")
    document.pop("feedforward", None)
    text = "# Made by hil identify: the reference is an excitation.\n"
    text += yaml.safe_dump(document, sort_keys=False, allow_unicode=True)
    made = loads(text, c.source, c.folder)
    refuse_unreachable(made)
    return Excited(made, force_N)


def exact_model(configuration: Configuration) -> Model:
    """Return the full model with what the controller believes of friction and inertia, where it does."""
    c = configuration
    believed = c.controller.believed or ModelSettings()
    full = believed.model_copy(update={"variant": "full", "frozen_at": None})
    return build_model(full, build_platform(c.platform), c.platform.leg_spin)


def motion_of(rows: Rows, period_s: float) -> Motion:
    """Return a log's ticks with open brakes as the estimator wants them; ticks that are missing are held."""
    running = (rows["drive_state"] == DriveState.RUN).all(axis=1)
    if not running.any():
        raise LogError("the brakes were never open in this log: nothing moved")
    ticks = rows["tick"]
    first, last = ticks[running][0], ticks[running][-1]
    source = np.searchsorted(ticks, np.arange(first, last + 1), side="right") - 1
    there = ticks[source] == np.arange(first, last + 1)
    rows = rows[source]
    good = there & running[source] & (rows["age"] == 0).all(axis=1) & np.isfinite(rows["twist"]).all(axis=1)
    return Motion(
        period_s,
        np.ascontiguousarray(rows["tau"]),
        np.ascontiguousarray(rows["p"]),
        np.ascontiguousarray(rows["R"]).reshape(-1, 3, 3),
        np.ascontiguousarray(rows["twist"]),
        np.ascontiguousarray(rows["dq"]),
        good[1:] & good[:-1],
    )


def recorded_run(path: Path) -> Recorded:
    """Return what a log of `hil run` or `hil sim` holds. Raises LogError for what is no such log."""
    log, run, configuration = open_run(path)
    return Recorded(configuration, log.rows(), float(run["rate_Hz"]), log.attachments)


def delay_of_log(path: Path) -> dict[str, Any]:
    """Return the summary of the delay that a log of `hil run` or `hil sim` shows.

    Raises LogError for what is no such log, ConfigurationError for a fused pose, IdentificationError where
    it does not hold enough.
    """
    recorded = recorded_run(path)
    refuse_fused(recorded.configuration, path)
    motion = motion_of(recorded.rows, 1.0 / recorded.rate_Hz)
    model = exact_model(recorded.configuration)
    delay = force_delay(motion, model)
    found = summary(delay) | {"friction": friction_block(delay, model)}
    return {"success": True, "kind": "identify", "log": str(path)} | found


def summary(delay: Delay) -> dict[str, Any]:
    """Return a delay as plain values, and the section of the configuration that compensates it."""
    return {
        **delay_figures(delay, delay.hold_s),
        "separable": delay.separable,
        "explained_percent": 100.0 * delay.explained,
        "gain": delay.gain.tolist(),
        "viscous_friction_N_s_m": delay.viscous.tolist(),
        "viscous_friction_std_N_s_m": delay.viscous_std.tolist(),
        "coulomb_friction_N": delay.coulomb.tolist(),
        "coulomb_friction_std_N": delay.coulomb_std.tolist(),
        "periods": delay.periods,
        "delay_compensation": compensation(delay, delay.hold_s),
    }


def compensation(found: Delay | Fit, hold_s: float) -> dict[str, float]:
    """Return the keys of section `controller.delay_compensation`."""
    return {
        "bus_ms": round(1e3 * found.transport_s, 4),
        "drive_lag_ms": round(1e3 * found.lag_s, 4),
        "hold_ms": round(1e3 * hold_s, 4),
    }


def compensation_lines(keys: dict[str, float]) -> list[str]:
    """Return them as the lines to paste."""
    values = ", ".join(f"{key}: {value:g}" for key, value in keys.items())
    return ["", "controller:", f"  delay_compensation: {{{values}}}"]


def friction_block(delay: Delay, model: Model) -> dict[str, list[float]]:
    """Return keys of `controller.model`: friction of the model and beyond it, where that is surely there.

    No key unless all six legs show more than three standard deviations: a leg alone may be a model error.
    """
    found = {}
    for key, value, std, at in (
        ("viscous_friction_N_s_m", delay.viscous, delay.viscous_std, VISCOUS),
        ("coulomb_friction_N", delay.coulomb, delay.coulomb_std, COULOMB),
    ):
        if (value > 3.0 * std).all():
            found[key] = [float(f"{x:.4g}") for x in model.constants[at : at + 6] + value]
    return found


def delay_figures(found: Delay | Fit, hold_s: float) -> dict[str, float]:
    """Return transport, lag, hold and their sum in ms, with standard deviations."""
    return {
        "total_ms": 1e3 * found.total_s,
        "total_std_ms": 1e3 * found.total_std_s,
        "transport_ms": 1e3 * found.transport_s,
        "transport_std_ms": 1e3 * found.transport_std_s,
        "lag_ms": 1e3 * found.lag_s,
        "lag_std_ms": 1e3 * found.lag_std_s,
        "hold_ms": 1e3 * hold_s,
    }


def delay_rows(figures: dict[str, Any], total: str) -> list[str]:
    """Return a line for each of `delay_figures`; `total` says what their sum is."""
    rows = []
    for name, key, remark in (
        ("transport", "transport", "SYNC to feedback, computing, command: pure delay"),
        ("drive lag", "lag", "time constant of the drives' force loop"),
        ("hold", "hold", "half a period, by design"),
        ("total", "total", total),
    ):
        std = figures.get(f"{key}_std_ms")
        sure = "" if std is None else f" +- {2 * std:.4f}"
        rows.append(f"  {name:12} {figures[f'{key}_ms']:8.4f}{sure:11} ms   {remark}")
    return rows


def report(result: dict[str, Any]) -> list[str]:
    """Return what the user reads: the delays, how sure they are, and what to write where."""
    lines = [
        "From the measurement to the force that answers it (+- two standard deviations):",
        *delay_rows(result, "what the law looks ahead by"),
        f"{result['periods']} periods; the commands explain {result['explained_percent']:.2f} % of what "
        "varies; gain of each leg " + " ".join(f"{g:.3f}" for g in result["gain"]),
    ]
    if not result["separable"]:
        lines.append(
            "Transport and lag could not be told apart: the motion was too slow for it. Their sum stands as "
            "transport; the excitation of `hil identify CONFIG --delay` tells more."
        )
    worst = max(abs(g - 1.0) for g in result["gain"])
    if worst > 0.05:
        lines.append(
            f"A leg's force is {100 * worst:.0f} % off the model's: wrong masses, or the scale of its drive."
        )
    block = compensation_lines(result["delay_compensation"])
    if result["friction"]:
        lines.append("Friction of the drives, beside what the model has, is in the block below.")
        rows = [f"    {key}: {value}" for key, value in result["friction"].items()]
        block += ["  model:", *rows]
    return [*lines, *block]


def run_for(
    made: Excited, log: Path | None, *, real_time: bool, with_plant: bool, arm: bool
) -> dict[str, Any]:
    """Run an excited configuration, in lockstep or in real time; return the summary of that run.

    with_plant, arm: as for `run_daemon`, in real time.

    Raises ConfigurationError for what cannot run: lockstep needs a plant.
    """
    if real_time:
        return run_daemon(made.configuration, log=log, with_plant=with_plant, draw=False, arm=arm)
    if made.configuration.plant is None:
        raise ConfigurationError(
            f"{made.configuration.source}: no section plant, so there is nothing to simulate: these are real "
            "drives. Use --run, which moves them"
        )
    return simulate(unattended(made.configuration), log=log)
