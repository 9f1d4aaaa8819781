"""Types shared by the steps of a bring-up: machine, operator, request, finding, step and their context."""

from collections.abc import Callable, Collection, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from math import inf
from typing import Any, NamedTuple, Protocol

import numpy as np

from drivers.arrays import Array
from drivers.errors import HilError
from drivers.signals import LEGS, DriveFault, DriveMode, DriveState
from hil.lab.bringup.drives import Drives

FORCE_SHARE = 0.02
"""Largest motor force in any step of a bring-up, as a share of the rated force."""
TRAVEL_M = 1e-3
"""Travel, m, at which a leg driven with an open brake is stopped."""
OLD_TICKS = 3
"""Largest age of a reading, ticks, that is trusted while a brake is open."""
SETTLED_S = 0.1
"""Rest, s, before a length is read: a late reading would assign the last motion to the next leg."""
MOVED_M = 1e-4
"""Leg travel, m, that counts as motion; a force ramp ends there."""
UNTIMED_S = 1.0
"""Additional wait, s, before the next brake opens, if this one was not timed or closes late."""
TAPE_M = 2e-4
"""Standard deviation, m, of a length that the operator measures with a tape."""


class Request(NamedTuple):
    """A manual action or a reading requested from the operator."""

    act: str
    """Name of the action, by which an emulated bench performs it."""
    leg: int = -1
    value: float = 0.0
    """`move`: distance, m. `place`: share of the stroke. `hang`: index of the known pose."""
    text: str = ""
    """Text for the operator."""
    word: str = ""
    """Word that the operator types to confirm; empty: Enter."""
    within: tuple[float, float] | None = None
    """Allowed range of a reading, to catch slips and wrong units. None: an action, without a reading."""


class Finding(NamedTuple):
    """A mistake found at the machine: its name, the legs, the measurement and the remedy."""

    name: str
    legs: tuple[int, ...]
    text: str
    """The measurement that shows it."""
    remedy: str
    """What the operator should do."""

    @property
    def line(self) -> str:
        """Name, legs, measurement and remedy in one line."""
        which = f"leg{'s' * (len(self.legs) > 1)} {', '.join(map(str, self.legs))}: " if self.legs else ""
        return f"{self.name}: {which}{self.text}. {self.remedy}"


def gap_of(text: str, instead: str) -> Finding:
    """Finding for a property that these drives cannot show; instead: check that the operator does himself."""
    return Finding("not provable with these drives", (), text, instead)


class Operator(Protocol):
    """The person at the machine, or a simulated one. Mutable state: the open request."""

    patience: float
    """Refused readings of one request before the bring-up ends; inf for a person, who can read again."""

    def consent(self, title: str, will: str, stop: str) -> bool:
        """True if the operator lets a step begin; will: the step's effect; stop: how to stop it."""

    def ask(self, request: Request) -> None:
        """Start a request for an action or a reading; `answer` returns its result."""

    def answer(self) -> float | None:
        """The reading, or 0 for an action done; None until the operator answers. Polled in every tick."""

    def tell(self, text: str) -> None:
        """Show a text to the operator."""


@dataclass(frozen=True, eq=False)
class Machine:
    """Properties of the machine that a bring-up needs, from the configuration; lengths m, forces N."""

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
    """Text of each known pose for the operator: position, m, and rotation vector, deg."""
    known_identifiers: frozenset[int]
    """Identifiers of all frames of this protocol."""
    unasked_identifiers: frozenset[int] = frozenset()
    """Identifiers of frames that drives send unsolicited: heartbeats, emergencies."""
    platform_kg: float = 0.0
    presses: float = 0.0
    """Cosine between gravity and the direction from platform to base; > 0: the weight compresses the legs."""
    losses: float = 0.0
    """Largest share of a force lost between motor and leg."""
    heartbeat_s: float = 0.1
    forgotten_m: Array | None = None
    """(6,) m, length of which a drive forgets whole multiples at power-off; None: drives forget nothing."""

    @property
    def stroke(self) -> float:
        """Configured stroke, m."""
        return self.length_max - self.length_min

    def turns_m(self, drive: int, off_m: float) -> float:
        """Part, m, of a reading error `off_m` that whole turns forgotten by a drive at power-off explain."""
        step = 0.0 if self.forgotten_m is None else float(self.forgotten_m[drive])
        return step * round(off_m / step) if step else 0.0

    @property
    def force_N(self) -> float:
        """Largest force at the leg in any step, N: FORCE_SHARE of the rated force, less the losses."""
        return FORCE_SHARE * self.rated_N * (1.0 - self.losses)


class RefusedError(HilError):
    """The operator refused consent or ended the bring-up. Facts found so far are kept."""


