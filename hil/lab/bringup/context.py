"""What the steps of a bring-up share: the machine, the drives, the operator, the facts found so far."""

from collections.abc import Callable, Collection, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any, NamedTuple, Protocol

import numpy as np

from drivers.arrays import Array
from drivers.errors import HilError
from drivers.signals import LEGS, DriveFault, DriveMode, DriveState
from hil.lab.bringup.drives import Drives

FORCE_SHARE = 0.02
"""Of the rated force: no step commands more."""
TRAVEL_M = 1e-3
"""A leg that is driven with one brake open is stopped here."""
OLD_TICKS = 3
"""A reading of more ticks ago says nothing of a leg whose brake is open."""
MOVED_M = 1e-4
"""A leg has moved; a driven one is let go there."""
TAPE_M = 2e-4
"""Standard deviation of a length that the operator measures."""


class Request(NamedTuple):
    """What the operator is asked to do with his hands, or to read."""

    act: str
    """What the hands of a rehearsal bench know it by."""
    leg: int = -1
    value: float = 0.0
    """`move`: by so many m. `place`: share of the stroke. `hang`: which of the known poses."""
    text: str = ""
    """As he reads it."""
    word: str = ""
    """What he types for it to count as done; empty: Enter."""
    within: tuple[float, float] | None = None
    """Of a reading: those outside are asked for again, another unit or a slip. None: an act is to be done."""


class Finding(NamedTuple):
    """A mistake, by name."""

    name: str
    legs: tuple[int, ...]
    text: str
    """What was measured."""
    mend: str
    """What to do about it."""

    @property
    def line(self) -> str:
        """As it is read: which leg, what, how to mend it."""
        which = f"leg{'s' * (len(self.legs) > 1)} {', '.join(map(str, self.legs))}: " if self.legs else ""
        return f"{self.name}: {which}{self.text}. {self.mend}"


def gap_of(text: str, instead: str) -> Finding:
    """Return what a step cannot prove with these drives, and what the operator has to see to instead."""
    return Finding("not provable with these drives", (), text, instead)


class Operator(Protocol):
    """Who stands beside the machine. Mutable state: what he was asked and has not answered."""

    patience: float
    """After so many refused readings of one request the bring-up ends; inf: never, a person reads again."""

    def consent(self, title: str, will: str, stop: str) -> bool:
        """Ask whether a step may begin that will do this and is stopped like that."""

    def ask(self, request: Request) -> None:
        """Ask for an act or a reading."""

    def answer(self) -> float | None:
        """Return the answer once there is one, 0 for an act that is done; called in every tick meanwhile."""

    def tell(self, text: str) -> None:
        """Say what was found."""


@dataclass(frozen=True, eq=False)
class Machine:
    """The machine as it is configured; lengths m, forces N."""

    node_ids: tuple[int, ...]
    protocol: str
    rated_N: float
    length_min: float
    length_max: float
    watchdog_s: float
    brake_open_s: float
    brake_shut_s: float
    pose_lengths: Array
    """(poses, 6) m, leg lengths at the known poses."""
    joint_distances: Array
    """(poses, 6, 6) m, from base joint (second index) to platform joint (third) at these poses."""
    pose_words: tuple[str, ...]
    """The known poses, as they are read."""
    known_identifiers: frozenset[int]
    """Of all frames of this protocol."""
    unasked_identifiers: frozenset[int] = frozenset()
    """Of what drives send by themselves: heartbeats, emergencies."""
    platform_kg: float = 0.0
    presses: float = 0.0
    """Cosine between gravity and the way from platform to base, > 0: its weight presses the legs."""
    losses: float = 0.0
    """Share of a force that may be lost between motor and leg."""
    heartbeat_s: float = 0.1
    forgotten_m: Array | None = None
    """(6,) m, of which a drive forgets whole multiples at power-off; None: it forgets nothing."""

    @property
    def stroke(self) -> float:
        """Configured stroke, m."""
        return self.length_max - self.length_min

    def turns_m(self, drive: int, off_m: float) -> float:
        """Return what of a reading that is so far off, m, a drive may have forgotten: whole turns."""
        step = 0.0 if self.forgotten_m is None else float(self.forgotten_m[drive])
        return step * round(off_m / step) if step else 0.0

    @property
    def force_N(self) -> float:
        """Most force at the leg of any step: before the losses it is FORCE_SHARE of the rated one."""
        return FORCE_SHARE * self.rated_N * (1.0 - self.losses)


