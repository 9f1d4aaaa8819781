"""What the tick of a fault shows of it, at single legs or as a whole, in the rules' own terms."""

import traceback
from collections.abc import Callable, Iterable, Iterator
from math import isfinite, sqrt

import numpy as np

from drivers.signals import LEGS, BusState, Doubt, DriveMode, DriveState, Foreign, Mode
from hil.loop.cycle import REST_PATIENCE_S
from hil.loop.modes import DRIVE_PATIENCE_S, drive_mode
from hil.loop.obedience import FASTER_m_s
from hil.loop.report import because
from hil.loop.story.told import Moment, Seen
from hil.safety.motion import CREEP, REST_m_s
from hil.safety.residuals import WINDOW_S
from hil.safety.signals import DEAD_BUS, IN_A_ROW, UNRELIABLE

_REACHED = {DriveMode.READY: DriveState.READY, DriveMode.RUN: DriveState.RUN}
"""The state that a drive reports once it has obeyed; OFF for the other modes."""
_OF_LEGS = ("length", "rate", "drive_force", "q", "dq", "q_d", "dq_d", "ddq_d")
_OF_ALL = ("p", "R", "twist", "J", "twist_d", "dtwist_d")
_WAIT_FOR_DRIVES = frozenset({Mode.LOADING, Mode.RELEASING, Mode.PARKING})
_AXES = ("x", "y", "z", "rx", "ry", "rz")
_DOUBTS = {
    Doubt.JUMP: "from one reading to the next the length of leg {leg} changed by {mm:+.3f} mm beside "
    "what its rate says, {mm_limit:.3f} mm are allowed: its encoder jumped, or its rate is wrong",
    Doubt.SLIP: "length and rate of leg {leg} came {mm:+.3f} mm apart within "
    f"{1e3 * WINDOW_S:g} ms, "
    "{mm_limit:.3f} mm are allowed: its encoder slips, or its rate is dead",
    Doubt.LEAP: "the rate of leg {leg} leapt by {mm:+.1f} mm/s, forces and the stated disturbance explain "
    "{mm_limit:.1f} mm/s: its encoder, its brake closed, or a force along this leg",
    Doubt.STILL: "leg {leg} stands still, while it or another leg strays from its reference by {mm:.3f} mm, "
    "{mm_limit:.3f} mm are allowed, and pushes by more than friction did not move it: its encoder is frozen, "
    "or its brake did not open or has closed",
}
"""The sparsest causes why rate, forces or the other legs contradict an encoder."""
Look = Callable[[Moment], Iterable[Seen]]


def legs_of(bits: int) -> Iterator[int]:
    """Return the legs whose bits are set."""
    return (leg for leg in range(LEGS) if bits >> leg & 1)


def compared(column: str, limit: str | float, unit: str, key: str = "") -> Look:
    """Look at a column: one number, or six, of which those count whose size is beyond the limit.

    limit: that number, or the name of one of safety's limits.
    """

    def look(m: Moment) -> Iterator[Seen]:
        most = m.limit(limit) if isinstance(limit, str) else limit
        values = m.tick[column].tolist()
        if not isinstance(values, list):
            yield Seen(values, most, None, "", unit, key)
            return
        for leg, value in enumerate(values):
            if abs(value) > most:
                yield Seen(abs(value), most, leg, "", unit, key)

    return look


def kinematics(m: Moment) -> Iterator[Seen]:
    """Give the residual; there is none where Newton's steps find no pose at all."""
    residual = m.tick["fk_residual"].item()
    text = "" if isfinite(residual) else "no pose near the last one has the six lengths: residual {value}"
    yield Seen(residual, m.limit("consistency_m"), None, text, "m", "limits.consistency_m")


def second_controller(m: Moment) -> Iterator[Seen]:
    """Name what another controller has sent."""
    yield Seen(", ".join(str(kind.name) for kind in Foreign(int(m.tick["foreign"])) & ~Foreign.ESTOP))


def duplicate_node(m: Moment) -> Iterator[Seen]:
    """Name the legs whose nodes gave two answers."""
    return (Seen(leg=leg) for leg in legs_of(int(m.tick["doubled"])))


def set_up(m: Moment) -> Iterator[Seen]:
    """Name the legs, and what their drives say."""
    lacks = m.cycle.end.lacks()
    return (Seen(lacks[leg] or "", "", leg) for leg in legs_of(int(m.tick["altered"])))


def estop(m: Moment) -> Iterator[Seen]:
    """Say who asked for it."""
    another = bool(int(m.tick["foreign"]) & Foreign.ESTOP)
    yield Seen("sent by another node on the bus" if another else "asked for at this controller")