class StoppedError(HilError):
    """A measured value ended a step for safety; `finding` gives the reason."""

    def __init__(self, finding: Finding) -> None:
        super().__init__(finding.line)
        self.finding = finding


@dataclass
class Context:
    """State of one bring-up. Mutable state: the drives; `facts`, results by step and leg as JSON values."""

    machine: Machine
    drives: Drives
    operator: Operator
    facts: dict[str, dict[str, Any]] = field(default_factory=dict)
    save: Callable[[], None] = lambda: None
    """Called after every new result, to store it."""
    most_m: float = inf
    """Largest travel of any leg while a brake is open, m; more ends the run. inf: legs on trestles."""
    opened_at: list[Array] = field(default_factory=list)
    """Leg lengths (6,) m as read when the present brake began to open."""

    def known(self, step: str, leg: int) -> Any:
        """Stored result of a step for a leg; None if not measured yet."""
        return self.facts.get(step, {}).get(str(leg))

    def table(self, step: str) -> dict[int, Any]:
        """Stored results of a step, by number of the leg or drive."""
        return {leg: fact for leg in range(LEGS) if (fact := self.known(step, leg)) is not None}

    def missing(self, step: str) -> Iterator[int]:
        """Iterate over the legs, or drives, for which a step has no stored result yet."""
        return (leg for leg in range(LEGS) if self.known(step, leg) is None)

    def keep(self, step: str, leg: int | str, fact: Any) -> None:
        """Store the result of a step for a leg, and save all results."""
        self.facts.setdefault(step, {})[str(leg)] = fact
        self.save()

    def lengths(self) -> Array:
        """Leg lengths (6,) m as the drives read them. Raises StoppedError if one is over OLD_TICKS old."""
        self._heard(range(LEGS))
        return np.array(self.drives.record["length"])

    def take_down(self) -> None:
        """Ask the operator to take the platform off its legs, if this or an earlier run had it mounted."""
        if self.facts.get("platform", {}).get("hung"):
            text = "One brake is to open alone. Take the platform off and lay the legs on their trestles"
            self.ask(Request("take_down", text=text, word="down"))
            self.facts.pop("platform")
            for step in _MOUNTED:
                self.facts.pop(step, None)
            self.save()

    def ask(self, request: Request, keep: Callable[[], object] | None = None) -> float:
        """Ask the operator, return the answer; `keep` runs each tick meanwhile, by default all drives off.

        Raises RefusedError after too many readings outside the allowed range.
        """
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
            why = f"{answer:g} is out of range: {low:g} to {high:g} are allowed, in m, N and kg, not mm or kN"
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
    def opened(self, leg: int, *, timed: bool = False) -> Iterator[None]:
        """Open the brake of one leg without force; shut it on every exit. Raises StoppedError if not powered.

        timed: the caller times the closing. If not, and if it may be late, the exit waits UNTIMED_S longer.
        """
        self.take_down()
        timed = timed or (self.known("shuts", leg) or {}).get("late_s") == 0.0
        self.opened_at[:] = [self.lengths()] if self.most_m < inf else []
        try:
            why = self.drives.power(leg)
            if why:
                remedy = "Set up and prove the drives' watchdogs first; check the drive's fault."
                raise StoppedError(Finding("not_powered", (leg,), why, remedy))
            for _ in range(self.drives.ticks(self.machine.brake_open_s)):
                self.drives.step(DriveMode.RUN, leg)
                self.stay(leg)
            for _ in range(self.drives.report_ticks):
                if self.drives.record["drive_state"][leg] != DriveState.READY:
                    break
                self.drives.step(DriveMode.RUN, leg)
                self.stay(leg)
            yield
        finally:
            self.drives.off(self.machine.brake_shut_s + (0.0 if timed else UNTIMED_S))

    def drive(self, drive: int, force: float = 0.0) -> None:
        """Command a force, N, to a drive with an open brake for one tick. Raises StoppedError: not in RUN."""
        record = self.drives.step(DriveMode.RUN, drive, force)
        self._heard([drive])
        state = DriveState(int(record["drive_state"][drive]))
        if state is not DriveState.RUN:
            why = self.fault_of(drive)
            text = f"the drive has gone from RUN to {state.name}{': ' * bool(why)}{why}"
            remedy = "Check the drive's fault; WATCHDOG: this machine or the bus stalled. Try again."
            raise StoppedError(Finding("lost_power", (drive,), text, remedy))
        self.stay(drive)

    def stay(self, drive: int) -> None:
        """Raise StoppedError if a leg has moved by more than `most_m` since a drive's brake began to open."""
        if not self.opened_at:
            return
        reads = len(self.reads())
        moved = {leg: m for leg, m in self.travelled(self.opened_at[0]).items() if abs(m) > self.most_m}
        if moved or reads < LEGS:
            legs = ", ".join(f"leg {leg} {1e3 * m:+.2f} mm" for leg, m in moved.items())
            text = f"with the brake of drive {drive} open, {legs} moved; allowed: {1e3 * self.most_m:g} mm"
            if reads < LEGS:
                text = f"only {reads} encoders are known: the travel of the other legs cannot be watched"
            remedy = "Tighten the hoist. If another leg moved, exchange the brakes' cables (brake_crossed)."
            raise StoppedError(Finding("loaded", tuple(moved), text, remedy))

    def fault_of(self, drive: int) -> str:
        """The fault that a drive reports, as text; empty: no fault."""
        code = int(self.drives.record["drive_fault"][drive])
        if code in set(DriveFault):
            return DriveFault(code).name if code else ""
        return self.drives.protocol.fault_text(code) or f"code {code:#x} of its maker"

    def reads(self) -> dict[int, tuple[int, float]]:
        """{drive: (leg, scale)}: the leg whose length a drive's encoder reads, and m read per m by tape."""
        return {
            fact["drive"]: (leg, fact["scale"])
            for leg, fact in self.table("encoder").items()
            if fact["drive"] is not None and abs(fact["scale"]) > 0.0
        }

    def _heard(self, drives: Iterable[int]) -> None:
        """Raise StoppedError if one of some drives was not read for more than OLD_TICKS."""
        record = self.drives.record
        silent = [drive for drive in drives if record["age"][drive] > OLD_TICKS]
        if silent:
            blind = record["blind"][silent].all()
            why = "it answers without a length" if blind else "it is silent"
            text = f"no reading for {int(record['age'][silent[0]])} ticks: {why}"
            remedy = "Check supply, cable, plugs, shield, encoder, counts per turn and gear."
            raise StoppedError(Finding("not_heard", tuple(silent), text, remedy))

    def travelled(self, since: Array) -> dict[int, float]:
        """Travel of each leg, m by tape, since the readings `since` (6,) m. Raises StoppedError: silent."""
        now = self.lengths()
        return {leg: float((now[k] - since[k]) / scale) for k, (leg, scale) in self.reads().items()}


