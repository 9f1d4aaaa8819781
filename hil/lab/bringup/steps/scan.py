"""Who answers on the bus, and whether six drives take their set-up."""

from collections import Counter
from collections.abc import Collection, Iterator
from typing import Any

from drivers.protocol import SERIAL
from drivers.signals import LEGS, DriveState, Foreign
from hil.lab.bringup.context import Context, Finding, Step, forget_legs

LISTEN_S = 0.4
TWICE = 1.5
"""So many answers a tick, of one that is polled once in it, are those of two drives."""
CANOPEN_HEARTBEAT = 0x700
"""CiA 301: identifier of a heartbeat less the node number."""


def find(c: Context) -> None:
    """Poll all drives, commanded off, and set them up: at every start, since drives forget."""
    c.drives.spoken = frames = set[tuple[int, int]]()
    heard, doubled, bus = _listened(c)
    lacks = ("",) * LEGS
    if not doubled and not bus["foreign"]:
        lacks = c.drives.prepare(None)
        heard, doubled, bus = _listened(c, often=True)  # some answer only once set up, or otherwise then
    c.drives.spoken = None
    spoken = [sorted(identifier for sender, identifier in frames if sender == leg) for leg in range(LEGS)]
    c.keep("scan", "bus", bus)
    for leg in range(LEGS):
        state = DriveState(int(c.drives.record["drive_state"][leg]))
        fact = {
            "answers": heard[leg] / c.drives.ticks(LISTEN_S),
            "twice": bool(doubled >> leg & 1),
            "state": state.name,
            "lacks": lacks[leg],
            "spoken": spoken[leg],
            "fault": c.fault_of(leg) if heard[leg] and state is DriveState.FAULT else "",
        }
        c.keep("scan", leg, fact)
    _recognise(c, [leg for leg in range(LEGS) if heard[leg] or spoken[leg]])


def _recognise(c: Context, heard: Collection[int]) -> None:
    """Drop what is known of legs whose drive is another than the one that was measured, and say so."""
    found, others = c.drives.identities(heard), []
    double = [leg for leg, serials in enumerate(c.drives.serials) if len(serials) > 1]
    for leg in double:  # either of the two may have told last
        c.keep("scan", leg, c.known("scan", leg) | {"twice": True})
    before = [c.known("identity", leg) or {} for leg in range(LEGS)]
    for leg in set(range(LEGS)) - set(double):
        known, said = before[leg], found[leg]
        changes = [f"{k} {v} -> {said[k]}" for k, v in known.items() if said.get(k, v) != v]
        text = f"  leg {leg}, node {c.machine.node_ids[leg]}: "
        if changes:
            others.append(leg)
            text += f"another drive or firmware than was measured ({', '.join(changes)}): "
            c.operator.tell(f"{text}its steps are done again")
        elif SERIAL in known and SERIAL not in said and c.known("scan", leg)["answers"]:
            text += f"it does not tell its serial number, which was {known[SERIAL]} when it was measured; "
            c.operator.tell(f"{text}if it was exchanged, begin anew with --again")
    if others:
        forget_legs(c.facts, others)
        c.save()  # before who is there now is known: an end between the two leads here again
    for leg in set(range(LEGS)) - set(double):
        if found[leg]:
            c.keep("identity", leg, found[leg] if leg in others else before[leg] | found[leg])


def _listened(c: Context, *, often: bool = False) -> tuple[list[int], int, dict[str, Any]]:
    """Poll the drives, commanded off; return ticks in which each answers, bits of doubled ones, the bus.

    often: who answers each poll twice is doubled, too; not where readings are sent unasked.
    """
    heard, doubled, foreign, refused = [0] * LEGS, 0, 0, 0
    strange: set[int] = set()
    answers: Counter[tuple[int, int]] = Counter()
    ticks = c.drives.ticks(LISTEN_S)
    for _ in range(ticks):
        record = c.drives.step()
        for leg in range(LEGS):
            heard[leg] += int(record["age"][leg] == 0)
        doubled |= int(record["doubled"])
        foreign |= int(record["foreign"])
        refused += int(record["rejected"])
        strange |= {each.frame.id for each in c.drives.heard} - c.machine.known_identifiers
        answers.update((c.drives.protocol.sender(frame), frame.id) for _, frame in c.drives.heard)
    if often and c.drives.protocol.traits.unasked_s <= 0.0:
        for (leg, _), number in answers.items():
            doubled |= (leg >= 0 and number > TWICE * ticks) << max(leg, 0)
    return heard, doubled, {"foreign": foreign, "refused": refused, "strange": sorted(strange)}


