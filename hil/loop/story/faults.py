"""The table of faults: one row each, causes before what they lead to."""

from collections.abc import Iterator
from typing import NamedTuple

from drivers.signals import Fault
from hil.loop.story import looks
from hil.loop.story.told import Finding, Moment, Seen
from hil.safety.motion import HOP


class FaultRow(NamedTuple):
    """One fault."""

    fault: Fault
    sentence: str
    """Format of one line with leg, value, limit, key, and mm, mm_limit: both in thousandths. Empty: `look`
    gives each line a sentence of its own."""
    look: looks.Look
    """Gives what the tick of the fault shows of it; nothing where that is not known any more."""
    mend: str
    """What to do next."""


_CLEAR = "start again with --reset"
_ = FaultRow
FAULTS = (
    _(
        Fault.SECOND_CONTROLLER,
        "another controller is on the bus, heard: {value}; one bus has one controller",
        looks.second_controller,
        f"find who else sends on this bus and stop it; then {_CLEAR}",
    ),
    _(
        Fault.DUPLICATE_NODE,
        "two different answers to one SYNC from the node of leg {leg}: one number a node",
        looks.duplicate_node,
        "give each drive a node number of its own (drives.node_ids), or find who answers in its name",
    ),
    _(
        Fault.SET_UP,
        "drive {leg} reports another set-up than the one sent to it: {value}",
        looks.set_up,
        f"find who sends CONFIG, or why the drive has lost its set-up; then {_CLEAR}",
    ),
    _(
        Fault.ESTOP,
        "an emergency stop was {value}",
        looks.estop,
        f"make sure that the cause is gone; then {_CLEAR}",
    ),
    _(
        Fault.BUS,
        "the bus did not take our frames in {value} of the last 32 ticks; {limit} are a dead bus",
        looks.bus,
        "check cable, termination, bit rates and that at least one drive has power; then start again",
    ),
    _(
        Fault.REFUSED_FRAMES,
        "frames of the drives were refused in {value} of the last 32 ticks; {limit} are a fault",
        looks.refused_frames,
        "check wiring, shield, termination and bit rates, and what rewrites frames (a gateway)",
    ),
    _(
        Fault.STALE,
        "",
        looks.stale,
        "check power, cable and encoder of the legs named; with all six, the load of this machine; where "
        "frames were refused, wiring, gateways and bit rates",
    ),
    _(Fault.DRIVE, "", looks.drive, f"look up the drive's reason and fix it; then {_CLEAR}"),
    _(
        Fault.BRAKE,
        "leg {leg} moved {mm:.2f} mm where it had to stand, {key} is {mm_limit:g} mm: its brake slipped, or "
        "its encoder did",
        looks.brake,
        "support the platform before anything else, then fix the brake of the leg named, or its encoder",
    ),
    _(
        Fault.ENCODER,
        "the encoder of leg {leg} contradicts the pose of the others by {mm:.3f} mm, {key} is "
        "{mm_limit:g} mm",
        looks.encoder,
        "check encoder, coupling, zero and brake of the leg named before the next start; for an encoder that "
        "is only noisy state monitor.length_noise_m",
    ),
    _(
        Fault.UNCERTAIN,
        "the position is known to {mm:.2f} mm only, {key} is {mm_limit:g} mm",
        looks.uncertain,
        "bring the lost encoder or the tracker back",
    ),
    _(Fault.NOT_FINITE, "", looks.not_finite, "keep the log and report it: no finite measurement leads here"),
    _(
        Fault.KINEMATICS,
        "the six lengths fit no pose to better than {mm:.4g} mm, {key} is {mm_limit:g} mm",
        looks.kinematics,
        "check zero and scale of the encoders, and section platform (`hil calibrate`)",
    ),
    _(
        Fault.ASSEMBLY,
        "the pose may belong to another assembly than the last one: measure {value:.3f}, below {limit:g} "
        "it cannot",
        looks.compared("hop", HOP, "1"),
        "keep the reference away from singular poses (`hil check`), and check the encoders",
    ),
    _(
        Fault.CONDITION,
        "the condition number of J is {value:.4g}, {key} is {limit:g}",
        looks.compared("condition", "condition", "1", "limits.condition"),
        "keep the reference away from singular poses: `hil check`, `hil workspace`",
    ),
    _(
        Fault.LAW,
        "the law asks leg {leg} for {value} N, not for {limit}",
        looks.law,
        "keep the log; check the law's parameters, and whether the pose was singular",
    ),
    _(
        Fault.STROKE,
        "",
        looks.stroke,
        "keep the reference inside the stroke (`hil check`); a leg beyond its end is moved back by hand",
    ),
    _(
        Fault.SPEED,
        "leg {leg} moves at {value:.4f} m/s, {key} is {limit:g} m/s",
        looks.compared("dq", "speed_m_s", "m/s", "limits.speed_m_s"),
        "check the reference (`hil check`), sign and scale of rate and force, and what pushed the platform",
    ),
    _(
        Fault.FOLLOWING,
        "leg {leg} is {mm:.2f} mm from its reference, at its speed {key} allows {mm_limit:.2f} mm",
        looks.following,
        "check sign and size of the leg's force, its brake, its friction, the payload, the limits of the "
        "force, and what one step of the drive's force leaves of the error (`hil check` prints it)",
    ),
    _(
        Fault.CERTIFICATE,
        "",
        looks.certificate,
        "compare load and model (payload, friction, delay), or allow more in monitor.disturbance_m_s2",
    ),
)
"""In the order of cause and effect: of several faults of one tick the first is the likely cause."""
del _


def findings(m: Moment, faults: Fault) -> Iterator[Finding]:
    """Tell of each of the faults that strike in a moment, causes first.

    One that its tick does not show has its name alone.
    """
    tick = int(m.tick["tick"])
    when = tick, tick / m.cycle.parts.rate_Hz, m.mode.name
    for row in FAULTS:
        if faults & row.fault:
            for seen in list(row.look(m)) or [Seen()]:
                text = "" if seen == Seen() else seen.text(row.sentence)
                where = seen.leg, seen.value, seen.limit, seen.unit, seen.key, text, row.mend
                yield Finding(*(str(row.fault.name), *when, *where))