def bus(m: Moment) -> Iterator[Seen]:
    """Tell a bus that is off from one that takes no frames."""
    off = int(m.tick["bus_off"])
    if not off:
        refused = m.remembered("refused")
        if refused % (1 << IN_A_ROW) == (1 << IN_A_ROW) - 1:
            text = "the bus did not take our frames in {value} ticks in a row; {limit} are a dead bus"
            yield Seen(IN_A_ROW, IN_A_ROW, None, text, "ticks")
            return
        yield Seen(refused.bit_count(), DEAD_BUS, unit="ticks")
        return
    names = [name for bus, name in enumerate(m.cycle.parts.buses) if off >> bus & 1]
    which = f"bus {' and bus '.join(names)}" if names else "the bus"
    why = "its interface is down or gone, or sends nothing"
    if m.tick["bus_state"] == BusState.OFF:
        why = "its controller has counted too many errors"
    yield Seen("off", sentence=f"{which} is off: {why}")


def refused_frames(m: Moment) -> Iterator[Seen]:
    """Count the ticks with refused frames."""
    yield Seen(m.remembered("untrusted").bit_count(), UNRELIABLE, unit="ticks")


def stale(m: Moment) -> Iterator[Seen]:
    """Name the legs that are not heard, whose frames were refused meanwhile, or without a length."""
    limit, ages = m.limit("stale_fault_ticks"), m.legs("counted_age")
    if max(ages) < limit:
        ages = m.legs("age")  # a brake test takes no estimate for a measurement
    blind, refused = m.legs("blind"), m.remembered("untrusted")
    heard, why = "heard", ""
    if refused % (1 << limit):
        heard = "understood"
        why = (
            f": frames were heard and refused (length, check or state) in {refused.bit_count()} of the last "
            "32 ticks: check wiring, termination, gateways and bit rates"
        )
    text = f"{heard} for {{value}} ticks, {{key}} is {{limit}}"
    told = {"unit": "ticks", "key": "limits.stale_fault_ticks"}
    if min(ages) >= limit and not any(blind):
        watched = m.cycle.parts.protocol.traits.has_watchdog
        why = why or (
            ": the drives, the bus or this machine had stalled for "
            f"{1e3 * min(ages) / m.cycle.parts.rate_Hz:.0f} ms by then; if it was this machine, lower "
            f"loop.rate_Hz{' and lengthen drives.watchdog_ms' if watched else ''}"
        )
        yield Seen(min(ages), limit, None, f"no leg {text}{why}", **told)
        return
    no_length = (
        "the drive of leg {leg} answers, and calls its length invalid for {value} ticks, {key} is {limit}"
    )
    for leg, age in enumerate(ages):
        if age >= limit:
            yield Seen(age, limit, leg, no_length if blind[leg] else f"leg {{leg}} not {text}{why}", **told)
    if max(ages) < limit:
        unproven = "nothing shows that the brake of leg {leg} holds: its encoder has slipped"
        yield from (Seen(leg=leg, sentence=unproven) for leg in legs_of(int(m.tick["legs_slipped"])))


def drive(m: Moment) -> Iterator[Seen]:
    """Name the drives that do not obey, or are not in the state they were asked for, with reason and time."""
    refused = int(m.tick["legs_refused"]) & ~int(m.before["legs_refused"])
    for leg in legs_of(refused):
        rate, force = m.legs("rate")[leg], m.before["tau"][leg]
        text = (
            f"drive {leg} does not obey: at {force:+.0f} N its leg moves at {rate:+.2f} m/s and gets faster: "
            "swapped wires, a wrong sign, or a force along this leg; it gets no force any more"
        )
        yield Seen(abs(rate), FASTER_m_s, leg, text)
    if refused:
        return
    asked = _REACHED.get(drive_mode(m.mode), DriveState.OFF)
    waited_s = m.cycle.durations.least(m.mode) + DRIVE_PATIENCE_S
    late = m.mode in _WAIT_FOR_DRIVES and m.elapsed_s >= waited_s
    since = f", {m.elapsed_s:.2f} s after it was asked; {waited_s:.2f} s are allowed" if late else ""
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
        text = f"drive {leg} in {name}{why} where {asked.name} was asked for{since}"
        if state == DriveState.OFF and not late:
            text += ": not on our command"
        yield Seen(name, asked.name, leg, text)


def brake(m: Moment) -> Iterator[Seen]:
    """Name the legs that moved, and how far."""
    limit, moved = m.limit("standstill_m"), m.cycle.parts.safety.moved_m(m.tick).tolist()
    for leg in legs_of(int(m.tick["legs_moved"])):
        yield Seen(moved[leg], limit, leg, "", "m", "limits.standstill_m")


def encoder(m: Moment) -> Iterator[Seen]:
    """Name the legs whose encoder is doubted, or has slipped."""
    doubted = int(m.tick["legs_doubted"])
    if doubted:
        doubt, value, limit = (m.tick[name].item() for name in ("doubt", "doubt_value", "doubt_limit"))
        unit = "m/s" if doubt == Doubt.LEAP else "m"
        yield from (Seen(value, limit, leg, _DOUBTS[Doubt(doubt)], unit) for leg in legs_of(doubted))
    fusion = m.cycle.parts.fusion
    if fusion is not None:
        off, slip_m = m.legs("innovation_q"), fusion.record["slip_m"].item()
        for leg in fusion.contradicting:
            yield Seen(abs(off[leg]), slip_m, leg, unit="m", key="estimation.fusion.encoder_slip_m")


