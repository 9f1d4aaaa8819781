"""What the tick of a fault shows of it: one function for each kind of fault, in the rules' own terms."""

import traceback
from collections.abc import Iterator
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
from hil.safety.signals import DEAD_BUS, IN_A_ROW

_REACHED = {
    DriveMode.OFF: DriveState.OFF,
    DriveMode.READY: DriveState.READY,
    DriveMode.RUN: DriveState.RUN,
    DriveMode.RESET: DriveState.OFF,
}
"""The state that a drive reports once it has obeyed."""
_FINITE = (
    "length", "rate", "drive_force", "q", "dq", "p", "R", "twist", "J", "q_d", "dq_d", "ddq_d", "twist_d",
    "dtwist_d",
)  # fmt: skip
_WAIT_FOR_DRIVES = frozenset({Mode.LOADING, Mode.RELEASING, Mode.PARKING})
_AXES = ("x", "y", "z", "rx", "ry", "rz")


NOT_HEARD = "leg {leg} not heard for {value} ticks, {key} is {limit}"


def legs_of(bits: int) -> Iterator[int]:
    """Return the legs whose bits are set."""
    return (leg for leg in range(LEGS) if bits >> leg & 1)


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
    if off:
        names = [name for bus, name in enumerate(m.cycle.parts.buses) if off >> bus & 1]
        which = f"bus {' and bus '.join(names)}" if names else "the bus"
        why = "its interface is down or gone, or sends nothing"
        if m.tick["bus_state"] == BusState.OFF:
            why = "its controller has counted too many errors"
        yield Seen("off", sentence=f"{which} is off: {why}")
        return
    refused = m.remembered("refused")
    row = 1 << IN_A_ROW
    if refused % row == row - 1:
        yield Seen(
            IN_A_ROW, IN_A_ROW,
            sentence="the bus did not take our frames in {value} ticks in a row; {limit} are a dead bus",
            unit="ticks",
        )  # fmt: skip
        return
    yield Seen(refused.bit_count(), DEAD_BUS, unit="ticks")


def stale(m: Moment) -> Iterator[Seen]:
    """Name the silent legs, and those without a length; where all are silent, say where to look."""
    limit, ages = m.limit("stale_fault_ticks"), m.legs("counted_age")
    if max(ages) < limit:
        ages = m.legs("age")  # a brake test takes no estimate for a measurement
    key, blind = "limits.stale_fault_ticks", m.legs("blind")
    if min(ages) >= limit and not any(blind):
        stall_ms = 1e3 * min(ages) / m.cycle.parts.rate_Hz
        watched = m.cycle.parts.protocol.traits.has_watchdog
        lengthen = " and lengthen drives.watchdog_ms" if watched else ""
        text = (
            "no leg heard for {value} ticks, {key} is {limit}: the drives, the bus or this machine had "
            f"stalled for {stall_ms:.0f} ms by then; if it was this machine, lower loop.rate_Hz{lengthen}"
        )
        yield Seen(min(ages), limit, sentence=text, unit="ticks", key=key)
        return
    text = "the drive of leg {leg} answers, and calls its length invalid for {value} ticks, {key} is {limit}"
    for leg, age in enumerate(ages):
        if age >= limit:
            yield Seen(age, limit, leg, text if blind[leg] else "", unit="ticks", key=key)
    if max(ages) < limit:
        text = "nothing shows that the brake of leg {leg} holds: its encoder has slipped"
        yield from (Seen(leg=leg, sentence=text) for leg in legs_of(int(m.tick["legs_slipped"])))


