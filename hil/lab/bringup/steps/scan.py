"""Who answers on the bus, and whether six drives take their set-up."""

from collections import Counter
from collections.abc import Collection
from typing import NamedTuple

from drivers.protocol import SERIAL, Said
from drivers.signals import LEGS, DriveState, Foreign
from hil.lab.bringup.context import Context, Finding, Step
from hil.lab.bringup.facts import forget_legs

LISTEN_S = 0.4
TWICE = 1.5
"""So many answers a tick, of one that is polled once in it, are those of two drives."""
CANOPEN_HEARTBEAT = 0x700
"""CiA 301: identifier of a heartbeat less the node number."""


def find(c: Context) -> None:
    """Poll all drives, commanded off, and set them up: at every start, since drives forget."""
    c.drives.spoken = spoken = tuple(set[int]() for _ in range(LEGS))
    found = _listened(c)
    lacks = ("",) * LEGS
    if not found.doubled and not found.foreign:
        lacks = c.drives.prepare(None)
        found = _listened(c)  # some do not answer before they are set up, some as they were set up before
        found = found._replace(doubled=found.doubled | _often(c, found.answers))
    c.drives.spoken = None
    bus = {"foreign": found.foreign, "refused": found.refused, "strange": sorted(found.strange)}
    c.keep("scan", "bus", bus)
    for leg in range(LEGS):
        state = DriveState(int(c.drives.record["drive_state"][leg])).name
        fact = {
            "answers": found.heard[leg] / c.drives.ticks(LISTEN_S),
            "twice": bool(found.doubled >> leg & 1),
            "state": state,
            "lacks": lacks[leg],
            "spoken": sorted(spoken[leg]),
            "fault": c.fault_of(leg) if found.heard[leg] and state == DriveState.FAULT.name else "",
        }
        c.keep("scan", leg, fact)
    _recognise(c, [leg for leg in range(LEGS) if found.heard[leg] or spoken[leg]])


def _often(c: Context, answers: Counter[tuple[int, int]]) -> int:
    """Return the bits of drives that answer each poll twice; not where readings are sent unasked, too."""
    if c.drives.protocol.traits.unasked_s > 0.0:
        return 0
    most = TWICE * c.drives.ticks(LISTEN_S)
    legs = {leg for (leg, _), number in answers.items() if leg >= 0 and number > most}
    return sum(1 << leg for leg in legs)


def _recognise(c: Context, heard: Collection[int]) -> None:
    """Drop what is known of legs whose drive is another than the one that was measured, and say so.

    heard: the drives that are asked.
    """
    found = c.drives.identities(heard)
    double = [leg for leg, serials in enumerate(c.drives.serials) if len(serials) > 1]
    for leg in double:
        c.keep("scan", leg, c.known("scan", leg) | {"twice": True})
    before = [
        {
            what: value
            for what, value in (c.known("identity", leg) or {}).items()
            if Said(leg, what, value).tells
        }
        for leg in range(LEGS)
    ]
    others = []
    for leg, (known, said) in enumerate(zip(before, found, strict=True)):
        node = c.machine.node_ids[leg]
        changes = [
            f"{what} {known[what]} -> {said[what]}"
            for what in known
            if what in said and said[what] != known[what]
        ]
        if leg in double:
            continue  # either of two drives may have told last
        if changes:
            others.append(leg)
            same = SERIAL in said and said[SERIAL] == known.get(SERIAL)
            who = "the same drive has changed" if same else "another drive answers"
            c.operator.tell(
                f"  leg {leg}: {who} since it was measured, as node {node} ({', '.join(changes)}): "
                "its steps are done again"
            )
        elif SERIAL in known and SERIAL not in said and c.known("scan", leg)["answers"]:
            c.operator.tell(
                f"  leg {leg}: node {node} has not told its serial number, which was {known[SERIAL]} when it "
                "was measured; if it was exchanged, begin anew with --again"
            )
    if others:
        forget_legs(c.facts, others)
        c.save()  # before who is there now is known: an end between the two leads here again
    for leg, said in enumerate(found):
        if said and leg not in double:
            c.keep("identity", leg, said if leg in others else before[leg] | said)