def uncertain(m: Moment) -> Iterator[Seen]:
    """Tell an uncertain position from a tracker that has been silent for too long."""
    fusion = m.cycle.parts.fusion
    if fusion is None:
        return
    names = "position_std_m", "std_max_m", "alone_s", "gap_max_s"
    std_m, std_max_m, alone_s, gap_max_s = (fusion.record[name].item() for name in names)
    if not std_m <= std_max_m:
        yield Seen(std_m, std_max_m, unit="m", key="estimation.fusion.position_std_max_m")
    if not alone_s <= gap_max_s:
        text = (
            "no tracker sample of use for {mm:.0f} ms while an encoder is lost; {key} allows {mm_limit:g} ms"
        )
        yield Seen(alone_s, gap_max_s, None, text, "s", "estimation.fusion.tracker_gap_max_ms")


def not_finite(m: Moment) -> Iterator[Seen]:
    """Name the first column of each leg, or of all, that is no finite number."""
    named = set()
    for column in (*_OF_LEGS, *_OF_ALL):
        values = m.tick[column]
        for at in np.argwhere(~np.isfinite(values)):
            leg = int(at[0]) if column in _OF_LEGS else None
            if leg not in named:
                named.add(leg)
                where = column if leg is None else f"{column} of leg {leg}"
                yield Seen(
                    values[tuple(at)].item(), "a finite number", leg, where + " is {value}, not {limit}"
                )


def law(m: Moment) -> Iterator[Seen]:
    """Name what the law raised, or else the legs whose force is no number."""
    raised = m.cycle.effort.law.keeps.raised
    if raised is not None:
        where = traceback.extract_tb(raised.__traceback__)[-1]
        value = f"{type(raised).__name__}: {raised} ({where.filename}, line {where.lineno})"
        yield Seen(value, sentence="the law raised {value}")
        return
    for leg, force in enumerate(m.legs("tau_asked")):
        if not isfinite(force):
            yield Seen(force, "a finite force", leg, unit="N")


def stroke(m: Moment) -> Iterator[Seen]:
    """Name the legs beyond a hard end, or too fast before a soft one."""
    margin, deceleration = m.limit("stroke_margin_m"), m.limit("deceleration_m_s2")
    for leg, (q, dq) in enumerate(zip(m.legs("q"), m.legs("dq"), strict=True)):
        for name, way in (("length_min_m", -1.0), ("length_max_m", 1.0)):
            end = m.limit(name)
            beyond = way * (q - end)
            left = -margin - beyond
            allowed = max(sqrt(2.0 * deceleration * max(left, 0.0)), CREEP)
            if beyond > 0.0:
                text = "leg {leg} is {value:.4f} m long, {key} is {limit:.4f} m: a hard end"
                yield Seen(q, end, leg, text, "m", f"platform.{name}")
            elif way * dq > allowed:
                text = (
                    f"leg {{leg}} moves at {{value:.4f}} m/s, {1e3 * left:.2f} mm before its soft end; "
                    "with {key} it stops in time from {limit:.4f} m/s"
                )
                yield Seen(way * dq, allowed, leg, text, "m/s", "limits.deceleration_m_s2")


def following(m: Moment) -> Iterator[Seen]:
    """Name the legs that are too far from their reference; else those that do not come to rest."""
    off = np.abs(m.tick["q_d"] - m.tick["q"])
    limits = m.limit("following_error_m") + m.limit("following_error_s") * np.abs(m.tick["dq_d"])
    lagging = np.flatnonzero(off > limits).tolist()
    for leg in lagging:
        yield Seen(off[leg].item(), limits[leg].item(), leg, unit="m", key="limits.following_error_m")
    for leg, rate in enumerate(m.legs("dq")):
        if not lagging and abs(rate) >= REST_m_s:
            text = (
                f"leg {{leg}} still moves at {{value:.3f}} m/s {REST_PATIENCE_S:g} s after its motion has "
                "ended; below {limit:g} m/s it is at rest"
            )
            yield Seen(abs(rate), REST_m_s, leg, text, "m/s")


def certificate(m: Moment) -> Iterator[Seen]:
    """Name the axes that break it; the share is that of the worst."""
    share, safety = m.tick["lyapunov_share"].item(), m.cycle.parts.safety
    pose = safety.watches_pose
    for axis in safety.broken_axes():
        name = _AXES[axis] if pose else f"of leg {axis}"
        text = (
            f"axis {name} breaks the certificate; the worst axis has {{value:.3f}} of the sqrt(V) that a "
            "disturbance within {key} allows"
        )
        key = f"monitor.disturbance_{'rad' if pose and axis >= len(_AXES) // 2 else 'm'}_s2"
        yield Seen(share, 1.0, None if pose else axis, text, "1", key)
