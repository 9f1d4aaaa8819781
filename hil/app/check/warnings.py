"""Warnings of `hil check` about settings that are allowed but dangerous, one table row per warning."""

from collections.abc import Callable, Iterator, Mapping
from typing import NamedTuple

import numpy as np

from drivers.config import UDP
from drivers.motors import MotorProtocol
from drivers.transmission import Transmission
from hil.app.check.leg_order import crossing, findings, model_mobility
from hil.app.check.loose_limits import FACTOR, loose
from hil.app.check.report import Scaled
from hil.app.check.subject import LEAST_MARGIN_DEG, Subject, robot, rough_rows, static_N
from hil.app.configuration.configuration import Configuration
from hil.app.configuration.schema import named_schema, schema_is_there
from hil.app.loop_delay import unlike_law
from hil.app.operate import REPEAT_S
from hil.control.uncertainty import UncertaintySettings
from hil.mathematics.rounding import lowered
from hil.safety.residuals import SUSPECT, gap_bound
from plant_fmu.config import FmuPlant

UNSTATED = 3.0
"""Largest plausible ratio of an unstated rated force to the force limit."""
JUMP_SHARE = 0.1
"""Largest jump that may stay undetected, as a share of the stroke."""
FEWEST_TURNS = 0.1
"""Fewest plausible turns of a motor over the whole stroke of its leg."""
FASTEST_rpm = 30_000.0
"""Highest plausible speed of a motor."""
STRONGEST_N_m = 1000.0
"""Highest plausible torque of a motor."""
PAGE_REPEAT_S = 0.05
"""Period of the key frames that the page of `hil watch` sends."""
SEVERAL = 3 - 1e-9
"""Fewest key frames within deadman_s: one may be late, one lost. Also the fewest ticks: the loop reads the
frames of a tick at its end.
"""
MODELS = {
    "constant": "M, G and J frozen at one pose, good for small motion only: 395 mm (constant_MG 2.2 mm)",
    "constant_MG": "M and G frozen at one pose: 2.2 mm (full 0.03 mm)",
    "printed": "without H and without J_dot twist, up to 15.7 % of the force: 2.6 mm (full 0.03 mm)",
}
"""Simplification of each model variant and its end error: book platform, book path (0.6 m, 19 deg),
wn 20 rad/s, 1 kHz.
"""
RATELESS = {"refuse": "refuse (loop.without_realtime)", "slow": "drop to a rate it can hold"}
Values = Mapping[str, object]


class Warning(NamedTuple):  # noqa: A001 - the word of the command
    """One warning of `hil check`: a condition and a sentence.

    `found` returns the values that the sentence needs besides the subject `s` and its configuration `c`:
    figures, or `text`, or `True`. A list yields several sentences; a false value means that the setting is
    harmless.
    """

    found: Callable[[Subject], "bool | str | Values | list[str] | list[Values] | None"]
    sentence: str


def warnings(s: Subject) -> Iterator[tuple[str, str]]:
    """Yield code and sentence of each warning that applies to a configuration."""
    for code, row in (WARNINGS if s.c.bus.layout == "ideal" else HARDWARE | WARNINGS).items():
        found = row.found(s)
        for each in found if isinstance(found, list) else [found]:
            if each:
                values = each if isinstance(each, Mapping) else {"text": each}
                yield code, Scaled().vformat(row.sentence, (), {"s": s, "c": s.c, **values})


def above(value: float | None, limit: float | None) -> Values | None:
    """{value, limit} of a value above its limit; None if it is not above, or one of the two is missing."""
    broken = value is not None and limit is not None and value > limit
    return {"value": value, "limit": limit} if broken else None


def below(value: float | None, limit: float | None) -> Values | None:
    """{value, limit} of a value below its limit; None if it is not below, or one of the two is missing."""
    return None if above(limit, value) is None else {"value": value, "limit": limit}


def _hard_end(s: Subject) -> Values | None:
    if s.silence is None or s.c.reactions.silence != "brake":
        return None
    return s.silence.beyond(s.walk, s.c.platform.length_min_m, s.c.platform.length_max_m)