def stale_or_refused(m: Moment) -> Iterator[Seen]:
    """Tell legs that say nothing from those whose frames were refused meanwhile: then nothing has stalled."""
    refused = m.remembered("untrusted")
    meanwhile = refused % (1 << m.limit("stale_fault_ticks"))
    for seen in stale(m):
        if not meanwhile or (seen.leg is not None and seen.sentence):  # such a leg is heard
            yield seen
            continue
        whose = "no leg was understood" if seen.leg is None else "leg {leg} was not understood"
        text = (
            f"{whose} for {{value}} ticks, {{key}} is {{limit}}: frames were heard and refused (length, "
            f"check or state) in {refused.bit_count()} of the last 32 ticks: check wiring, termination, "
            "gateways and bit rates"
        )
        yield seen._replace(sentence=text)


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
    asked = _REACHED[drive_mode(m.mode)]
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
    limit = m.limit("standstill_m")
    moved = m.cycle.parts.safety.moved_m(m.tick).tolist()
    resting = m.mode is Mode.FAULT
    where = "after it had come to rest" if resting else "on its closed brake"
    limits = "{key} is {mm_limit:g} mm: its brake slipped, or its encoder did"
    text = f"leg {{leg}} moved {{mm:.2f}} mm {where}, {limits}"
    for leg in legs_of(int(m.tick["legs_moved"])):
        yield Seen(moved[leg], limit, leg, text, "m", "limits.standstill_m")


DOUBTS = {
    Doubt.JUMP: "from one reading to the next the length of leg {leg} changed by {mm:+.3f} mm beside "
    "what its rate says, {mm_limit:.3f} mm are allowed: its encoder jumped, or its rate is wrong",
    Doubt.SLIP: "length and rate of leg {leg} came {mm:+.3f} mm apart within "
    f"{1e3 * WINDOW_S:g} ms, "
    "{mm_limit:.3f} mm are allowed: its encoder slips, or its rate is dead",
    Doubt.LEAP: "the rate of leg {leg} leapt by {mm:+.1f} mm/s, forces and the stated disturbance explain "
    "{mm_limit:.1f} mm/s: its encoder, its brake closed, or a force along this leg",
    Doubt.STILL: "leg {leg} stands still, while {strayed} by {mm:.3f} mm, {mm_limit:.3f} mm are "
    "allowed, and pushes by more than friction did not move it: its encoder "
    "is frozen, or its brake did not open or has closed",
}
"""What an encoder that rate, forces or the other legs contradict is told as: the sparsest causes."""


def _strayed(m: Moment, leg: int) -> str:
    """Say what is farthest from where it was when the reading of a leg began to stand still."""
    deviation = m.tick["length"] - m.tick["q_d"] - m.cycle.parts.safety.memory["began"][leg]
    farthest = int(np.argmax(np.where(m.tick["age"] == 0, np.abs(deviation), -1.0)))
    return "its reference moved on" if farthest == leg else f"leg {farthest} strayed from its reference"


def encoder(m: Moment) -> Iterator[Seen]:
    """Name the legs whose encoder is doubted, or has slipped."""
    doubted = int(m.tick["legs_doubted"])
    if doubted:
        doubt, value, limit = (m.tick[name].item() for name in ("doubt", "doubt_value", "doubt_limit"))
        unit = "m/s" if doubt == Doubt.LEAP else "m"
        for leg in legs_of(doubted):
            text = DOUBTS[Doubt(doubt)].replace("{strayed}", _strayed(m, leg))
            yield Seen(value, limit, leg, text, unit)
    fusion = m.cycle.parts.fusion
    off = m.legs("innovation_q")
    for leg in fusion.contradicting if fusion is not None else ():
        assert fusion is not None
        slip_m = fusion.record["slip_m"].item()
        yield Seen(abs(off[leg]), slip_m, leg, unit="m", key="estimation.fusion.encoder_slip_m")


def uncertain(m: Moment) -> Iterator[Seen]:
    """Tell an uncertain position from a tracker that has been silent for too long."""
    fusion = m.cycle.parts.fusion
    if fusion is None:
        return
    names = "position_std_m", "std_max_m", "alone_s", "gap_max_s"
    std_m, std_max_m, alone_s, gap_max_s = (fusion.record[name].item() for name in names)
    if not std_m <= std_max_m:
        key = "estimation.fusion.position_std_max_m"
        yield Seen(std_m, std_max_m, unit="m", key=key)
    if not alone_s <= gap_max_s:
        text = (
            "no tracker sample of use for {mm:.0f} ms while an encoder is lost; {key} allows {mm_limit:g} ms"
        )
        key = "estimation.fusion.tracker_gap_max_ms"
        yield Seen(alone_s, gap_max_s, None, text, "s", key)


