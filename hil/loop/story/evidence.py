"""Evidence of a fault: measured values and limits in its tick, per leg or for the whole platform."""

import traceback
from collections.abc import Callable, Iterable, Iterator
from math import isfinite, sqrt

import numpy as np

from drivers.signals import LEGS, BusState, Doubt, DriveMode, DriveState, Foreign, Mode
from hil.loop.cycle import REST_PATIENCE_S
from hil.loop.modes import DRIVE_PATIENCE_S, drive_mode
from hil.loop.obedience import FASTER_m_s
from hil.loop.report import because
from hil.loop.story.story import Evidence, Moment
from hil.safety.motion import CREEP, REST_m_s
from hil.safety.residuals import WINDOW_S
from hil.safety.signals import DEAD_BUS, IN_A_ROW, UNRELIABLE

_REACHED = {DriveMode.READY: DriveState.READY, DriveMode.RUN: DriveState.RUN}
"""State that a drive reports in a commanded mode; OFF for the other modes."""
_OF_LEGS = ("length", "rate", "drive_force", "q", "dq", "q_d", "dq_d", "ddq_d")
_OF_ALL = ("p", "R", "twist", "J", "twist_d", "dtwist_d")
_WAIT_FOR_DRIVES = frozenset({Mode.LOADING, Mode.RELEASING, Mode.PARKING})
_AXES = ("x", "y", "z", "rx", "ry", "rz")
_DOUBTS = {
    Doubt.JUMP: "between two readings of leg {leg} the change of length is {mm:+.3f} mm off its rate "
    "(limit: {mm_limit:.3f} mm): its encoder jumped, or its rate is wrong",
    Doubt.SLIP: "length and rate of leg {leg} drifted {mm:+.3f} mm apart within "
    f"{1e3 * WINDOW_S:g} ms "
    "(limit: {mm_limit:.3f} mm): its encoder slips, or its rate is stuck",
    Doubt.LEAP: "the rate of leg {leg} changed by {mm:+.1f} mm/s at once; forces and disturbance explain "
    "{mm_limit:.1f} mm/s: its encoder failed, its brake closed, or a force acts along this leg",
    Doubt.STILL: "leg {leg} stands still while it or another leg strays from its reference by {mm:.3f} mm "
    "(limit: {mm_limit:.3f} mm), and pushes beyond friction did not move it: its encoder is frozen, or its "
    "brake did not open or has closed",
    Doubt.SECOND: "the second encoder of leg {leg} reads {mm:+.3f} mm more than the drive's (limit: "
    "{mm_limit:.3f} mm), and closed brake or tracker agree with it: the drive's encoder is wrong",
    Doubt.EITHER: "the second encoder of leg {leg} reads {mm:+.3f} mm more than the drive's (limit: "
    "{mm_limit:.3f} mm): one of the two is wrong; neither brake nor tracker nor forces show which",
}
"""Simplest causes for a contradiction between an encoder and its rate, the forces or the other legs."""
Source = Callable[[Moment], Iterable[Evidence]]


def legs_of(bits: int) -> Iterator[int]:
    """Legs (0..5) whose bits are set."""
    return (leg for leg in range(LEGS) if bits >> leg & 1)


def compared(column: str, limit: str | float, unit: str, key: str = "") -> Source:
    """Function that gives the evidence from a column: its value, or each leg's if beyond the limit.

    limit: a number, or the name of one of safety's limits.
    """

    def evidence(m: Moment) -> Iterator[Evidence]:
        most = m.limit(limit) if isinstance(limit, str) else limit
        values = m.tick[column].tolist()
        if not isinstance(values, list):
            yield Evidence(values, most, None, "", unit, key)
            return
        for leg, value in enumerate(values):
            if abs(value) > most:
                yield Evidence(abs(value), most, leg, "", unit, key)

    return evidence


def kinematics(m: Moment) -> Iterator[Evidence]:
    """Evidence: residual of the forward kinematics, or that Newton's method found no pose."""
    residual = m.tick["fk_residual"].item()
    text = "" if isfinite(residual) else "no pose near the last one has these leg lengths: residual {value}"
    yield Evidence(residual, m.limit("consistency_m"), None, text, "m", "limits.consistency_m")