class RefusedError(HilError):
    """The operator has not consented, or has ended the bring-up; what was found is kept."""


class StoppedError(HilError):
    """A measured value ended a step for safety; `finding` says which."""

    def __init__(self, finding: Finding) -> None:
        super().__init__(finding.line)
        self.finding = finding


@dataclass
class Context:
    """One bring-up. Mutable state: the facts, by step and leg, as JSON values; the drives."""

    machine: Machine
    drives: Drives
    operator: Operator
    facts: dict[str, dict[str, Any]] = field(default_factory=dict)
    save: Callable[[], None] = lambda: None
    """Called when a fact is new."""

    def known(self, step: str, leg: int) -> Any:
        """Return the fact of a step about a leg; None where it has to be found."""
        return self.facts.get(step, {}).get(str(leg))

    def table(self, step: str) -> dict[int, Any]:
        """Return the facts of a step by leg, or drive, as far as they are known."""
        return {leg: fact for leg in range(LEGS) if (fact := self.known(step, leg)) is not None}

    def missing(self, step: str) -> Iterator[int]:
        """Give the legs, or drives, about which a step has no fact yet, one after the other."""
        return (leg for leg in range(LEGS) if self.known(step, leg) is None)

    def keep(self, step: str, leg: int | str, fact: Any) -> None:
        """Keep a fact."""
        self.facts.setdefault(step, {})[str(leg)] = fact
        self.save()

    def lengths(self) -> Array:
        """Return what the drives read now, (6,) m. Raises StoppedError where one is not heard."""
        record = self.drives.record
        silent = np.flatnonzero(record["age"] > OLD_TICKS).tolist()
        if silent:
            blind = record["blind"][silent].all()
            why = "it answers without a length" if blind else "it is silent"
            text = f"no reading for {int(record['age'][silent[0]])} ticks: {why}"
            mend = "Look at cable, supply, encoder, counts a turn and gear, and give the command again."
            raise StoppedError(Finding("not_heard", tuple(silent), text, mend))
        return np.array(record["length"])

    def take_down(self) -> None:
        """Have the platform taken off the legs if it was hung, in this or an earlier run."""
        if self.facts.get("platform", {}).get("hung"):
            text = "One brake is to open alone. Take the platform off and lay the legs on their trestles"
            self.ask(Request("take_down", text=text, word="down"))
            self.facts.pop("platform")
            self.facts.pop("mounted", None)
            self.save()

    def ask(self, request: Request, keep: Callable[[], object] | None = None) -> float:
        """Ask, calling `keep` (else all off) every tick. Raises RefusedError: too many wrong readings."""
        refused = 0
        idle = self.drives.step if keep is None else keep
        self.operator.ask(request)
        while True:
            idle()
            answer = self.operator.answer()
            if answer is None:
                continue
            low, high = request.within or (answer, answer)
            if low <= answer <= high:
                return answer
            why = f"{answer:g} cannot be: {low:g} to {high:g} are allowed, in m, N and kg, not mm or kN"
            refused += 1
            if refused >= self.operator.patience:
                raise RefusedError(f"ended: {request.text}: {refused} readings refused: {why}")
            self.operator.tell(f"    {why}")
            self.operator.ask(request)

    def rest(self, seconds: float) -> None:
        """Let time pass with all drives off."""
        for _ in range(self.drives.ticks(seconds)):
            self.drives.step()

    @contextmanager
    def opened(self, leg: int) -> Iterator[None]:
        """Open one brake without force, and shut it whatever happens. Raises StoppedError: it cannot be."""
        self.take_down()
        try:
            why = self.drives.power(leg)
            if why:
                mend = "Set up and prove the drives' watchdogs first; look at the drive's fault."
                raise StoppedError(Finding("not_powered", (leg,), why, mend))
            for _ in range(self.drives.ticks(self.machine.brake_open_s)):
                self.drives.step(DriveMode.RUN, leg)
            for _ in range(self.drives.told_ticks):
                if self.drives.record["drive_state"][leg] != DriveState.READY:
                    break
                self.drives.step(DriveMode.RUN, leg)
            yield
        finally:
            self.drives.off(self.machine.brake_shut_s)

    def drive(self, drive: int, force: float = 0.0) -> None:
        """Command one tick of a drive whose brake is open, N. Raises StoppedError where it has lost power."""
        record = self.drives.step(DriveMode.RUN, drive, force)
        self._heard(drive)
        state = DriveState(int(record["drive_state"][drive]))
        if state is not DriveState.RUN:
            why = self.fault_of(drive)
            text = f"the drive has gone from RUN to {state.name}{': ' * bool(why)}{why}"
            mend = "Look at the drive's fault; WATCHDOG: this machine stalled, or the bus did. Try again."
            raise StoppedError(Finding("lost_power", (drive,), text, mend))

    def fault_of(self, drive: int) -> str:
        """Return what a drive says of its fault; empty: nothing."""
        code = int(self.drives.record["drive_fault"][drive])
        if code in set(DriveFault):
            return DriveFault(code).name if code else ""
        return self.drives.protocol.fault_text(code) or f"code {code:#x} of its maker"

    def reads(self) -> dict[int, tuple[int, float]]:
        """Return for each drive whose encoder is known the leg that it counts, and m of reading a m."""
        return {
            fact["drive"]: (leg, fact["scale"])
            for leg, fact in self.table("encoder").items()
            if fact["drive"] is not None and abs(fact["scale"]) > 0.0
        }

    def _heard(self, drive: int) -> None:
        age = int(self.drives.record["age"][drive])
        if age > OLD_TICKS:
            text, mend = f"it has not been heard for {age} ticks", "Look at the drive's supply and its bus."
            raise StoppedError(Finding("lost_power", (drive,), text, mend))

    def travelled(self, since: Array) -> dict[int, float]:
        """Return how far each leg has moved since readings (6,), m by tape. Raises StoppedError."""
        for drive in self.reads():
            self._heard(drive)
        now = self.lengths()
        return {
            leg: float((now[drive] - since[drive]) / scale) for drive, (leg, scale) in self.reads().items()
        }