def judge(c: Context) -> Iterator[Finding]:
    """Name drives that are absent, double, of another protocol, or not set up."""
    m, bus = c.machine, c.facts["scan"]["bus"]
    if bus["foreign"]:
        names = ", ".join(str(f.name) for f in Foreign if f and f.value & bus["foreign"])
        text = f"somebody else sends {names}"
        yield Finding("second_controller", (), text, "End the other controller.")
    facts = c.table("scan")
    silent = [leg for leg, fact in facts.items() if not fact["answers"]]
    nodes = ", ".join(str(m.node_ids[leg]) for leg in silent)
    double = [leg for leg, fact in facts.items() if fact["twice"]]
    for leg in double:
        text = f"two drives answer as node {m.node_ids[leg]}"
        if len(serials := c.drives.serials[leg]) > 1:
            text += f", with serial numbers {', '.join(map(str, sorted(serials)))}"
        if silent:
            text += f"; no drive answers as node {nodes}"
        yield Finding("same_id", (leg, *silent), text, "Give one of the two its own node number.")
    if len(silent) == LEGS and not bus["strange"] and not bus["refused"]:
        text = f"nobody answers, neither node {nodes} nor another"
        mend = "Look at bit rate, layout, cable, termination and the drives' supply."
        yield Finding("absent", tuple(silent), text, mend)
        return
    for leg in silent if not double else []:
        yield _silent(c, leg, bus)
    for leg, fact in facts.items():
        node = m.node_ids[leg]
        if fact["fault"]:
            text = f"node {node} stays in FAULT after a RESET: {fact['fault']}"
            yield Finding("drive_fault", (leg,), text, "Look at the drive with its maker's tool.")
        elif fact["answers"] and fact["lacks"]:
            text = f"node {node} does not take its set-up: {fact['lacks']}"
            yield Finding("set_up", (leg,), text, _SET_UP)


_SET_UP = "Compare version, rated force and options of drive and configuration."


def _silent(c: Context, leg: int, bus: dict[str, Any]) -> Finding:
    m, fact = c.machine, c.known("scan", leg)
    node = f"node {m.node_ids[leg]}"
    spoken, strange, refused = fact["spoken"], bus["strange"], bus["refused"]
    names = ", ".join(f"{identifier:#x}" for identifier in spoken or strange)
    name, mend = "wrong_protocol", f"Set the drive to {m.protocol}, or drives.protocol; compare bus.layout."
    if CANOPEN_HEARTBEAT + m.node_ids[leg] in strange:
        text = f"{node} speaks CANopen: its heartbeat is {CANOPEN_HEARTBEAT + m.node_ids[leg]:#x}"
    elif refused:
        text = f"{node} is heard, but {refused} frames are refused: length, check or state"
    elif spoken and not m.unasked_identifiers.issuperset(spoken):
        name, mend = "set_up", _SET_UP
        text = f"{node} is heard, but does not answer the polls: {fact['lacks'] or 'it confirms its set-up'}"
    elif spoken:
        text = f"{node} sends {names} unasked, and answers nothing: {fact['lacks'] or 'no poll'}"
    else:
        name, text = "absent", f"{node} does not answer"
        mend = "Look at its power, its cable, its bit rate and its node number."
        if strange:
            text += f"; identifiers of no drive of {m.protocol} are heard: {names}"
            mend += " If these frames end as it is switched off, it speaks another protocol."
    return Finding(name, (leg,), text, mend)


STEP = Step(
    "scan",
    "who answers on the bus",
    "polls the six drives and sets their watchdogs; no drive is powered",
    "Ctrl-C; nothing can move",
    find,
    judge,
    kept=False,
)
