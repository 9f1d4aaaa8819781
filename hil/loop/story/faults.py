"""The table of faults: one row each, causes before what they lead to."""

from collections.abc import Iterator

from drivers.signals import Fault, Foreign
from hil.loop.story import looks
from hil.loop.story.told import FaultRow, Finding, Moment, Seen, sentence_of
from hil.safety.motion import HOP
from hil.safety.signals import UNRELIABLE

OWN = ""
"""Of a row whose `look` gives each line a sentence of its own."""
_CLEAR = "start again with --reset"
_ = FaultRow
FAULTS = (
    _(
        Fault.SECOND_CONTROLLER,
        "another controller is on the bus, heard: {value}; one bus has one controller",
        lambda m: [Seen(", ".join(str(k.name) for k in Foreign(int(m.tick["foreign"])) & ~Foreign.ESTOP))],
        f"find who else sends on this bus and stop it; then {_CLEAR}",
    ),
    _(
        Fault.DUPLICATE_NODE,
        "two different answers to one SYNC from the node of leg {leg}: one number a node",
        lambda m: (Seen(leg=leg) for leg in looks.legs_of(int(m.tick["doubled"]))),
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
        "frames of the drives were refused in {value} of the last 32 ticks; {limit} are a fault: check "
        "wiring, termination, bit rates",
        lambda m: [Seen(m.remembered("untrusted").bit_count(), UNRELIABLE, unit="ticks")],
        "check wiring, shield, termination and bit rates, and what rewrites frames (a gateway)",
    ),
    _(
        Fault.STALE,
        looks.NOT_HEARD,
        looks.stale_or_refused,
        "check power, cable and encoder of the legs named; with all six, the load of this machine; where "
        "frames were refused, wiring, gateways and bit rates",
    ),
    _(
        Fault.DRIVE,
        OWN,
        looks.drive,
        f"look up the drive's reason and mend it; then {_CLEAR}",
    ),
    _(
        Fault.BRAKE,
        "leg {leg} moved {mm:.2f} mm, {key} is {mm_limit:g} mm: its brake slipped, or its encoder did",
        looks.brake,
        "support the platform before anything else, then mend the brake of the leg named, or its encoder",
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
    _(
        Fault.NOT_FINITE,
        OWN,
        looks.not_finite,
        "keep the log and report it: no finite measurement leads here",
    ),
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
        lambda m: [Seen(m.tick["hop"].item(), HOP, unit="1")],
        "keep the reference away from singular poses (`hil check`), and check the encoders",
    ),
    _(
        Fault.CONDITION,
        "the condition number of J is {value:.4g}, {key} is {limit:g}",
        lambda m: [Seen(m.tick["condition"].item(), m.limit("condition"), None, "", "1", "limits.condition")],
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
        OWN,
        looks.stroke,
        "keep the reference inside the stroke (`hil check`); a leg beyond its end is moved back by hand",
    ),
    _(
        Fault.SPEED,
        "leg {leg} moves at {value:.4f} m/s, {key} is {limit:g} m/s",
        looks.speed,
        "check the reference (`hil check`), sign and scale of rate and force, and what pushed the platform",
    ),
    _(
        Fault.FOLLOWING,
        OWN,
        looks.following,
        "check sign and size of the leg's force, its brake, its friction, the payload, the limits of the "
        "force, and what one step of the drive's force leaves of the error (`hil check` prints it)",
    ),
    _(
        Fault.CERTIFICATE,
        OWN,
        looks.certificate,
        "compare load and model (payload, friction, delay), or allow more in monitor.disturbance_m_s2",
    ),
)
"""In the order of cause and effect: of several faults of one tick the first is the likely cause."""
del _


def findings(m: Moment, faults: Fault) -> Iterator[Finding]:
    """Tell of each of the faults that strike in a moment, causes first.

    One without a row has its name alone, and so has one that its tick does not show.
    """
    tick = int(m.tick["tick"])
    when = tick, tick / m.cycle.parts.rate_Hz, m.mode.name
    for row in FAULTS:
        if faults & row.fault:
            name, found = str(row.fault.name), list(row.look(m))
            for seen in found:
                yield Finding(name, *when, seen, sentence_of(row, seen), row.mend)
            if not found:
                yield Finding(name, *when, Seen(), "", row.mend)
            faults &= ~row.fault
    for fault in faults:
        yield Finding(str(fault.name), *when, Seen(), "", "")
