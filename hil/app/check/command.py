"""`hil check CONFIG`: what bus, legs and limits say about a configuration before anything moves."""

from collections.abc import Callable
from typing import Any

import numpy as np

from drivers.errors import ConfigurationError, HilError
from hil.app.check.brakes import brake_line
from hil.app.check.bus import report_bus
from hil.app.check.controller import report_controller
from hil.app.check.dangers import dangers
from hil.app.check.encoders import report_encoders
from hil.app.check.feedforward import report_feedforward
from hil.app.check.findings import Report
from hil.app.check.fmu import report_fmu
from hil.app.check.fusion import report_fusion
from hil.app.check.loose import loose_limits
from hil.app.check.monitor import report_monitor
from hil.app.check.operating import report_operating
from hil.app.check.payload import broken_by, carried_along, report_payload
from hil.app.check.pushes import clipped
from hil.app.check.setpoints import report_setpoints
from hil.app.check.silence import Silence, reacted_to, silence_of
from hil.app.check.transmission import report_transmission
from hil.app.compose import build_admission, build_protocol
from hil.app.configuration.configuration import Configuration
from hil.app.configuration.platform import build_platform, pose_arrays
from hil.app.configuration.schema import named_schema, schema_is_there
from hil.app.configuration.yaml_positions import Path, Problem, parse
from hil.app.encoder_limits import encoder_limits
from hil.app.force_steps import force_steps_N, stepped_error_m
from hil.app.reachability import Walk, span_s, violations, walk
from hil.config.reference import LiveReference
from hil.loop.clock import real_time_rights
from hil.loop.report import KEPT
from hil.robot.dynamics import Model
from hil.robot.geometry import Platform
from hil.robot.kinematics import condition, leg_lengths
from hil.signals import explain
from hil.trajectory.build import build_trajectory
from hil.trajectory.path import six_words


def inspect(c: Configuration, tell: Callable[[float, float], None] = lambda *_: None) -> Report:
    """Return the report on a configuration and its whole reference.

    tell: called now and then with the s of the reference that were looked at, and of how many.
    Raises ConfigurationError with the limits that the reference breaks, each with its first instant.
    """
    report = Report(c.name)
    platform = build_platform(c.platform)
    model = Model(platform, leg_spin=c.platform.leg_spin)
    _robot(report, c, platform, model)
    report_bus(report, c)
    _drives(report, c)
    report_transmission(report, c, np.array(report.figures["home"]["static_forces_N"]))
    report_controller(report, c, tell)
    report_monitor(report, c)
    report_encoders(report, c)
    report_fusion(report, c)
    _reference(report, c, platform, model)
    _payload(report, c)
    report_feedforward(report, c)
    report_fmu(report, c)
    _permissions(report, c)
    if not schema_is_there(c.text, c.folder):
        report.warnings.append(
            f"the first lines of {c.source} name the schema {named_schema(c.text)}, which is not there: an "
            f"editor says `Unable to load schema`. `hil schema {c.source}` names that of this installation"
        )
    return report


def _robot(report: Report, c: Configuration, platform: Platform, model: Model) -> None:
    home, still = pose_arrays(c.platform.home), np.zeros(6)
    q = leg_lengths(platform, *home)
    tau = model.inverse_dynamics(*home, still, still)
    number = condition(platform, *home)
    report.sections["robot at home"] = [
        f"leg lengths    {_six(q, 4)} m (stroke {c.platform.length_min_m:g} to {c.platform.length_max_m:g})",
        f"static forces  {_six(tau, 1)} N",
        f"condition of J {number:.2f} (limit {c.limits.condition:g})",
    ]
    report.figures["home"] = {
        "leg_lengths_m": q.tolist(),
        "static_forces_N": tau.tolist(),
        "condition": float(number),
    }


def _drives(report: Report, c: Configuration) -> None:
    period_ms = 1e3 / c.loop.rate_Hz
    periods, watched = c.drives.watchdog_ms / period_ms, build_protocol(c).traits.has_watchdog
    report.sections["drives"] = [
        f"nodes {', '.join(map(str, c.drives.node_ids))}; rated force {c.drives.force_limit_N:g} N",
        f"watchdog {c.drives.watchdog_ms:g} ms, {periods:.1f} periods; then {_reaction(c)}"
        if watched
        else f"watchdog none that is set from here: when the controller falls silent {KEPT}",
        f"brakes get {1e3 * c.engage.brake_release_s:g} ms to open, {1e3 * c.engage.closing_s:g} ms to close",
        _brake_test(c),
        *_force_step(c),
        *brake_line(c),
    ]
    report.figures["drives"] = {
        "watchdog_periods": periods if watched else None,
        "reaction": c.reactions.silence if watched else None,
        "force_step_N": float(force_steps_N(c).max()),
    }


