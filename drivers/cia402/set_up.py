"""The start-up dialogue: which step of its plan each drive is at, and what is to be sent of it in a tick."""

from typing import NamedTuple

from drivers.cia402 import objects as o
from drivers.cia402.plan import Step
from drivers.cia402.states import UNHEARD
from drivers.protocol import DriveSetup, Frame
from drivers.signals import LEGS, DriveMode, DriveState
from drivers.tick_columns import Record

PATIENCE_S = 0.05
"""A request without an answer is repeated after this."""
LEAST_PATIENCE = 6
"""And after so many ticks at least."""
TRIES = 20
"""Requests without an answer after which a drive is asked from the beginning."""
_NOT_ASKED = -1
_NOT_THERE = (o.NO_OBJECT, o.NO_SUB_INDEX)
_POWERED = (DriveState.READY, DriveState.RUN)
_WHY = Step("read", o.ERROR_CODE, 0)
"""What a drive in fault is asked whose EMCY was not heard: it was sent once, before us or into a loss."""


class Slope(NamedTuple):
    """The step from one length of a leg to the next."""

    rate: float = 0.0
    """m/s, the mean of the step."""
    T: float = 0.0
    """s, between the two; 0: there is one length only."""
    latched_ns: int = 0
    """When the last one was latched, by the clock."""
    length: float | None = None
    """That one, m; None: there is none."""


class Cia402Dialogue(NamedTuple):
    """What the controller's end remembers; a tuple of six has one element a leg."""

    setup: DriveSetup
    plans: tuple[tuple[Step, ...], ...]
    beat: int
    """Ticks from one heartbeat of ours to the next."""
    at: tuple[int, ...] = (0,) * LEGS
    """Step of its plan that a drive is at."""
    asked: tuple[int, ...] = (_NOT_ASKED,) * LEGS
    """Tick of the request that is not answered."""
    tries: tuple[int, ...] = (0,) * LEGS
    """How often that has been sent."""
    refusal: tuple[str, ...] = ("",) * LEGS
    """What a drive has refused or reads otherwise, until it is set up."""
    states: tuple[int, ...] = (UNHEARD,) * LEGS
    """State of CiA 402 of each drive."""
    mode: int = DriveMode.OFF
    """What was commanded last."""
    stopped: int = 0
    """Bit i: drive i has been stopped quickly, and no RESET since."""
    resets: int = 0
    """Bit i: drive i could not hear a RESET, as it was not set up, and gets one when it is."""
    rate: tuple[float, ...] = (0.0,) * LEGS
    """Leg rates, m/s."""
    slopes: tuple[Slope, ...] = (Slope(),) * LEGS
    owed: tuple[int, ...] = (1,) * (2 * LEGS)
    """Answers of each drive to earlier SYNCs that have not come: TPDO1 of all legs, then TPDO2."""
    missed: tuple[int, ...] = (0,) * LEGS
    """Last tick in which a drive was not heard."""

    def done(self, leg: int) -> bool:
        """Tell whether a drive has been set up."""
        return self.at[leg] == len(self.plans[leg])

    def step(self, leg: int) -> Step | None:
        """Return the step that a drive is at."""
        return None if self.done(leg) else self.plans[leg][self.at[leg]]


def put(values: tuple[int, ...], leg: int, value: int) -> tuple[int, ...]:
    """Return the six with another one of a leg."""
    return (*values[:leg], value, *values[leg + 1 :])


def moved(dialogue: Cia402Dialogue, leg: int, at: int) -> Cia402Dialogue:
    """Return the dialogue with a drive at a step of its plan that it has not been asked yet."""
    return dialogue._replace(
        at=put(dialogue.at, leg, at),
        asked=put(dialogue.asked, leg, _NOT_ASKED),
        tries=put(dialogue.tries, leg, 0),
    )


def advanced(dialogue: Cia402Dialogue, leg: int) -> Cia402Dialogue:
    """Return the dialogue with a drive at its next step."""
    dialogue = moved(dialogue, leg, dialogue.at[leg] + 1)
    return _with_refusal(dialogue, leg, "") if dialogue.done(leg) else dialogue


