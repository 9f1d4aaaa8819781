"""What `hil check` warns about: settings that are allowed and dangerous, one row each."""

from collections.abc import Callable, Iterator, Mapping
from typing import NamedTuple

import numpy as np

from drivers.motors import MotorProtocol
from drivers.transmission import Transmission
from hil.app.check.fmu import backward, falls, uncoupled
from hil.app.check.loose import FACTOR, loose
from hil.app.check.report import Scaled
from hil.app.check.subject import LEAST_MARGIN_DEG, Subject
from hil.app.configuration.schema import named_schema, schema_is_there
from hil.app.operate import REPEAT_S
from hil.control.uncertainty import UncertaintySettings
from hil.mathematics.rounding import lowered
from hil.safety.residuals import SUSPECT, gap_bound

UNSTATED = 3.0
"""A rated force that nobody stated and that is this many times above the limit is a mistake."""
JUMP_SHARE = 0.1
"""A jump of a larger share of the stroke has to be seen."""
FEWEST_TURNS = 0.1
"""Of a motor, in which it carries a leg over its whole stroke."""
FASTEST_rpm = 30_000.0
"""Of a motor."""
STRONGEST_N_m = 1000.0
"""Torque of a motor."""
PAGE_REPEAT_S = 0.05
"""Between two key frames of the page of `hil watch`."""
SEVERAL = 3 - 1e-9
"""Key frames that deadman_s has to hear: one may be late, one lost. And ticks: the loop takes what comes
within a tick at its end."""
MODELS = {
    "constant": "M, G and J frozen at one pose, good for small motion only: 395 mm (constant_MG 2.2 mm)",
    "constant_MG": "M and G frozen at one pose: 2.2 mm (full 0.03 mm)",
    "printed": "without H and without J_dot twist, up to 15.7 % of the force: 2.6 mm (full 0.03 mm)",
}
"""Of a law's model, and what it ends off: book platform, book path (0.6 m, 19 deg), wn 20 rad/s, 1 kHz."""
RATELESS = {"refuse": "refuse (loop.without_realtime)", "slow": "drop to a rate it can hold"}
Values = Mapping[str, object]


class Warning(NamedTuple):  # noqa: A001 - the word of the command
    """A warning: its code, whether it holds, and its sentence.

    `found` returns what the sentence needs besides the subject `s` and its configuration `c`: figures, or
    `text`, or nothing (`True`); several of them for several sentences; none where the setting is harmless.
    """

    code: str
    found: Callable[[Subject], "bool | str | Values | list[str] | list[Values] | None"]
    sentence: str


def warnings(s: Subject) -> Iterator[tuple[str, str]]:
    """Yield code and sentence of each warning that holds."""
    for row in WARNINGS if s.c.bus.layout == "ideal" else (*HARDWARE, *WARNINGS):
        found = row.found(s)
        for each in found if isinstance(found, list) else [found]:
            if each:
                values = each if isinstance(each, Mapping) else {"text": each}
                yield row.code, Scaled().vformat(row.sentence, (), {"s": s, "c": s.c, **values})


def above(value: float | None, limit: float | None) -> Values | None:
    """Return the figures of a value above its limit; None where it is not, or one of them is missing."""
    broken = value is not None and limit is not None and value > limit
    return {"value": value, "limit": limit} if broken else None


def below(value: float | None, limit: float | None) -> Values | None:
    """Return the figures of a value below its limit; None where it is not, or one of them is missing."""
    return None if above(limit, value) is None else {"value": value, "limit": limit}


def _hard_end(s: Subject) -> Values | None:
    if s.silence is None or s.c.reactions.silence != "brake":
        return None
    hit = s.silence.beyond(s.walk, s.c.platform.length_min_m, s.c.platform.length_max_m)
    return hit and hit._asdict()


def _motor(s: Subject) -> list[str]:
    """Say what makes of the stated transmission a motor that there is hardly any of."""
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


def _jump_m(s: Subject) -> float:
    """Smallest jump of a length that is seen."""
    e = s.encoders
    return gap_bound(e.length_noise_m, e.rate_noise_m_s, 2.0 * e.disturbance_m_s2, e.period_s)


