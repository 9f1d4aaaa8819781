"""Bring-up step that scans the bus: which nodes answer, and whether six drives accept their set-up."""

from collections import Counter
from collections.abc import Collection, Iterator
from typing import Any

from drivers.protocol import SERIAL
from drivers.signals import LEGS, DriveState, Foreign
from hil.lab.bringup.context import Context, Finding, Step, forget_legs

LISTEN_S, POLLS = 0.4, 200
"""Least duration and number of polls of a scan: with 200 a drive that answers 99.5 % of them is reported once
in 1700 scans, one that answers 95 % in 15 of 16 (binomial distribution, 6 or more missing)."""
TWICE = 1.5
"""More answers per poll than this come from two drives."""
LEAST_ANSWERS = 0.975
"""Least share of the polls that a drive has to answer."""
CANOPEN_HEARTBEAT = 0x700
"""CiA 301: identifier of a heartbeat less the node number."""


def find(c: Context) -> None:
    """Poll all drives while off, then set them up; repeated in every run, since drives forget settings."""
    c.drives.spoken = frames = set[tuple[int, int]]()
    heard, doubled, bus = _listen(c)
    lacks = ("",) * LEGS
    if not doubled and not bus["foreign"]:
        lacks = c.drives.prepare(None)
        heard, doubled, bus = _listen(c, often=True)  # some answer only once set up, or otherwise then
    c.drives.spoken = None
    spoken = [sorted(identifier for sender, identifier in frames if sender == leg) for leg in range(LEGS)]
    c.keep("scan", "bus", bus)
    for leg in range(LEGS):
        state = DriveState(int(c.drives.record["drive_state"][leg]))
        fact = {
            "answers": heard[leg] / _polls(c),
            "twice": bool(doubled >> leg & 1),
            "state": state.name,
            "lacks": lacks[leg],
            "spoken": spoken[leg],
            "fault": c.fault_of(leg) if heard[leg] and state is DriveState.FAULT else "",
        }
        c.keep("scan", leg, fact)
    _recognise(c, [leg for leg in range(LEGS) if heard[leg] or spoken[leg]])


def _recognise(c: Context, heard: Collection[int]) -> None:
    """Delete the results about legs whose drive was replaced since, and report the replacement."""
    found, others = c.drives.identities(heard), []
    double = [leg for leg, serials in enumerate(c.drives.serials) if len(serials) > 1]
    for leg in double:  # either of the two may have answered last
        c.keep("scan", leg, c.known("scan", leg) | {"twice": True})
    before = [c.known("identity", leg) or {} for leg in range(LEGS)]
    for leg in set(range(LEGS)) - set(double):
        known, reported = before[leg], found[leg]
        changes = [f"{k} {v} -> {reported[k]}" for k, v in known.items() if reported.get(k, v) != v]
        text = f"  leg {leg}, node {c.machine.node_ids[leg]}: "
        if changes:
            others.append(leg)
            text += f"other drive or firmware than measured before ({', '.join(changes)}): "
            c.operator.tell(f"{text}its steps are repeated")
        elif SERIAL in known and SERIAL not in reported and c.known("scan", leg)["answers"]:
            text += f"it does not report its serial number ({known[SERIAL]} when it was measured); "
            c.operator.tell(f"{text}if it was replaced, start over with --again")
    if others:
        forget_legs(c.facts, others)
        c.save()  # before who is there now is known: an end between the two leads here again
    for leg in set(range(LEGS)) - set(double):
        if found[leg]:
            c.keep("identity", leg, found[leg] if leg in others else before[leg] | found[leg])