def not_finite(m: Moment) -> Iterator[Seen]:
    """Name the first column of each leg, or of all, that is no finite number."""
    named = set()
    for column in _FINITE:
        values = m.tick[column]
        bad = np.argwhere(~np.isfinite(values))
        per_leg = values.shape == (LEGS,) and column != "twist" and not column.endswith("twist_d")
        for at in bad:
            leg = int(at[0]) if per_leg else None
            if leg not in named:
                named.add(leg)
                where = f"{column} of leg {leg}" if per_leg else column
                text = f"{where} is {{value}}, not {{limit}}"
                yield Seen(float(values[tuple(at)]), "a finite number", leg, sentence=text)


def kinematics(m: Moment) -> Iterator[Seen]:
    """Give the residual; there is none where Newton's steps find no pose at all."""
    residual = m.tick["fk_residual"].item()
    text = "" if isfinite(residual) else "no pose near the last one has the six lengths: residual {value}"
    yield Seen(residual, m.limit("consistency_m"), None, text, "m", "limits.consistency_m")


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
    low, high = m.limit("length_min_m"), m.limit("length_max_m")
    margin, deceleration = m.limit("stroke_margin_m"), m.limit("deceleration_m_s2")
    ends = {"length_min_m": (low, -1.0), "length_max_m": (high, 1.0)}
    for leg, (q, dq) in enumerate(zip(m.legs("q"), m.legs("dq"), strict=True)):
        for name, (end, way) in ends.items():
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


def speed(m: Moment) -> Iterator[Seen]:
    """Name the legs that are too fast."""
    limit = m.limit("speed_m_s")
    for leg, rate in enumerate(m.legs("dq")):
        if abs(rate) > limit:
            yield Seen(abs(rate), limit, leg, "", "m/s", "limits.speed_m_s")


def _pushes(m: Moment) -> str:
    """Say which legs were being pushed, as `hil.loop.probe` does."""
    pushed = [(leg, force) for leg, force in enumerate(m.legs("probe_force")) if force != 0.0]
    if not pushed:
        return ""
    (leg, force), *others = pushed
    more = "".join(f", leg {leg} by {force:+.0f} N" for leg, force in others)
    return f"; leg {leg} was being pushed by {force:+.0f} N{more}, to see whether it moves"


def following(m: Moment) -> Iterator[Seen]:
    """Name the legs that are too far from their reference; else those that do not come to rest."""
    at_rest, per_speed = m.limit("following_error_m"), m.limit("following_error_s")
    columns = (m.legs(name) for name in ("q", "q_d", "dq_d", "dq"))
    lagging = False
    resting = []
    for leg, (q, q_d, dq_d, dq) in enumerate(zip(*columns, strict=True)):
        limit = at_rest + per_speed * abs(dq_d)
        if abs(q_d - q) > limit:
            lagging = True
            text = "leg {leg} is {mm:.2f} mm from its reference, at its speed {key} allows {mm_limit:.2f} mm"
            yield Seen(abs(q_d - q), limit, leg, text + _pushes(m), "m", "limits.following_error_m")
        if abs(dq) >= REST_m_s:
            text = (
                "leg {leg} still moves at {value:.3f} m/s "
                f"{REST_PATIENCE_S:g} s after its motion has ended; "
                "below {limit:g} m/s it is at rest"
            )
            resting.append(Seen(abs(dq), REST_m_s, leg, text, "m/s"))
    if not lagging:
        yield from resting


def certificate(m: Moment) -> Iterator[Seen]:
    """Name the axes that break it; the share is that of the worst."""
    share, safety = m.tick["lyapunov_share"].item(), m.cycle.parts.safety
    for axis in safety.broken_axes():
        leg = None if safety.watches_pose else axis
        name = _AXES[axis] if safety.watches_pose else f"of leg {axis}"
        text = (
            f"axis {name} breaks the certificate; the worst axis has {{value:.3f}} of the sqrt(V) that a "
            "disturbance within {key} allows"
        )
        turns = safety.watches_pose and axis >= len(_AXES) // 2
        key = "monitor.disturbance_rad_s2" if turns else "monitor.disturbance_m_s2"
        yield Seen(share, 1.0, leg, text, "1", key)