def _asked(s: Subject) -> list[Values]:
    """Return what changes of speed, jogs and set-points may ask for beyond a limit."""
    stop = f"make engage.stop_s {s.c.engage.stop_s:g} longer"
    rows: list[tuple[str, float, str, str, str]] = []
    if s.slowed is not None and s.jogged is not None:
        what, mend = (
            "a change of speed along the reference",
            "hold, start or a speed may fault there; " + stop,
        )
        rows += [
            (what, s.slowed.acceleration_m_s2, "m/s^2", "acceleration_m_s2", mend),
            (what, s.slowed.force_N, "N", "force_N", mend),
            (what, s.own_step_N + s.slowed.step_N, "N more in a tick", "force_step_N", mend),
        ]
        what, mend = "a jog from the reference", "lower operator.setup_speed_m_s and setup_speed_deg_s"
        rows += [
            (what, s.jogged.change_N, "N more within 250 ms", "force_window_N", f"{mend}, or {stop}"),
            (what, s.jogged.rate_m_s, "m/s", "speed_m_s", f"SPEED latches, and the brakes close; {mend}"),
        ]
    if s.setpoints is not None:
        what, mend = "set-points on all axes at once", "of reference.limits"
        rows += [
            (what, s.setpoints[0], "m/s", "speed_m_s", f"lower the velocities {mend}"),
            (what, s.setpoints[1], "m/s^2", "deceleration_m_s2", f"lower the accelerations {mend}"),
        ]
    return [
        {"what": what, "unit": unit, "name": name, "mend": mend, **over}
        for what, value, unit, name, mend in rows
        if (over := above(value, getattr(s.c.limits, name)))
    ]


def _felt(s: Subject) -> Values | None:
    stated = getattr(s.c.controller, "uncertainty", None)
    known = stated.acceleration_m_s2 if isinstance(stated, UncertaintySettings) else None
    return above(s.slowed and s.slowed.felt_m_s2, known)


def _unbraked(s: Subject) -> Values | None:
    """Return a braking way before the soft ends that no force keeps to."""
    able = (min(s.c.limits.force_N, s.c.drives.force_limit_N) - s.weight_N) / s.leg_mass_kg
    times = s.c.limits.deceleration_m_s2 / able if able > 0.0 else 0.0
    return {"times": times, "able": able, "give": lowered(able)} if times > FACTOR else None


_NOISE = "give the largest deviation of a reading, 3 to 4 standard deviations"
_KEY = (
    "operator.deadman_s {value:g}: %s, and the platform comes to rest where one of them comes late or is "
    "lost; give {limit:.3g} or more"
)

