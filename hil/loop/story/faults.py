"""The table of faults for the fault report, one row each; causes stand before their effects."""

from collections.abc import Iterator
from typing import NamedTuple

from drivers.signals import Fault
from hil.loop.story import evidence
from hil.loop.story.story import Evidence, Finding, Moment
from hil.safety.motion import HOP


class FaultRow(NamedTuple):
    """One fault: its sentence, its evidence, and the advice to the user."""

    fault: Fault
    sentence: str
    """Format of one line, with leg, value, limit, key, and mm, mm_limit: both in thousandths. Empty: `find`
    gives each line its own sentence."""
    find: evidence.Source
    """Gives the evidence in the tick of the fault; none if it is no longer known."""
    advice: str
    """Advice to the user: what to do next."""


_CLEAR = "start again with --reset"
_ = FaultRow
FAULTS = (
    _(
        Fault.SECOND_CONTROLLER,
        "another controller is on the bus; frames received from it: {value}",
        evidence.second_controller,
        f"find who else sends on this bus and stop it; then {_CLEAR}",
    ),
    _(
        Fault.DUPLICATE_NODE,
        "the node number of leg {leg} gave two different answers to one SYNC: two nodes may share it",
        evidence.duplicate_node,
        "give each drive its own node number (drives.node_ids), or find the other node with this number",
    ),
    _(
        Fault.SET_UP,
        "drive {leg} reports a set-up that this controller did not send: {value}",
        evidence.set_up,
        f"find the sender of CONFIG, or why the drive has lost its set-up; then {_CLEAR}",
    ),
    _(
        Fault.ESTOP,
        "an emergency stop was {value}",
        evidence.estop,
        f"make sure that the cause is gone; then {_CLEAR}",
    ),
    _(
        Fault.BUS,
        "the bus accepted no frames of the controller in {value} of the last 32 ticks (limit: {limit})",
        evidence.bus,
        "check cable, termination, bit rates and that at least one drive has power; then start again",
    ),
    _(
        Fault.REFUSED_FRAMES,
        "frames from the drives were refused as invalid in {value} of the last 32 ticks (limit: {limit})",
        evidence.refused_frames,
        "check wiring, shield, termination, bit rates, and any gateway that rewrites frames",
    ),
    _(
        Fault.STALE,
        "",
        evidence.stale,
        "check power, cable and encoder of these legs; if all six are listed, the load of this machine; if "
        "frames were refused, wiring, gateways and bit rates",
    ),
    _(Fault.DRIVE, "", evidence.drive, f"look up the drive's reason and fix it; then {_CLEAR}"),
    _(
        Fault.BRAKE,
        "leg {leg} moved {mm:.2f} mm although it had to stand still ({key}: {mm_limit:g} mm): its brake or "
        "its encoder slipped",
        evidence.brake,
        "support the platform before anything else, then fix the brake of this leg, or its encoder",
    ),
    _(
        Fault.ENCODER,
        "the encoder of leg {leg} is {mm:.3f} mm off the fused pose ({key}: {mm_limit:g} mm)",
        evidence.encoder,
        "check encoder, coupling, zero and brake of this leg before the next start; if the encoder is only "
        "noisy, set monitor.length_noise_m",
    ),
    _(
        Fault.UNCERTAIN,
        "the position is known only to {mm:.2f} mm ({key}: {mm_limit:g} mm)",
        evidence.uncertain,
        "restore the lost encoder or the tracker",
    ),
    _(Fault.NOT_FINITE, "", evidence.not_finite, "keep the log and report this defect of the program"),
    _(
        Fault.KINEMATICS,
        "no pose fits the six leg lengths better than {mm:.4g} mm ({key}: {mm_limit:g} mm)",
        evidence.kinematics,
        "check zero and scale of the encoders, and section platform (`hil calibrate`)",
    ),
    _(
        Fault.ASSEMBLY,
        "the pose may have jumped to another assembly mode (column hop: {value:.3f}, limit: {limit:g})",
        evidence.compared("hop", HOP, "1"),
        "keep the reference away from singular poses (`hil check`), and check the encoders",
    ),
    _(
        Fault.CONDITION,
        "the condition number of the Jacobian is {value:.4g} ({key}: {limit:g})",
        evidence.compared("condition", "condition", "1", "limits.condition"),
        "keep the reference away from singular poses: `hil check`, `hil workspace`",
    ),
    _(
        Fault.LAW,
        "the law's force for leg {leg} is {value} N, not {limit}",
        evidence.law,
        "keep the log; check the law's parameters, and whether the pose was singular",
    ),
    _(
        Fault.STROKE,
        "",
        evidence.stroke,
        "keep the reference inside the stroke (`hil check`); move a leg beyond its end back by hand",
    ),
    _(
        Fault.SPEED,
        "leg {leg} moves at {value:.4f} m/s ({key}: {limit:g} m/s)",
        evidence.compared("dq", "speed_m_s", "m/s", "limits.speed_m_s"),
        "check the reference (`hil check`), sign and scale of rate and force, and pushes on the platform",
    ),
    _(
        Fault.FOLLOWING,
        "leg {leg} is {mm:.2f} mm off its reference (limit at its speed: {mm_limit:.2f} mm, {key})",
        evidence.following,
        "check sign and size of the leg's force, its brake, its friction, the payload, the limits of the "
        "force, and the error that the resolution of the drive's force leaves (`hil check` prints it)",
    ),
    _(
        Fault.CERTIFICATE,
        "",
        evidence.certificate,
        "compare load and model (payload, friction, delay), or raise monitor.disturbance_m_s2",
    ),
)
"""Sorted from cause to effect: of several faults in one tick the first is the likely cause."""
del _


def findings(m: Moment, faults: Fault) -> Iterator[Finding]:
    """Findings (report lines) of the faults that strike in a tick, causes first.

    A fault without evidence in its tick gives a finding with its name alone.
    """
    tick = int(m.tick["tick"])
    when = tick, tick / m.cycle.parts.rate_Hz, m.mode.name
    for row in FAULTS:
        if faults & row.fault:
            for seen in list(row.find(m)) or [Evidence()]:
                text = "" if seen == Evidence() else seen.text(row.sentence)
                where = seen.leg, seen.value, seen.limit, seen.unit, seen.key, text, row.advice
                yield Finding(*(str(row.fault.name), *when, *where))