def second_controller(m: Moment) -> Iterator[Evidence]:
    """Evidence: kinds of frames that another controller has sent."""
    yield Evidence(", ".join(str(kind.name) for kind in Foreign(int(m.tick["foreign"])) & ~Foreign.ESTOP))


def duplicate_node(m: Moment) -> Iterator[Evidence]:
    """Evidence: legs whose nodes gave two different answers to one SYNC."""
    return (Evidence(leg=leg) for leg in legs_of(int(m.tick["doubled"])))


def set_up(m: Moment) -> Iterator[Evidence]:
    """Evidence: legs whose drives report a set-up that was not sent, and that set-up."""
    lacks = m.cycle.end.lacks()
    return (Evidence(lacks[leg] or "", "", leg) for leg in legs_of(int(m.tick["altered"])))


def estop(m: Moment) -> Iterator[Evidence]:
    """Evidence: who requested the emergency stop."""
    another = bool(int(m.tick["foreign"]) & Foreign.ESTOP)
    yield Evidence("sent by another node on the bus" if another else "requested at this controller")


def bus(m: Moment) -> Iterator[Evidence]:
    """Evidence: a bus that is off, or one that accepts no frames."""
    off = int(m.tick["bus_off"])
    if not off:
        refused = m.memory("refused")
        if refused % (1 << IN_A_ROW) == (1 << IN_A_ROW) - 1:
            text = "the bus accepted no frames of the controller in {value} ticks in a row (limit: {limit})"
            yield Evidence(IN_A_ROW, IN_A_ROW, None, text, "ticks")
            return
        yield Evidence(refused.bit_count(), DEAD_BUS, unit="ticks")
        return
    names = [name for bus, name in enumerate(m.cycle.parts.buses) if off >> bus & 1]
    which = f"bus {' and bus '.join(names)}" if names else "the bus"
    why = "its interface is down or missing, or sends nothing"
    if m.tick["bus_state"] == BusState.OFF:
        why = "its controller has counted too many errors"
    yield Evidence("off", sentence=f"{which} is off: {why}")


def refused_frames(m: Moment) -> Iterator[Evidence]:
    """Evidence: number of ticks with refused frames."""
    yield Evidence(m.memory("untrusted").bit_count(), UNRELIABLE, unit="ticks")


def stale(m: Moment) -> Iterator[Evidence]:
    """Evidence: legs without readings, with refused frames, or with invalid lengths."""
    limit, ages = m.limit("stale_fault_ticks"), m.legs("counted_age")
    if max(ages) < limit:
        ages = m.legs("age")  # a brake test takes no estimate for a measurement
    blind, refused = m.legs("blind"), m.memory("untrusted")
    answer, why = "reading", ""
    if refused % (1 << limit):
        answer = "valid frame"
        why = (
            f": frames came but were refused (length, checksum or state) in {refused.bit_count()} of the "
            "last 32 ticks: check wiring, termination, gateways and bit rates"
        )
    text = f"no {answer} for {{value}} ticks (limit: {{limit}}, {{key}})"
    more = {"unit": "ticks", "key": "limits.stale_fault_ticks"}
    if min(ages) >= limit and not any(blind):
        watched = m.cycle.parts.protocol.traits.has_watchdog
        why = why or (
            ": the drives, the bus or this machine had stalled for "
            f"{1e3 * min(ages) / m.cycle.parts.rate_Hz:.0f} ms by then; if it was this machine, lower "
            f"loop.rate_Hz{' and lengthen drives.watchdog_ms' if watched else ''}"
        )
        yield Evidence(min(ages), limit, None, f"all six legs gave {text}{why}", **more)
        return
    no_length = (
        "the drive of leg {leg} has reported an invalid length for {value} ticks (limit: {limit}, {key})"
    )
    for leg, age in enumerate(ages):
        if age >= limit:
            yield Evidence(
                age, limit, leg, no_length if blind[leg] else f"leg {{leg}} gave {text}{why}", **more
            )
    if max(ages) < limit:
        unproven = "the brake of leg {leg} cannot be proven: its encoder has slipped"
        yield from (Evidence(leg=leg, sentence=unproven) for leg in legs_of(int(m.tick["legs_slipped"])))