HARDWARE = (
    Warning(
        "loop.feedback_window_us",
        lambda s: above(max(s.answers_us), s.window_us),
        "SYNC and six feedbacks take {value:.0f} us of bus time and the window is {limit:.0f} us "
        "(loop.feedback_window_us): legs will be stale",
    ),
    Warning(
        "reactions.silence",
        lambda s: s.c.reactions.silence == "zero",
        "reactions.silence zero: after silence nothing holds the platform, whose legs carry "
        "up to {s.weight_N:.0f} N; write brake",
    ),
    Warning(
        "reactions sto",
        lambda s: ", ".join(str(fault.name).lower() for fault in s.c.reactions.led_to("sto")),
        "reactions sto after {text}: the platform falls until the brakes act, and whether "
        "they hold is not tested; sbc keeps the force on until they are proven",
    ),
    Warning(
        "engage.force_ramp_s",
        lambda s: s.c.engage.force_ramp_s <= 0.0,
        "engage.force_ramp_s 0: no brake is ever tested, neither at the start nor when parking",
    ),
    Warning(
        "engage.brake_close_s",
        _hard_end,
        "drives.watchdog_ms {c.drives.watchdog_ms:g} and engage.brake_close_s {c.engage.closing_s:g}: after "
        "silence at t = {t:.3f} s leg {leg}, {free_m:milli.0f} mm from a hard end, travels up to "
        "{travel_m:milli.0f} mm until it rests on its brake; shorten them, or speed or stroke of the path",
    ),
    Warning("drives.protocol", lambda s: [*s.protocol.traits.dangers], "{text}"),
    Warning(
        "drives.homing",
        lambda s: isinstance(s.protocol, MotorProtocol) and s.c.drives.homing is None,
        "drives.homing: left out, so after a power-off nothing compares lengths with where the legs were "
        "parked, and a drive that has forgotten turns of its motor reads a length that is wrong by these",
    ),
    Warning(
        "drives.transmission",
        _motor,
        "drives.transmission: lead_m, pulley_radius_m or gear_ratio: {text} of the motor, as hardly any "
        "does: state the leg length of a turn in m",
    ),
    Warning(
        "monitor.length_noise_m and jumps",
        lambda s: above(_jump_m(s), JUMP_SHARE * s.stroke_m),
        "monitor.length_noise_m {c.monitor.length_noise_m:g}: a jump is seen from {value:milli.3g} mm on, "
        "more than a tenth of the stroke ({limit:milli.3g} mm), so the rules on jumps are without effect; "
        + _NOISE,
    ),
    Warning(
        "monitor.length_noise_m and standstill",
        lambda s: above(SUSPECT * s.encoders.length_noise_m, s.c.limits.following_error_m),
        "monitor.length_noise_m {c.monitor.length_noise_m:g}: a leg that stands still is suspected from "
        "{value:milli.3g} mm on, above limits.following_error_m {limit:g}, so that rule is without effect; "
        + _NOISE,
    ),
    Warning(
        "limits.following_error_m and steps of the force",
        lambda s: above(s.stepped_error_m, s.c.limits.following_error_m),
        "limits.following_error_m {limit:g}: one code of torque is {s.force_step_N:.2g} N at the leg, which "
        "alone may leave it {value:milli.3g} mm from its reference; raise the travel a turn "
        "(drives.transmission), take a weaker model, or raise controller.wn_rad_s",
    ),
    Warning(
        "plant.model.brake_force_N",
        lambda s: above(s.weight_N, None if s.stewart is None else s.stewart.brake_force_N),
        "plant.model.brake_force_N {limit:g} is below the {value:.3g} N that hold the platform: the emulated "
        "brakes slip under its weight; state that of your brakes",
    ),
    Warning(
        "plant.drives brake times",
        lambda s: " and ".join(
            f"plant.drives.{key}"
            for key in ("brake_open_ms", "brake_close_ms")
            if s.c.plant is not None and getattr(s.c.plant.drives, key) == 0.0
        ),
        "{text} 0: the emulated brakes act at once, and nothing shows what real ones cost; state what "
        "yours take",
    ),
    Warning(
        "drives.force_limit_N",
        lambda s: (
            "force_limit_N" not in s.c.drives.model_fields_set
            and above(s.c.drives.force_limit_N / s.c.limits.force_N, UNSTATED)
        ),
        "drives.force_limit_N is not stated, and {c.drives.force_limit_N:.0f} N are assumed as the drives' "
        "rated force, {value:.0f} times limits.force_N {c.limits.force_N:g}: state that of your drives",
    ),
    Warning(
        "limits",
        loose,
        "limits.{name} {value:g} is {times:.1f} times the {needed:.3g} {unit} that are needed {by}; it would "
        "show a failure late, give {give:g}",
    ),
    Warning(
        "limits.deceleration_m_s2",
        _unbraked,
        "limits.deceleration_m_s2 {c.limits.deceleration_m_s2:g} is {times:.1f} times the {able:.3g} m/s^2 "
        "by which limits.force_N can brake a leg that bears the platform: it would not stop before a hard "
        "end; give {give:g}",
    ),
    Warning(
        "loop.without_realtime",
        lambda s: "" if s.fifo else RATELESS[s.c.loop.without_realtime],
        "no SCHED_FIFO: `hil run` will {text}. To get it: `ulimit -r {c.loop.priority}` from a limits.conf "
        "entry `@realtime - rtprio {c.loop.priority}` (and `- memlock unlimited`), or CAP_SYS_NICE",
    ),
)
"""With the layout ideal, which drives no hardware, nobody can stand under these."""


def _unknown(name: str) -> str:
    """Say which interfaces there are where this is none; empty where it is one."""
    if name in {"localcan", "socketcan"}:
        return ""
    from drivers.can.python_can import unknown_interface

    return unknown_interface(name)