def _with_refusal(dialogue: Cia402Dialogue, leg: int, why: str) -> Cia402Dialogue:
    return dialogue._replace(refusal=(*dialogue.refusal[:leg], why, *dialogue.refusal[leg + 1 :]))


def _refused(dialogue: Cia402Dialogue, leg: int, tick: int, why: str) -> Cia402Dialogue:
    """Begin anew, but not before the patience is over: what is wrong will not mend at once."""
    dialogue = _with_refusal(moved(dialogue, leg, 0), leg, why)
    return dialogue._replace(asked=put(dialogue.asked, leg, tick))


def answered(dialogue: Cia402Dialogue, leg: int, data: bytes, tick: int) -> Cia402Dialogue | None:
    """Return the dialogue with the SDO answer of a drive; None for a frame that is none."""
    reply, step = o.read_reply(data), dialogue.step(leg)
    if reply is None:
        return None
    if step is None or step.kind == "nmt" or reply.key != step.key or dialogue.asked[leg] == _NOT_ASKED:
        return dialogue
    if reply.abort:
        if step.optional and reply.abort in _NOT_THERE:
            return advanced(dialogue, leg)
        why = f"{o.place(step.key)}: {step.kind} refused with {o.abort_text(reply.abort)}"
        return _refused(dialogue, leg, tick, why)
    if reply.wrote != (step.kind == "write"):
        return dialogue
    if not reply.wrote and (reply.value ^ step.value) & step.mask:
        why = f"{o.place(step.key)} is {reply.value & step.mask}, expected {step.value & step.mask}"
        return _refused(dialogue, leg, tick, why)
    return advanced(dialogue, leg)


def patience(dialogue: Cia402Dialogue) -> int:
    """Return the ticks after which a request is repeated."""
    return max(LEAST_PATIENCE, round(PATIENCE_S * dialogue.setup.rate_Hz))


def next_frames(
    dialogue: Cia402Dialogue, tick: Record, nodes: tuple[int, ...], most: int
) -> tuple[Cia402Dialogue, tuple[Frame, ...]]:
    """Return the requests of a tick, `most` at the most; whose turn it is goes round.

    A drive that is heard in READY or RUN is not asked.
    """
    states, ages, codes = (tick[name].tolist() for name in ("drive_state", "age", "drive_fault"))
    puzzles = [states[leg] == DriveState.FAULT and not codes[leg] for leg in range(LEGS)]
    if all(dialogue.done(leg) and not puzzles[leg] for leg in range(LEGS)):
        return dialogue, ()
    number = int(tick["tick"])
    waits = patience(dialogue)
    frames: list[Frame] = []
    for k in range(LEGS):
        leg = (number * most + k) % LEGS
        done, asked = dialogue.done(leg), dialogue.asked[leg]
        step = _WHY if done and puzzles[leg] else dialogue.step(leg)
        if step is None or (asked != _NOT_ASKED and number - asked < waits):
            continue
        if states[leg] in _POWERED and ages[leg] < waits:
            continue
        if len(frames) == most:
            break
        if dialogue.tries[leg] >= TRIES and dialogue.at[leg]:
            dialogue = moved(dialogue, leg, 0)
            step = dialogue.plans[leg][0]
        frames.append(step.frame(nodes[leg]))
        dialogue = dialogue._replace(
            asked=put(dialogue.asked, leg, number),
            tries=put(dialogue.tries, leg, 0 if done else dialogue.tries[leg] + 1),
        )
        if step.kind == "nmt" and step.value != o.START:
            dialogue = advanced(dialogue, leg)
    return dialogue, tuple(frames)


def lack(dialogue: Cia402Dialogue, leg: int) -> str:
    """Return what of its set-up a drive has not confirmed; empty: nothing."""
    step = dialogue.step(leg)
    if step is None:
        return ""
    if dialogue.refusal[leg]:
        return dialogue.refusal[leg]
    if step.kind == "nmt":
        return "it sends no TPDO, although it was started by NMT"
    return f"no answer to {dialogue.tries[leg]} requests for {o.place(step.key)}"
