"""Who answers on the bus, and whether six drives take their set-up."""

from drivers.signals import LEGS, DriveState, Foreign
from hil.bringup.context import Context, Finding
from hil.bringup.step import Step

LISTEN_S = 0.4
CANOPEN_HEARTBEAT = 0x700
"""CiA 301: identifier of a heartbeat less the node number."""


def find(c: Context) -> None:
    """Poll all drives, commanded off, and set them up: at every start, since drives forget."""
    heard, doubled, foreign, refused = [0] * LEGS, 0, 0, 0
    strange: set[int] = set()
    ticks = c.drives.ticks(LISTEN_S)
    for _ in range(ticks):
        record = c.drives.step()
        for leg in range(LEGS):
            heard[leg] += record["age"][leg] == 0
        doubled |= int(record["doubled"])
        foreign |= int(record["foreign"])
        refused += int(record["rejected"])
        strange |= {each.frame.id for each in c.drives.heard} - c.machine.known_identifiers
    heard = [int(n) for n in heard]
    lacks = c.drives.prepare(None) if min(heard) > 0 and not doubled else ("",) * LEGS
    c.keep("scan", "bus", {"foreign": foreign, "refused": refused, "strange": sorted(strange)})
    for leg in range(LEGS):
        state = DriveState(int(c.drives.record["drive_state"][leg])).name
        fact = {
            "answers": heard[leg] / ticks,
            "twice": bool(doubled >> leg & 1),
            "state": state,
            "lacks": lacks[leg],
        }
        c.keep("scan", leg, fact)


def judge(c: Context) -> list[Finding]:
    """Name drives that are absent, double, of another protocol, or not set up."""
    m, bus, found = c.machine, c.facts["scan"]["bus"], []
    if bus["foreign"]:
        names = ", ".join(str(f.name) for f in Foreign if f and f.value & bus["foreign"])
        found.append(
            Finding("second_controller", (), f"somebody else sends {names}", "End the other controller.")
        )
    facts = [c.known("scan", leg) for leg in range(LEGS)]
    silent = [leg for leg in range(LEGS) if not facts[leg]["answers"]]
    double = [leg for leg in range(LEGS) if facts[leg]["twice"]]
    for leg in double:
        legs = (leg, *silent)
        text = f"two drives answer as node {m.node_ids[leg]}, with different lengths"
        if silent:
            text += f"; no drive answers as node {', '.join(str(m.node_ids[k]) for k in silent)}"
        found.append(Finding("same_id", legs, text, "Give one of the two its own node number."))
    for leg in silent if not double else []:
        found.append(_silent(c, leg, bus))
    for leg in range(LEGS):
        if facts[leg]["lacks"]:
            text = f"node {m.node_ids[leg]} does not take its set-up: {facts[leg]['lacks']}"
            mend = "Compare version, rated force and options of drive and configuration."
            found.append(Finding("set_up", (leg,), text, mend))
    return found


def _silent(c: Context, leg: int, bus: dict[str, object]) -> Finding:
    node = c.machine.node_ids[leg]
    strange = bus["strange"]
    assert isinstance(strange, list)
    if CANOPEN_HEARTBEAT + node in strange:
        text = (
            f"node {node} speaks CANopen: its heartbeat is {CANOPEN_HEARTBEAT + node:#x}, "
            f"{c.machine.protocol} is configured"
        )
        return Finding("wrong_protocol", (leg,), text, "Set the drive to the protocol, or drives.protocol.")
    if bus["refused"]:
        text = f"node {node} is heard, but {bus['refused']} frames are refused: length, check or state"
        return Finding("wrong_protocol", (leg,), text, "Compare bus.layout and the version of the protocol.")
    if strange:
        names = ", ".join(f"{identifier:#x}" for identifier in strange)
        text = (
            f"node {node} does not answer; identifiers of no drive of {c.machine.protocol} are heard: {names}"
        )
        return Finding("absent", (leg,), text, "Look which device sends them, and at its node number.")
    text = f"node {node} does not answer"
    return Finding("absent", (leg,), text, "Look at its power, its cable, its bit rate and its node number.")


STEP = Step(
    "scan",
    "who answers on the bus",
    "polls the six drives and sets their watchdogs; no drive is powered",
    "Ctrl-C; nothing can move",
    find,
    judge,
    kept=False,
)