class _Listened(NamedTuple):
    """What some ticks have brought."""

    heard: list[int]
    """Ticks in which each drive has answered."""
    doubled: int
    foreign: int
    refused: int
    strange: set[int]
    """Identifiers of frames that are nobody's."""
    answers: Counter[tuple[int, int]]
    """How many frames each drive has sent, by drive, -1 for nobody's, and identifier."""


def _listened(c: Context) -> _Listened:
    """Poll the drives, commanded off."""
    heard, doubled, foreign, refused = [0] * LEGS, 0, 0, 0
    strange: set[int] = set()
    answers: Counter[tuple[int, int]] = Counter()
    for _ in range(c.drives.ticks(LISTEN_S)):
        record = c.drives.step()
        for leg in range(LEGS):
            heard[leg] += int(record["age"][leg] == 0)
        doubled |= int(record["doubled"])
        foreign |= int(record["foreign"])
        refused += int(record["rejected"])
        strange |= {each.frame.id for each in c.drives.heard} - c.machine.known_identifiers
        answers.update((c.drives.protocol.sender(frame), frame.id) for _, frame in c.drives.heard)
    return _Listened(heard, doubled, foreign, refused, strange, answers)


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
        text = f"two drives answer as node {m.node_ids[leg]}"
        if len(serials := c.drives.serials[leg]) > 1:
            text += f", with serial numbers {', '.join(map(str, sorted(serials)))}"
        if silent:
            text += f"; no drive answers as node {', '.join(str(m.node_ids[k]) for k in silent)}"
        found.append(Finding("same_id", legs, text, "Give one of the two its own node number."))
    if len(silent) == LEGS and not bus["strange"] and not bus["refused"]:
        text = f"nobody answers, neither node {', '.join(map(str, m.node_ids))} nor another"
        mend = "Look at bit rate, layout, cable, termination and the drives' supply."
        return [*found, Finding("absent", tuple(silent), text, mend)]
    for leg in silent if not double else []:
        found.append(_silent(c, leg, bus))
    for leg in range(LEGS):
        if facts[leg]["fault"]:
            text = f"node {m.node_ids[leg]} stays in FAULT after a RESET: {facts[leg]['fault']}"
            found.append(Finding("drive_fault", (leg,), text, "Look at the drive with its maker's tool."))
        elif facts[leg]["answers"] and facts[leg]["lacks"]:
            text = f"node {m.node_ids[leg]} does not take its set-up: {facts[leg]['lacks']}"
            mend = "Compare version, rated force and options of drive and configuration."
            found.append(Finding("set_up", (leg,), text, mend))
    return found


def _silent(c: Context, leg: int, bus: dict[str, object]) -> Finding:
    node = c.machine.node_ids[leg]
    strange = bus["strange"]
    assert isinstance(strange, list)
    spoken, lacks = (c.known("scan", leg)[key] for key in ("spoken", "lacks"))
    if CANOPEN_HEARTBEAT + node in strange:
        text = (
            f"node {node} speaks CANopen: its heartbeat is {CANOPEN_HEARTBEAT + node:#x}, "
            f"{c.machine.protocol} is configured"
        )
        return Finding("wrong_protocol", (leg,), text, "Set the drive to the protocol, or drives.protocol.")
    if bus["refused"]:
        text = f"node {node} is heard, but {bus['refused']} frames are refused: length, check or state"
        return Finding("wrong_protocol", (leg,), text, "Compare bus.layout and the version of the protocol.")
    if spoken and not c.machine.unasked_identifiers.issuperset(spoken):
        text = f"node {node} is heard, but does not answer the polls: {lacks or 'it confirms its set-up'}"
        mend = "Compare version, rated force and options of drive and configuration."
        return Finding("set_up", (leg,), text, mend)
    if spoken:
        names = ", ".join(f"{identifier:#x}" for identifier in spoken)
        text = f"node {node} sends {names} unasked, and answers nothing: {lacks or 'no poll'}"
        mend = (
            f"Look at its firmware and set it to {c.machine.protocol}; a drive without power sends nothing."
        )
        return Finding("wrong_protocol", (leg,), text, mend)
    if strange:
        names = ", ".join(f"{identifier:#x}" for identifier in strange)
        text = (
            f"node {node} does not answer; identifiers of no drive of {c.machine.protocol} are heard: {names}"
        )
        mend = (
            "Switch this drive off: if these frames end, it speaks another protocol or has another node "
            "number; if they go on, look at its power and cable."
        )
        return Finding("absent", (leg,), text, mend)
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