def drive(m: Moment) -> Iterator[Evidence]:
    """Evidence: drives in another state than commanded, with reason and waiting time."""
    refused = int(m.tick["legs_refused"]) & ~int(m.before["legs_refused"])
    for leg in legs_of(refused):
        rate, force = m.legs("rate")[leg], m.before["tau"][leg]
        text = (
            f"drive {leg} does not obey: at {force:+.0f} N its leg moves at {rate:+.2f} m/s and gets faster: "
            "swapped wires, a wrong sign, or a force along this leg; its force is now off"
        )
        yield Evidence(abs(rate), FASTER_m_s, leg, text)
    if refused:
        return
    asked = _REACHED.get(drive_mode(m.mode), DriveState.OFF)
    waited_s = m.cycle.durations.least(m.mode) + DRIVE_PATIENCE_S
    late = m.mode in _WAIT_FOR_DRIVES and m.elapsed_s >= waited_s
    since = f" {m.elapsed_s:.2f} s after the command (limit: {waited_s:.2f} s)" if late else ""
    all_ran = m.cycle.parts.safety.memory["running"] != 0
    states = m.legs("drive_state")
    if late and all(state == asked for state in states):
        states = m.before["drive_state"].tolist()  # they came in the very tick in which it was too late
    for leg, (state, fault) in enumerate(zip(states, m.legs("drive_fault"), strict=True)):
        lost = state in (DriveState.FAULT, DriveState.BOOT)
        if not lost and (state == asked or not (late or all_ran)):
            continue
        name = DriveState(state).name
        why = because(fault, m.cycle.parts.protocol.fault_text(int(fault)))
        text = f"drive {leg} in {name}{why} instead of {asked.name}{since}"
        if state == DriveState.OFF and not late:
            text += " without a command of the controller"
        yield Evidence(name, asked.name, leg, text)


def brake(m: Moment) -> Iterator[Evidence]:
    """Evidence: legs that moved on closed brakes, and their distances."""
    limit, moved = m.limit("standstill_m"), m.cycle.parts.safety.moved_m(m.tick).tolist()
    for leg in legs_of(int(m.tick["legs_moved"])):
        yield Evidence(moved[leg], limit, leg, "", "m", "limits.standstill_m")


def encoder(m: Moment) -> Iterator[Evidence]:
    """Evidence: legs whose encoder contradicts rate and force, or has slipped."""
    doubted = int(m.tick["legs_doubted"])
    if doubted:
        doubt, value, limit = (m.tick[name].item() for name in ("doubt", "doubt_value", "doubt_limit"))
        unit = "m/s" if doubt == Doubt.LEAP else "m"
        yield from (Evidence(value, limit, leg, _DOUBTS[Doubt(doubt)], unit) for leg in legs_of(doubted))
    fusion = m.cycle.parts.fusion
    if fusion is not None:
        off, slip_m = m.legs("innovation_q"), fusion.record["slip_m"].item()
        for leg in fusion.contradicting:
            yield Evidence(abs(off[leg]), slip_m, leg, unit="m", key="estimation.fusion.encoder_slip_m")


def uncertain(m: Moment) -> Iterator[Evidence]:
    """Evidence: uncertainty of the fused position, or the silence of the tracker."""
    fusion = m.cycle.parts.fusion
    if fusion is None:
        return
    names = "position_std_m", "std_max_m", "alone_s", "gap_max_s"
    std_m, std_max_m, alone_s, gap_max_s = (fusion.record[name].item() for name in names)
    if not std_m <= std_max_m:
        yield Evidence(std_m, std_max_m, unit="m", key="estimation.fusion.position_std_max_m")
    if not alone_s <= gap_max_s:
        text = "no usable tracker sample for {mm:.0f} ms while an encoder is lost ({key}: {mm_limit:g} ms)"
        yield Evidence(alone_s, gap_max_s, None, text, "s", "estimation.fusion.tracker_gap_max_ms")