WARNINGS = (
    Warning(
        "bus.interface",
        lambda s: [_unknown(name) for name in sorted({each.interface for each in s.c.bus.buses})],
        "{text}",
    ),
    Warning(
        "controller.model.variant",
        lambda s: MODELS.get(s.variant),
        "controller.model.variant {s.variant}: {text} off at the end of the book's path",
    ),
    Warning(
        "controller.boundary_layer_m_s",
        lambda s: s.switches,
        "controller.boundary_layer_m_s 0 switches between two forces at every tick: with "
        "{s.delay.total_s:milli.1f} ms of delay it chatters; make it thicker",
    ),
    Warning(
        "controller phase margin",
        lambda s: s.margin and below(s.margin["phase_margin_deg"], LEAST_MARGIN_DEG),
        "controller.{c.controller.tuning[0]}: about {value:.0f} degrees of phase margin at loop.rate_Hz "
        "{c.loop.rate_Hz:g}, advised: at least {limit:g}; {c.controller.tuning[1]} or raise the rate",
    ),
    Warning("controller.controller_file", lambda s: s.designed and s.designed.warnings, "{text}"),
    Warning(
        "controller.controller_file of another robot",
        lambda s: s.proven is not None and s.proven.figures.get("coupled_axes_covered") is False,
        "controller.controller_file: it was designed for another inertia than the platform and the ranges"
        " of its payload have: `hil stability` shows both; design with `--robot`, or state smaller ranges",
    ),
    Warning(
        "controller unstable",
        lambda s: s.proven is not None and s.proven.status == "unstable",
        "controller: {s.proven.claim}",
    ),
    Warning(
        "limits while operated",
        _asked,
        "{what} may ask for {value:.4g} {unit} of a leg, limits.{name} is {limit:g}: {mend}",
    ),
    Warning(
        "controller.uncertainty.acceleration_m_s2",
        _felt,
        "controller.uncertainty.acceleration_m_s2 {limit:g}: while the speed changes, forces over inertia "
        "are {value:.3g} m/s^2 without the law's linear part; state no less",
    ),
    Warning(
        "operator.deadman_s of hil ctl",
        lambda s: below(s.c.operator.deadman_s, SEVERAL * REPEAT_S),
        _KEY % f"`hil ctl key` speaks every {1e3 * REPEAT_S:g} ms",
    ),
    Warning(
        "operator.deadman_s of the page",
        lambda s: s.c.watch.operate and below(s.c.operator.deadman_s, SEVERAL * PAGE_REPEAT_S),
        _KEY % f"the page of `hil watch` speaks every {1e3 * PAGE_REPEAT_S:g} ms",
    ),
    Warning(
        "operator.deadman_s in ticks",
        lambda s: below(s.c.operator.deadman_s, SEVERAL / s.c.loop.rate_Hz),
        "operator.deadman_s {value:g}: too few ticks at loop.rate_Hz {c.loop.rate_Hz:g} for the loop to "
        "judge; give {limit:.3g} or more",
    ),
    Warning(
        "limits.force_N on the reference",
        lambda s: s.peak_N > 0.9 * s.c.limits.force_N,
        "the reference needs {s.peak_N:.0f} N of limits.force_N {c.limits.force_N:g}: less than 10 % "
        "is left for control",
    ),
    Warning(
        "feedforward rate",
        lambda s: s.learned is not None and s.learned.head.rate_Hz != s.c.loop.rate_Hz,
        "the feed-forward was learned at {s.learned.head.rate_Hz:g} Hz and loop.rate_Hz is "
        "{c.loop.rate_Hz:g}: what it knows of delays is wrong: learn again from a run at this rate",
    ),
    Warning(
        "feedforward.fade_s",
        lambda s: s.learned and above(s.learned.fading_N, s.c.limits.force_step_N),
        "the learned feed-forward alone changes by up to {value:.3g} N a tick as it fades, more than "
        "limits.force_step_N {limit:g}, which cuts it: lengthen feedforward.fade_s, or allow more",
    ),
    Warning(
        "feedforward changes",
        lambda s: s.learned and above(s.learned.along_N, s.c.limits.force_step_N),
        "the learned feed-forward alone changes by up to {value:.3g} N a tick, more than limits.force_step_N "
        "{limit:g}, which cuts it: lower feedforward.limit_N and learn again, or allow more",
    ),
    Warning(
        "feedforward.limit_N",
        lambda s: s.learned and above(s.learned.pushed_m_s2, s.c.monitor.disturbance_m_s2),
        "where the learned feed-forward is wrong it pushes a leg by {value:.2g} m/s^2, more than "
        "monitor.disturbance_m_s2 {limit:g}: the certificate may alarm. Lower feedforward.limit_N and learn "
        "again, or allow more",
    ),
    Warning("plant.model.brake", lambda s: falls(s.c), "{text}"),
    Warning(
        "plant.model.allow_execution_tool",
        lambda s: s.needs_tool,
        "{c.plant.model.path} needs {s.tool} at run time and is taken as plant.model.allow_execution_tool "
        "says: it runs in a child process, and where the tool is missing the run does not start",
    ),
    Warning(
        "plant.model force signs",
        backward,
        "a force > 0 shortens leg {text} of the FMU, and is to extend it: change the sign in the FMU",
    ),
    Warning(
        "plant.model coupling",
        uncoupled,
        "the legs of the FMU do not move each other, and controller.law {c.controller.law} compensates a "
        "platform between them: write, as the shipped configuration bench, controller.law: pd with kp_N_m = "
        "m wn^2, kv_N_s_m = 2 m wn, m = {m:.3g} kg of a leg, and platform.gravity_m_s2: [0, 0, 0]",
    ),
    Warning(
        "schema",
        lambda s: not schema_is_there(s.c.text, s.c.folder) and {"named": named_schema(s.c.text)},
        "the first lines of {c.source} name the schema {named}, which is not there: an "
        "editor says `Unable to load schema`. `hil schema {c.source}` names that of this installation",
    ),
)