_MOUNTED = "mounted", "taped", "hoisted"
"""Steps with facts about the mounted platform."""
_OTHERS = {
    "ids": "drives", "encoder": "drive", "opens": "legs",
    "held": "", "shuts": "", "force": "", "gauge": "", "watchdog": "",
}  # fmt: skip
"""Steps with results for one leg or drive -> key in a result that lists other legs or drives."""


def forget_legs(facts: dict[str, dict[str, Any]], legs: Collection[int]) -> None:
    """Delete the stored results about some legs or their drives, about the platform, and about steps passed.

    With exchanged node numbers a result for one leg refers to another drive, so every result that refers to a
    listed leg or drive is deleted.
    """
    for step, key in _OTHERS.items():
        table = facts.get(step, {})
        for name, fact in list(table.items()):
            others = fact.get(key, [])
            if not {int(name), *(others if isinstance(others, list) else [others])}.isdisjoint(legs):
                del table[name]
    for step in (*_MOUNTED, "load", "passed"):
        facts.pop(step, None)


class Step(NamedTuple):
    """One step of a bring-up: its announcement, its measurements and the evaluation of its results."""

    name: str
    title: str
    will: str
    """Announcement: the effect of the step on the machine."""
    stop: str
    """Announcement: how to stop it."""
    find: Callable[[Context], None]
    """Measure the results that are not stored yet. Raises StoppedError."""
    judge: Callable[[Context], Iterable[Finding]]
    """Derive the findings from the stored results."""
    kept: bool = True
    """A passed step is not repeated for the same hardware."""
    gate: bool = True
    """A finding ends the bring-up here; otherwise the next steps still look for its cause."""
    by_drive: bool = False
    """The step stores one result per drive."""
    gap: Callable[[Context], Finding | None] = lambda _: None
    """Property that cannot be proven with these drives; with one, the step has not passed."""
    tables: tuple[str, ...] = ()
    """Names of its tables of results; empty: one table with the name of the step."""

    def kept_whole(self, c: Context) -> bool:
        """True if the step passed before and each of its tables of results is still complete."""
        if not self.kept or self.name not in c.facts.get("passed", {}):
            return False
        poses = len(c.machine.pose_lengths)
        sizes = {"mounted": poses, "taped": poses, "load": 2, "hoisted": 6}
        tables = self.tables or (self.name,)
        return all(len(c.facts.get(table, {})) == sizes.get(table, LEGS) for table in tables)