def _reaction(c: Configuration) -> str:
    silence = c.reactions.silence
    ends = silence in {"damp", "hold"}
    return f"{silence}, after {c.drives.brake_after_ms:g} ms brake" if ends else silence


def _force_step(c: Configuration) -> list[str]:
    """Say what a step of the command is at the leg, and what it may leave; nothing where there is none."""
    step_N, left_m = float(force_steps_N(c).max()), stepped_error_m(c)
    if step_N == 0.0:
        return []
    left = "" if left_m is None else f", which leaves up to {1e3 * left_m:.3g} mm at rest"
    return [f"one step of the force is {step_N:.2g} N at the leg{left}"]


def _brake_test(c: Configuration) -> str:
    ramp_s, allowed_mm = c.engage.force_ramp_s, 1e3 * c.limits.standstill_m
    if ramp_s <= 0.0:
        return "no brake tests, as engage.force_ramp_s is 0"
    return f"brake tests take {ramp_s:g} s; a leg may move by {allowed_mm:g} mm"


def stopping_distances_m(c: Configuration) -> tuple[float, float]:
    """Return how far a leg may travel on the reference, m, as printed.

    From silence until its brake holds it, and in a stop under control. Where the drives have no watchdog that
    is set from here, the first is what a reaction within `drives.watchdog_ms` leaves: theirs has no bound.
    Raises ConfigurationError as `inspect` does.
    """
    platform = build_platform(c.platform)
    model = Model(platform, leg_spin=c.platform.leg_spin)
    w, _ = _walk_within_limits(c, platform, model)
    return reacted_to(c, w).travel_m(w), _controlled_stop_m(c, w)


def _controlled_stop_m(c: Configuration, w: Walk) -> float:
    """Return the longest way of a leg while path time slows down to rest: half of `engage.stop_s` goes by."""
    return 0.5 * c.engage.stop_s * float(np.abs(w.dq).max())


def refuse_unreachable(c: Configuration) -> None:
    """Refuse a reference that breaks a limit somewhere on its way; costs up to half a second.

    Raises ConfigurationError with the first instant of each limit that it breaks.
    """
    platform = build_platform(c.platform)
    _walk_within_limits(c, platform, Model(platform, leg_spin=c.platform.leg_spin))


def _walk_within_limits(c: Configuration, platform: Platform, model: Model) -> tuple[Walk, float | None]:
    """Return the walk along the reference and the duration of the whole."""
    period = 1 / c.loop.rate_Hz
    try:
        trajectory = build_trajectory(c.reference, c.platform.home, c.folder)
        w = walk(platform, model, trajectory, span_s(trajectory), period, c.plant)
    except ConfigurationError:
        raise
    except HilError as error:
        raise ConfigurationError(_line(c, str(error))) from error
    found = violations(w, c.platform, c.limits, period)
    if isinstance(c.reference, LiveReference) and not found:
        against = build_admission(c, platform)(six_words(c.reference.start or c.platform.home))
        if against:
            raise ConfigurationError(_line(c, f"at its start, set-points are refused: {explain(against)}"))
    if found:
        raise ConfigurationError(*(_line(c, f"at t = {v.t:.3f} s: {v.message}") for v in found))
    limits = encoder_limits(c, c.loop.rate_Hz)
    clips = clipped(c, limits, w)
    if clips is not None:
        raise ConfigurationError(_line(c, clips, ("monitor", "friction_N")))
    return w, trajectory.duration_s


def _payload(report: Report, c: Configuration) -> None:
    """Report on a payload known by ranges. Raises ConfigurationError with the limits that it breaks."""
    found = carried_along(c, build_trajectory(c.reference, c.platform.home, c.folder))
    broken = [_line(c, text, ("platform", "platform", "payload")) for text in broken_by(found)]
    if broken:
        raise ConfigurationError(*broken)
    report_payload(report, c, found)