def _motor(s: Subject) -> list[str]:
    """Reasons why the stated transmission implies an implausible motor."""
    if s.c.drives.transmission is None:
        return []
    gear, limits = Transmission(s.c.drives.transmission), s.c.limits
    turns = float((s.stroke_m / np.abs(gear.m_per_turn)).min())
    rpm = 60.0 * float((limits.speed_m_s / np.abs(gear.m_per_turn)).max())
    torque = float((limits.force_N / np.abs(gear.N_per_Nm)).max())
    rows = (
        (turns < FEWEST_TURNS, f"the whole stroke is {turns:.3g} turns"),
        (rpm > FASTEST_rpm, f"limits.speed_m_s {limits.speed_m_s:g} is {rpm:.3g} rpm"),
        (torque > STRONGEST_N_m, f"limits.force_N {limits.force_N:g} is {torque:.3g} N m"),
    )
    return [text for holds, text in rows if holds]


def _jumps(s: Subject) -> Values | None:
    """Smallest detectable jump of a length, if it is a large part of the stroke."""
    e = s.encoders
    seen_m = gap_bound(e.length_noise_m, e.rate_noise_m_s, 2.0 * e.disturbance_m_s2, e.period_s)
    return above(seen_m, JUMP_SHARE * s.stroke_m)


def _demands(s: Subject) -> list[Values]:
    """Demands of speed changes, jogs and set-points that exceed a limit."""
    stop = f"increase engage.stop_s {s.c.engage.stop_s:g}"
    rows: list[tuple[str, float, str, str, str]] = []
    if s.slowed is not None and s.jogged is not None:
        what, fix = (
            "a change of speed along the reference",
            f"hold, start or speed may cause a fault there; {stop}",
        )
        rows += [
            (what, s.slowed.acceleration_m_s2, "m/s^2", "acceleration_m_s2", fix),
            (what, s.slowed.force_N, "N", "force_N", fix),
            (what, s.own_step_N + s.slowed.step_N, "N more in a tick", "force_step_N", fix),
        ]
        what, fix = "a jog from the reference", "lower operator.setup_speed_m_s and setup_speed_deg_s"
        rows += [
            (what, s.jogged.change_N, "N more within 250 ms", "force_window_N", f"{fix}, or {stop}"),
            (what, s.jogged.rate_m_s, "m/s", "speed_m_s", f"SPEED latches, and the brakes close; {fix}"),
        ]
    if s.setpoints is not None:
        what, fix = "set-points on all axes at once", "of reference.limits"
        rows += [
            (what, s.setpoints[0], "m/s", "speed_m_s", f"lower the velocities {fix}"),
            (what, s.setpoints[1], "m/s^2", "deceleration_m_s2", f"lower the accelerations {fix}"),
        ]
    return [
        {"what": what, "unit": unit, "name": name, "fix": fix, **over}
        for what, value, unit, name, fix in rows
        if (over := above(value, getattr(s.c.limits, name)))
    ]


def _felt(s: Subject) -> Values | None:
    stated = getattr(s.c.controller, "uncertainty", None)
    known = stated.acceleration_m_s2 if isinstance(stated, UncertaintySettings) else None
    return above(s.slowed and s.slowed.felt_m_s2, known)


def _unbraked(s: Subject) -> Values | None:
    """Configured deceleration before the soft ends, if far above what the legs' forces can reach."""
    able = (min(s.c.limits.force_N, s.c.drives.force_limit_N) - s.weight_N) / s.leg_mass_kg
    times = s.c.limits.deceleration_m_s2 / able if able > 0.0 else 0.0
    return {"times": times, "able": able, "give": lowered(able)} if times > FACTOR else None


def falls(c: Configuration) -> str:
    """Warning that a plant without brakes falls before the first command; "" if it does not fall."""
    if c.plant is None or not isinstance(c.plant.model, FmuPlant) or c.plant.model.brake:
        return ""
    load_N = float(np.abs(static_N(c, robot(c))).max())
    if load_N == 0.0:
        return ""
    return (
        "plant.model.brake is empty: no brake holds this plant, and its legs carry up to "
        f"{load_N:.3g} N; it falls from the first instant until the drives give force. Give the FMU six "
        "brake inputs (1 holds the leg) and map them, as the guide on FMUs shows"
    )