def not_finite(m: Moment) -> Iterator[Evidence]:
    """Evidence: first column with a value that is not finite, per leg or for the platform."""
    named = set()
    for column in (*_OF_LEGS, *_OF_ALL):
        values = m.tick[column]
        for at in np.argwhere(~np.isfinite(values)):
            leg = int(at[0]) if column in _OF_LEGS else None
            if leg not in named:
                named.add(leg)
                where = column if leg is None else f"{column} of leg {leg}"
                yield Evidence(
                    values[tuple(at)].item(), "a finite number", leg, where + " is {value}, not {limit}"
                )


def law(m: Moment) -> Iterator[Evidence]:
    """Evidence: exception that the control law raised, or legs whose force is not finite."""
    raised = m.cycle.effort.law.keeps.raised
    if raised is not None:
        where = traceback.extract_tb(raised.__traceback__)[-1]
        value = f"{type(raised).__name__}: {raised} ({where.filename}, line {where.lineno})"
        yield Evidence(value, sentence="the law raised {value}")
        return
    for leg, force in enumerate(m.legs("tau_asked")):
        if not isfinite(force):
            yield Evidence(force, "a finite force", leg, unit="N")


def stroke(m: Moment) -> Iterator[Evidence]:
    """Evidence: legs beyond a hard end of the stroke, or too fast before a soft one."""
    margin, deceleration = m.limit("stroke_margin_m"), m.limit("deceleration_m_s2")
    for leg, (q, dq) in enumerate(zip(m.legs("q"), m.legs("dq"), strict=True)):
        for name, way in (("length_min_m", -1.0), ("length_max_m", 1.0)):
            end = m.limit(name)
            beyond = way * (q - end)
            left = -margin - beyond
            allowed = max(sqrt(2.0 * deceleration * max(left, 0.0)), CREEP)
            if beyond > 0.0:
                text = "leg {leg} is {value:.4f} m long, beyond its hard end ({key}: {limit:.4f} m)"
                yield Evidence(q, end, leg, text, "m", f"platform.{name}")
            elif way * dq > allowed:
                text = (
                    f"leg {{leg}} moves at {{value:.4f}} m/s, {1e3 * left:.2f} mm before its soft end; "
                    "it stops in time from at most {limit:.4f} m/s ({key})"
                )
                yield Evidence(way * dq, allowed, leg, text, "m/s", "limits.deceleration_m_s2")


def following(m: Moment) -> Iterator[Evidence]:
    """Evidence: legs too far from their reference, or else those that do not come to rest."""
    off = np.abs(m.tick["q_d"] - m.tick["q"])
    limits = m.limit("following_error_m") + m.limit("following_error_s") * np.abs(m.tick["dq_d"])
    lagging = np.flatnonzero(off > limits).tolist()
    for leg in lagging:
        yield Evidence(off[leg].item(), limits[leg].item(), leg, unit="m", key="limits.following_error_m")
    for leg, rate in enumerate(m.legs("dq")):
        if not lagging and abs(rate) >= REST_m_s:
            text = (
                f"leg {{leg}} still moves at {{value:.3f}} m/s {REST_PATIENCE_S:g} s after its motion has "
                "ended; at rest means below {limit:g} m/s"
            )
            yield Evidence(abs(rate), REST_m_s, leg, text, "m/s")


def certificate(m: Moment) -> Iterator[Evidence]:
    """Evidence: axes whose error grew beyond the certificate's limit, with the worst axis's share."""
    share, safety = m.tick["lyapunov_share"].item(), m.cycle.parts.safety
    pose = safety.watches_pose
    for axis in safety.broken_axes():
        name = _AXES[axis] if pose else f"of leg {axis}"
        text = (
            f"axis {name} violates the certificate: sqrt(V) of the worst axis is {{value:.3f}} times the "
            "largest value that a disturbance within {key} explains"
        )
        key = f"monitor.disturbance_{'rad' if pose and axis >= len(_AXES) // 2 else 'm'}_s2"
        yield Evidence(share, 1.0, None if pose else axis, text, "1", key)