_OTHERS = {
    "ids": "drives", "encoder": "drive", "opens": "legs", "held": "", "force": "", "gauge": "", "watchdog": ""
}  # fmt: skip
"""Steps whose facts are about one leg or its drive, and the key that names the other of them."""


def forget_legs(facts: dict[str, dict[str, Any]], legs: Collection[int]) -> None:
    """Drop the facts about legs or their drives, those about the platform, and that steps have passed.

    Behind exchanged numbers a fact's own leg is another: what names a leg or its drive goes, too.
    """
    for step, key in _OTHERS.items():
        table = facts.get(step, {})
        for name, fact in list(table.items()):
            others = fact.get(key, [])
            if not {int(name), *(others if isinstance(others, list) else [others])}.isdisjoint(legs):
                del table[name]
    for step in ("mounted", "load", "passed"):
        facts.pop(step, None)


class Step(NamedTuple):
    """One step: said before it is done, judged by what it measured."""

    name: str
    title: str
    will: str
    """What it will do."""
    stop: str
    """How to stop it."""
    find: Callable[[Context], None]
    """Finds the facts that are not known yet. Raises StoppedError."""
    judge: Callable[[Context], Iterable[Finding]]
    """Names what is wrong by the facts."""
    kept: bool = True
    """Once passed it is not done again for the same hardware."""
    gate: bool = True
    """A finding ends the bring-up here; else the next steps still look for its cause."""
    by_drive: bool = False
    """It finds a fact of each drive."""
    gap: Callable[[Context], Finding | None] = lambda _: None
    """What it cannot prove with these drives, by the facts; it has not passed then."""
    tables: tuple[str, ...] = ()
    """Where it keeps its facts, if not under its own name."""

    def kept_whole(self, c: Context, many: int) -> bool:
        """Whether it has passed before, and none of its facts, `many` in each table, is lost since."""
        passed = self.kept and self.name in c.facts.get("passed", {})
        return passed and all(len(c.facts.get(table, {})) == many for table in self.tables or (self.name,))