def _listen(c: Context, *, often: bool = False) -> tuple[list[int], int, dict[str, Any]]:
    """Poll the drives while off; return answered ticks per drive, bits of duplicate drives, bus events.

    often: a node that answers each poll twice also counts as duplicate, unless drives send readings
    unsolicited.
    """
    heard, doubled, foreign, refused = [0] * LEGS, 0, 0, 0
    strange: set[int] = set()
    answers: Counter[tuple[int, int]] = Counter()
    ticks = _polls(c)
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
    """Findings: drives that are absent, duplicate, of another protocol, or not set up."""
    m, bus = c.machine, c.facts["scan"]["bus"]
    if bus["foreign"]:
        names = ", ".join(str(f.name) for f in Foreign if f and f.value & bus["foreign"])
        text = f"another controller sends {names}"
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
        text = f"no drive answers, neither node {nodes} nor any other"
        remedy = "Check bit rate, layout, cable, termination and the drives' supply."
        yield Finding("absent", tuple(silent), text, remedy)
        return
    for leg in silent if not double else []:
        yield _silent(c, leg, bus)
    yield from lost_frames({leg: fact["answers"] for leg, fact in facts.items()})
    for leg, fact in facts.items():
        node = m.node_ids[leg]
        if fact["fault"]:
            text = f"node {node} stays in FAULT after a RESET: {fact['fault']}"
            yield Finding("drive_fault", (leg,), text, "Check the drive with its maker's tool.")
        elif fact["answers"] and fact["lacks"]:
            text = f"node {node} does not confirm its set-up: {fact['lacks']}"
            yield Finding("set_up", (leg,), text, _SET_UP)


def _polls(c: Context) -> int:
    return max(POLLS, c.drives.ticks(LISTEN_S))


def answers(c: Context) -> list[float]:
    """Share of the polls, 0 to 1, that each drive answers, with all drives off."""
    return [heard / _polls(c) for heard in _listen(c)[0]]


def lost_frames(answers: dict[int, float]) -> Iterator[Finding]:
    """Finding for drives that answer only part of the polls; answers: share of the polls by leg."""
    lossy = {leg: 1.0 - share for leg, share in answers.items() if 0.0 < share < LEAST_ANSWERS}
    if lossy:
        legs = ", ".join(f"leg {leg} {100.0 * share:.3g} %" for leg, share in lossy.items())
        text = f"polls without an answer: {legs}, allowed: {100.0 * (1.0 - LEAST_ANSWERS):.3g} %"
        remedy = "Check termination, shield, plugs, bit timing, and the load of bus and computer."
        yield Finding("frames_lost", tuple(lossy) if len(lossy) < LEGS else (), text, remedy)


_SET_UP = "Compare version, rated force and options of drive and configuration."


def _silent(c: Context, leg: int, bus: dict[str, Any]) -> Finding:
    m, fact = c.machine, c.known("scan", leg)
    node = f"node {m.node_ids[leg]}"
    spoken, strange, refused = fact["spoken"], bus["strange"], bus["refused"]
    names = ", ".join(f"{identifier:#x}" for identifier in spoken or strange)
    name, remedy = "wrong_protocol", f"Set the drive to {m.protocol}, or drives.protocol; compare bus.layout."
    if CANOPEN_HEARTBEAT + m.node_ids[leg] in strange:
        text = f"{node} speaks CANopen: its heartbeat is {CANOPEN_HEARTBEAT + m.node_ids[leg]:#x}"
    elif refused and spoken:
        text = f"{node} sends, but {refused} frames are invalid: length, checksum or state"
    elif spoken and not m.unasked_identifiers.issuperset(spoken):
        name, remedy = "set_up", _SET_UP
        text = f"{node} sends, but does not answer the polls: {fact['lacks'] or 'it confirms its set-up'}"
    elif spoken:
        text = f"{node} sends {names} unsolicited, but does not answer: {fact['lacks'] or 'no poll'}"
    else:
        name, text = "absent", f"{node} does not answer"
        remedy = "Check its power, its cable, its bit rate and its node number."
        if strange:
            text += f"; identifiers unknown to {m.protocol} were received: {names}"
            remedy += " If these frames end as it is switched off, it speaks another protocol."
    return Finding(name, (leg,), text, remedy)


STEP = Step(
    "scan",
    "who answers on the bus",
    "polls the six drives and sets their watchdogs; no drive is powered",
    "Ctrl-C; nothing can move",
    find,
    judge,
    kept=False,
)