def _reference(report: Report, c: Configuration, platform: Platform, model: Model) -> None:
    w, whole = _walk_within_limits(c, platform, model)
    step, swing = _changes(w, 1 / c.loop.rate_Hz)
    peak, silence = float(np.abs(w.tau).max()), silence_of(c, w)
    within = "not looked at on so long a path" if swing is None else f"{swing:.0f} N"
    change = (
        f"{step:.0f} N from tick to tick (limit {c.limits.force_step_N:g}), "
        f"{within} within 250 ms (limit {c.limits.force_window_N:g})"
    )
    report.sections[
        f"reference {c.reference.type}, {'until stopped' if whole is None else f'{whole:g} s'}"
    ] = [
        f"leg lengths    {w.q.min():.4f} to {w.q.max():.4f} m",
        f"leg rates      up to {np.abs(w.dq).max():.3f} m/s (limit {c.limits.speed_m_s:g})",
        f"accelerations  up to {np.abs(w.ddq).max():.3f} m/s^2 (limit {_limit(c.limits.acceleration_m_s2)})",
        f"leg forces     {w.tau.min():.0f} to {w.tau.max():.0f} N (limit {c.limits.force_N:g})",
        f"force change   {change}",
        f"condition of J up to {w.condition.max():.2f} (limit {c.limits.condition:g})",
        *_silence(silence, w),
        f"controlled stop up to {1e3 * _controlled_stop_m(c, w):.0f} mm, along the path within engage.stop_s",
    ]
    report.figures["reference"] = {
        "until_braked_m": silence.travel_m(w) if silence else None,
        "controlled_stop_m": _controlled_stop_m(c, w),
        "duration_s": whole,
        "length_min_m": float(w.q.min()),
        "length_max_m": float(w.q.max()),
        "rate_max_m_s": float(np.abs(w.dq).max()),
        "acceleration_max_m_s2": float(np.abs(w.ddq).max()),
        "force_min_N": float(w.tau.min()),
        "force_max_N": float(w.tau.max()),
        "force_step_N": step,
        "force_window_N": swing,
        "condition_max": float(w.condition.max()),
    }
    report.warnings += dangers(c, w, silence)
    trajectory = build_trajectory(c.reference, c.platform.home, c.folder)
    slowed = report_operating(report, c, w, trajectory, model)
    jogged = report.figures.get("jog_change_N", 0.0), report.figures.get("jog_rate_m_s", 0.0)
    report.warnings += loose_limits(c, w, slowed, jogged)
    if isinstance(c.reference, LiveReference):
        report_setpoints(report, c, c.reference)
    if peak > 0.9 * c.limits.force_N:
        report.warnings.append(
            f"the reference needs {peak:.0f} N of limits.force_N {c.limits.force_N:g}: less than 10 % "
            "is left for control"
        )


def _silence(silence: Silence | None, w: Walk) -> tuple[str, str]:
    """Say how far a leg travels when the controller falls silent."""
    if silence is None:
        return (
            "silence        no bound to a leg's travel: the drives keep the last torque until their power is",
            "               cut, as they have no watchdog that is set from here",
        )
    return (
        f"silence        a leg travels up to {1e3 * silence.travel_m(w):.0f} mm until it rests on its brake,",
        f"               in {1e3 * silence.T:.0f} ms: drives.watchdog_ms and engage.brake_close_s",
    )


def _changes(w: Walk, period: float) -> tuple[float, float | None]:
    swings = w.swings(period)
    return float(np.abs(w.steps()[1]).max()), None if swings is None else float(swings.max())


def _permissions(report: Report, c: Configuration) -> None:
    with real_time_rights(c.loop.priority, c.loop.cpu) as granted:
        lines = [f"granted: {', '.join(granted.granted) or 'nothing'}"]
        lines.append(f"missing: {', '.join(granted.missing) or 'nothing'}")
        fifo = granted.fifo
    report.sections["real time on this machine"] = lines
    report.figures["real_time"] = {"granted": granted.granted, "missing": granted.missing}
    if not fifo and c.bus.layout != "ideal":
        then = (
            "`hil run` will refuse (loop.without_realtime)"
            if c.loop.without_realtime == "refuse"
            else "`hil run` will drop to a rate it can hold"
        )
        report.warnings.append(
            f"no SCHED_FIFO: {then}. To get it: `ulimit -r {c.loop.priority}` from a limits.conf entry "
            f"`@realtime - rtprio {c.loop.priority}` (and `- memlock unlimited`), or CAP_SYS_NICE"
        )


def _line(c: Configuration, message: str, path: Path = ("reference",)) -> str:
    """Point at a key of the file, or its nearest ancestor there."""
    return Problem(parse(c.text).key_position(path), path, message).line(c.source)


def _limit(value: float | None) -> str:
    return "none" if value is None else f"{value:g}"


def _six(x: Any, digits: int) -> str:
    return " ".join(f"{v:.{digits}f}" for v in x)