def _uncoupled(s: Subject) -> dict[str, float] | None:
    """Largest mass, kg, of uncoupled FMU legs, if the law assumes a platform between them."""
    if s.probe is None or not s.probe.uncoupled or s.c.controller.believed is None:
        return None
    return {"m": float(1.0 / np.abs(s.probe.mobility).max(axis=0).min())}


_NOISE = "set the largest deviation of a reading, 3 to 4 standard deviations"
_KEY = (
    "operator.deadman_s {value:g}: %s, and the platform stops if one key frame is late or "
    "lost; set {limit:.3g} or more"
)

HARDWARE = {
    "loop.feedback_window_us": Warning(
        lambda s: above(max(s.answers_us), s.window_us),
        "loop.feedback_window_us {limit:.0f}: SYNC and feedback take {value:.0f} us of bus time; lengthen it",
    ),
    "bus adapter": Warning(lambda s: s.adapters, "{text}"),
    "reactions.silence": Warning(
        lambda s: s.c.reactions.silence == "zero",
        "reactions.silence zero: without commands nothing holds {s.weight_N:.0f} N in a leg; set brake",
    ),
    "reactions sto": Warning(
        lambda s: ", ".join(str(fault.name).lower() for fault in s.c.reactions.led_to("sto")),
        "reactions sto after {text}: the platform falls until untested brakes act; sbc holds it until then",
    ),
    "engage.force_ramp_s": Warning(
        lambda s: s.c.engage.force_ramp_s <= 0.0,
        "engage.force_ramp_s 0: no brake is ever tested, neither at the start nor when parking",
    ),
    "engage.brake_close_s": Warning(
        _hard_end,
        "engage.brake_close_s {c.engage.closing_s:g}: after silence at t = {t:.3f} s leg {leg}, "
        "{free_m:milli.0f} mm from a hard end, travels up to {travel_m:milli.0f} mm until its brake holds; "
        "shorten it, drives.watchdog_ms, or speed or stroke of the path",
    ),
    "drives.protocol": Warning(lambda s: [*s.protocol.traits.dangers], "{text}"),
    "drives.homing": Warning(
        lambda s: isinstance(s.protocol, MotorProtocol) and s.c.drives.homing is None,
        "drives.homing is missing: a drive that loses its turn count at power-off reports a wrong length "
        "unnoticed; set a file for the parked lengths",
    ),
    "drives.transmission": Warning(
        _motor,
        "drives.transmission: {text} of the motor, which is implausible: lead_m and pulley_radius_m are in m",
    ),
    "monitor.length_noise_m and jumps": Warning(
        _jumps,
        "monitor.length_noise_m {c.monitor.length_noise_m:g}: only a jump above {value:milli.3g} mm is "
        "detected, and a tenth of the stroke is {limit:milli.3g} mm; " + _NOISE,
    ),
    "monitor.length_noise_m and standstill": Warning(
        lambda s: above(SUSPECT * s.encoders.length_noise_m, s.c.limits.following_error_m),
        "monitor.length_noise_m {c.monitor.length_noise_m:g}: a leg at rest is suspected beyond "
        "{value:milli.3g} mm, above limits.following_error_m {limit:g}; " + _NOISE,
    ),
    "limits.following_error_m and steps of the force": Warning(
        lambda s: above(s.stepped_error_m, s.c.limits.following_error_m),
        "limits.following_error_m {limit:g}: a torque resolution of {s.force_step_N:.2g} N leaves errors up "
        "to {value:milli.3g} mm; raise drives.transmission or controller.wn_rad_s, or use a weaker motor",
    ),
    "plant.model.brake_force_N": Warning(
        lambda s: above(s.weight_N, None if s.stewart is None else s.stewart.brake_force_N),
        "plant.model.brake_force_N {limit:g}: the brakes slip under a leg's load of {value:.3g} N; set yours",
    ),
    "plant.drives brake times": Warning(
        lambda s: " and ".join(
            f"plant.drives.{key}"
            for key in ("brake_open_ms", "brake_close_ms")
            if s.c.plant is not None and getattr(s.c.plant.drives, key) == 0.0
        ),
        "{text} 0: the emulated brakes act at once, unlike real ones; set the times of your brakes",
    ),
    "drives.force_limit_N": Warning(
        lambda s: (
            "force_limit_N" not in s.c.drives.model_fields_set
            and above(s.c.drives.force_limit_N / s.c.limits.force_N, UNSTATED)
        ),
        "drives.force_limit_N is missing, and {c.drives.force_limit_N:.0f} N are assumed, {value:.0f} "
        "times limits.force_N {c.limits.force_N:g}: set the rated force of your drives",
    ),
    "limits": Warning(
        loose,
        "limits.{name} {value:g} is {times:.1f} times the {needed:.3g} {unit} that are needed {by}; it would "
        "detect a failure late, set {give:g}",
    ),
    "limits.deceleration_m_s2": Warning(
        _unbraked,
        "limits.deceleration_m_s2 {c.limits.deceleration_m_s2:g} is {times:.1f} times the {able:.3g} m/s^2 "
        "by which limits.force_N can brake a leg before a hard end; set {give:g}",
    ),
    "loop.without_realtime": Warning(
        lambda s: "" if s.fifo else RATELESS[s.c.loop.without_realtime],
        "no SCHED_FIFO: `hil run` will {text}; `hil doctor {c.source}` has the command that permits it",
    ),
}
"""Not applied to layout `ideal`, which drives no hardware and so endangers nobody."""


def _unknown(name: str) -> str:
    """Message with the known bus interfaces for an unknown one; empty for a known one."""
    if name in {"localcan", "socketcan", UDP}:
        return ""
    from drivers.can.python_can import unknown_interface

    return unknown_interface(name)


WARNINGS = {
    "bus.interface": Warning(
        lambda s: [_unknown(name) for name in sorted({each.interface for each in s.c.bus.buses})],
        "{text}",
    ),
    "controller.model.variant": Warning(
        lambda s: MODELS.get(s.variant),
        "controller.model.variant {s.variant}: {text} off at the end of the book's path",
    ),
    "estimation.wrench.model": Warning(
        lambda s: unlike_law(s.c),
        "estimation.wrench.model differs from controller.model: the observer reports the difference as load, "
        "and `hil stability` does not count it; remove the key and the observer uses controller.model",
    ),
    "controller.boundary_layer_m_s": Warning(
        lambda s: s.switches,
        "controller.boundary_layer_m_s 0 chatters: {s.delay.total_s:milli.1f} ms of delay; increase it",
    ),
    "controller phase margin": Warning(
        lambda s: s.margin and below(s.margin["phase_margin_deg"], LEAST_MARGIN_DEG),
        "controller.{c.controller.tuning[0]}: about {value:.0f} degrees of phase margin at loop.rate_Hz "
        "{c.loop.rate_Hz:g}, advised: at least {limit:g}; {c.controller.tuning[1]} or raise the rate",
    ),
    "controller.controller_file": Warning(lambda s: s.designed and s.designed.warnings, "{text}"),
    "controller.controller_file of another robot": Warning(
        lambda s: s.proven is not None and s.proven.figures.get("coupled_axes_covered") is False,
        "controller.controller_file: designed for another inertia than platform and payload have, see "
        "`hil stability`; design with `--robot`, or state smaller ranges",
    ),
    "controller unstable": Warning(
        lambda s: s.proven is not None and s.proven.status == "unstable",
        "controller: {s.proven.claim}",
    ),
    "limits while operated": Warning(
        _demands,
        "{what} may need {value:.4g} {unit} of a leg, above limits.{name} {limit:g}: {fix}",
    ),
    "controller.uncertainty.acceleration_m_s2": Warning(
        _felt,
        "controller.uncertainty.acceleration_m_s2 {limit:g}: a change of speed needs {value:.3g} m/s^2 "
        "without the law's linear part; set at least that",
    ),
    "operator.deadman_s of hil ctl": Warning(
        lambda s: below(s.c.operator.deadman_s, SEVERAL * REPEAT_S),
        _KEY % f"`hil ctl key` sends every {1e3 * REPEAT_S:g} ms",
    ),
    "operator.deadman_s of the page": Warning(
        lambda s: s.c.watch.operate and below(s.c.operator.deadman_s, SEVERAL * PAGE_REPEAT_S),
        _KEY % f"the page of `hil watch` sends every {1e3 * PAGE_REPEAT_S:g} ms",
    ),
    "operator.deadman_s in ticks": Warning(
        lambda s: below(s.c.operator.deadman_s, SEVERAL / s.c.loop.rate_Hz),
        "operator.deadman_s {value:g}: fewer than three ticks of the loop; set {limit:.3g} or more",
    ),
    "limits.force_N on the reference": Warning(
        lambda s: s.peak_N > 0.9 * s.c.limits.force_N,
        "the reference needs {s.peak_N:.0f} N, which leaves less than 10 % of limits.force_N for control",
    ),
    "feedforward rate": Warning(
        lambda s: s.learned is not None and s.learned.head.rate_Hz != s.c.loop.rate_Hz,
        "the feed-forward was learned at {s.learned.head.rate_Hz:g} Hz, with other delays than at "
        "loop.rate_Hz {c.loop.rate_Hz:g}: learn again from a run at this rate",
    ),
    "feedforward.fade_s": Warning(
        lambda s: s.learned and above(s.learned.fading_N, s.c.limits.force_step_N),
        "the feed-forward changes by up to {value:.3g} N a tick as it fades, and limits.force_step_N "
        "{limit:g} clips it: increase feedforward.fade_s, or raise the limit",
    ),
    "feedforward changes": Warning(
        lambda s: s.learned and above(s.learned.along_N, s.c.limits.force_step_N),
        "the feed-forward changes by up to {value:.3g} N a tick, and limits.force_step_N {limit:g} clips it: "
        "lower feedforward.limit_N and learn again, or raise the limit",
    ),
    "feedforward.limit_N": Warning(
        lambda s: s.learned and above(s.learned.pushed_m_s2, s.c.monitor.disturbance_m_s2),
        "a wrong feed-forward pushes a leg by {value:.2g} m/s^2, above monitor.disturbance_m_s2 {limit:g}: "
        "the certificate may alarm; lower feedforward.limit_N and learn again, or raise the disturbance",
    ),
    "platform joints": Warning(
        crossing,
        "platform: the axes of legs {text} of each other: mostly the order of base_joints_m or "
        "platform_joints_m is wrong",
    ),
    "reference.path": Warning(lambda s: rough_rows(s.c), "{text}"),
    "plant.model.brake": Warning(lambda s: falls(s.c), "{text}"),
    "plant.model.allow_execution_tool": Warning(
        lambda s: s.needs_tool,
        "{c.plant.model.path} needs {s.tool} at run time: without it the run does not start",
    ),
    "plant.model legs": Warning(
        lambda s: [] if s.probe is None else findings(s.probe, model_mobility(s.c)), "{text}"
    ),
    "plant.model.step_us": Warning(lambda s: s.unfit_step, "{c.plant.model.path}: {text}"),
    "plant.model reports": Warning(lambda s: s.notes, "{c.plant.model.path}: {text}"),
    "plant.model coupling": Warning(
        _uncoupled,
        "no platform couples the legs of the FMU, but controller.law {c.controller.law} compensates one: "
        "write, as in the shipped configuration bench, controller.law: pd with kp_N_m = m wn^2, "
        "kv_N_s_m = 2 m wn, m = {m:.3g} kg of a leg, and platform.gravity_m_s2: [0, 0, 0]",
    ),
    "schema": Warning(
        lambda s: not schema_is_there(s.c.text, s.c.folder) and {"named": named_schema(s.c.text)},
        "the schema {named} is missing (`Unable to load schema`): `hil schema {c.source}` sets the right one",
    ),
}
