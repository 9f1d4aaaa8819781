"""What families of single-motor drives have in common: polled drives whose brake goes with their power stage.

A drive of such a family knows "enabled" and "disabled". DriveMode.READY leaves it disabled, its brake shut;
RUN enables it. The controller's end calls a disabled drive READY while READY is asked for, so a force cannot
build up against the brake: it comes with the enabling, or a tick later. A drive that was enabled and falls
back by itself while RUN is asked for has restarted: BOOT. It is not enabled again until RUN is asked for
anew, where it says so: a moteus may have obeyed the next command before it answers.
"""

from abc import abstractmethod
from typing import NamedTuple

import numpy as np

from drivers.arrays import Array, Rows
from drivers.errors import ProtocolError
from drivers.frame_array import received_frames
from drivers.motor_drives import MotorDrives, put
from drivers.motor_routes import MotorRoutes
from drivers.protocol import (
    ALWAYS,
    DriveSetup,
    Frame,
    PowerTold,
    Received,
)
from drivers.resolution import Resolution
from drivers.signals import LEGS, NEVER, Command, DriveMode, DriveState, Foreign, Reaction
from drivers.tick_columns import Record

OWN_CODE = 0x100
"""Added to a fault code of a family, so that none is taken for a DriveFault."""
RETRY_TICKS = 10
"""After which a request without an answer is repeated."""
RESTART_TICKS = 20
"""A drive that was silent for so long may have restarted: it is set up anew."""
_KEPT = ("length", "rate", "drive_force", "drive_state", "drive_fault")
_NO_BRAKE = (
    "drives.protocol: no frame of these drives works a brake, so a platform without power falls unless "
    "brakes of your own close by themselves when a drive is disabled; the brake tests test those"
)
_RUN, _OFF, _FAULT = DriveState.RUN, DriveState.OFF, DriveState.FAULT


class Heard(NamedTuple):
    """What one frame of a drive says."""

    leg: int
    broken: bool = False
    """It cannot be trusted."""
    foreign: bool = False
    """It is a command, so another controller's."""
    motion: tuple[float, float] | None = None
    """Turns of the motor and turns/s; None in a frame that is no feedback, or where it is of no use."""
    feedback: bool = False
    """It answers the poll."""
    torque: float | None = None
    """N m."""
    power: int | None = None
    """DriveState OFF (disabled), RUN (enabled) or FAULT; None where it does not say."""
    fault: int = 0
    """DriveFault, or OWN_CODE and the family's code."""
    answer: tuple[int, float] | None = None
    """Register and value, of the start-up dialogue."""


class Exchange(NamedTuple):
    """One request of the start-up dialogue, and what its answer must be."""

    name: str
    register: int
    frames: tuple[Frame, ...]
    """Sent together; the last one is answered."""
    value: float
    """What the drive must answer, in the drive's unit."""


class MotorDialogue(NamedTuple):
    """The controller's end; tuples have one element a leg."""

    exchanges: tuple[tuple[Exchange, ...], ...]
    watchdog_s: float
    mode: int = DriveMode.OFF
    torque: tuple[float, ...] = (0.0,) * LEGS
    """N m, of the last command."""
    rate: tuple[float, ...] = (0.0,) * LEGS
    """m/s, last read: it decides the losses."""
    power: tuple[int, ...] = (int(DriveState.BOOT),) * LEGS
    """DriveState OFF, RUN or FAULT, as last heard; BOOT: not yet."""
    ran: tuple[bool, ...] = (False,) * LEGS
    """Which were enabled since RUN is asked for."""
    done: tuple[int, ...] = (0,) * LEGS
    """1 for a drive that is heard, and 1 for each exchange that it has confirmed."""
    asked: tuple[int, ...] = (-RETRY_TICKS,) * LEGS
    """Tick of the last request."""
    read: tuple[float | None, ...] = (None,) * LEGS
    """What the last answer held that was not the right one."""
    said: tuple[int, ...] = (0,) * LEGS
    """Tick in which it last said whether it is enabled."""
    owed: tuple[int, ...] = (0,) * LEGS
    """Polls that a drive that is heard has not answered, RESTART_TICKS at most."""
    patience_ticks: int = NEVER
    """After which a drive that does not say so is in BOOT: nobody knows what it does."""


def wire_state(power: int, mode: int, *, set_up: bool, ran: bool) -> DriveState:
    """Return the DriveState of a drive that says only whether it is enabled; see the module's docstring."""
    if power in (_FAULT, _RUN):
        return DriveState(power)
    if not set_up or (ran and mode == DriveMode.RUN):
        return DriveState.BOOT
    return DriveState.READY if mode in (DriveMode.READY, DriveMode.RUN) else _OFF


class MotorProtocol(MotorRoutes, MotorDrives):
    """Controller's end of such a family. Holds tables only."""

    database: tuple[str, str] | None = None
    command_delay_ticks = 1
    set_up_frames: int
    reset_ticks = 3
    stop_latches = False
    force_on_brakes = False
    reports_power = True
    """Whether a drive says that it is enabled; else it is taken to be what it is asked for."""
    shares_identifiers = True
    answers_name_sync = False
    latches_together = False
    unasked_s = 0.0
    has_watchdog = True
    reactions: tuple[Reaction, ...] = (Reaction.BRAKE,)
    feedback_ids = frozenset(range(LEGS))
    """Legs: answers of several drives may share an identifier, or change it."""

    # what a family gives

    @abstractmethod
    def hear(self, frame: Frame) -> Heard | None:
        """Return what a drive's frame says; None for a frame that is nobody's."""

    @abstractmethod
    def poll(self, dialogue: MotorDialogue, leg: int) -> Frame:
        """Return what starts a tick for one drive."""

    @abstractmethod
    def exchanges(self, setup: DriveSetup) -> tuple[tuple[Exchange, ...], ...]:
        """Return the start-up dialogue of each leg. Raises ProtocolError if the set-up does not fit."""

    @abstractmethod
    def fault_text(self, code: int) -> str:
        """Return what a code of the column `drive_fault` means, OWN_CODE and more; empty if not known."""

    @property
    @abstractmethod
    def torque_limit(self) -> float:
        """N m, the largest that a command carries."""

    # controller's end

    def resolution(self, _rate_Hz: float) -> Resolution:
        """Return that of singles."""
        return Resolution.of_singles()

    @property
    def power_told(self) -> PowerTold:
        """Its feedback, where that says so."""
        return "feedback" if self.reports_power else "never"

    def reported_lengths(self) -> tuple[Array, Array] | None:
        """Return None: positions are turns without an end."""
        return None

    def carried(self, dialogue: MotorDialogue, force: Array) -> Array:
        """Return what the torques give legs at rest that are sent at the rates last read: no losses."""
        torque = self.transmission.torque(force, np.array(dialogue.rate))
        return self.transmission.force(self.coded(torque), np.zeros(LEGS))

    def coded(self, torque: Array) -> Array:
        """Return what the field carries of torques (6,) N m: as they are, where it is fine enough."""
        return torque

    @property
    def dangers(self) -> tuple[str, ...]:
        """What the family says of its brakes and of its watchdog."""
        return tuple(filter(None, (self.brake_danger, self.watchdog_danger)))

    @property
    def brake_danger(self) -> str:
        """What has to be there for a platform without power not to fall."""
        return _NO_BRAKE

    @property
    @abstractmethod
    def watchdog_danger(self) -> str:
        """What is wrong with the drives' own watchdog; empty where `start` sets it and reads it back."""

    def start(self, setup: DriveSetup) -> MotorDialogue:
        """Return the dialogue before its first frame. Raises ProtocolError if the set-up does not fit."""
        if not 0.0 < setup.watchdog_s <= 100.0:
            raise ProtocolError(
                f"drive watchdog of {setup.watchdog_s} s: more than 0 up to 100 s are allowed"
            )
        if setup.reaction not in self.reactions:
            names = " or ".join(each.name.lower() for each in self.reactions)
            raise ProtocolError(
                f"reactions.silence {setup.reaction.name.lower()}: these drives {names} by themselves; "
                "write that"
            )
        return MotorDialogue(self.exchanges(setup), setup.watchdog_s)

    def begin(self, dialogue: MotorDialogue, _tick: int) -> tuple[Frame, ...]:
        """Return one poll a drive; it carries the command of the tick before."""
        return tuple([self.poll(dialogue, leg) for leg in range(LEGS)])

    def awaited(self, frame: Frame) -> int:
        """Return the leg whose feedback a frame is, -1 for none."""
        heard = self.hear(frame)
        return heard.leg if heard is not None and heard.feedback else -1

    def fresh(self, received: Received, _tick: int, since_ns: int) -> bool:
        """Tell whether a frame is feedback to this tick's poll: there is no counter, its time tells."""
        return received.t_ns >= since_ns and self.awaited(received.frame) >= 0

    def decode(
        self, dialogue: MotorDialogue, frames: Rows, last: Record, tick: Record, since_ns: int = ALWAYS
    ) -> MotorDialogue:
        """Fill the measurement of a tick; see `DriveProtocol.decode`.

        Feedback from before the poll answers an older one: it is counted in `rejected` once its drive is set
        up, and measures at its age where the drive owed it, so that a stall makes no leg stale. A second
        answer that says something else makes its node `doubled`, unless the drive owes answers of the ticks
        before: then the first ones may be those, and the last one counts. Of drives that send readings
        unasked, too, the newest counts; the others say nothing of them.
        """
        unasked = self.unasked_s > 0.0
        for name in _KEPT:
            tick[name] = last[name]
        number, before = int(tick["tick"]), int(last["tick"])
        tick["age"] = np.minimum(last["age"] + (number - before if before >= 0 else 1), NEVER)
        tick["blind"] = 0
        rejected, doubled, foreign = 0, 0, 0
        answers: dict[int, Heard] = {}
        late: dict[int, Heard] = {}
        faults = tick["drive_fault"]
        owed = [owes + 1 if done else 2 for owes, done in zip(dialogue.owed, dialogue.done, strict=True)]
        power, said = list(dialogue.power), list(dialogue.said)
        asked = int(_RUN if dialogue.mode == DriveMode.RUN else _OFF)
        for t_ns, frame in received_frames(frames):
            heard = self.hear(frame)
            if heard is None:
                continue
            leg = heard.leg
            if heard.broken:
                rejected += 1
            elif heard.foreign:
                foreign = int(Foreign.COMMAND)
            elif heard.answer is not None:
                dialogue = self._confirm(dialogue, leg, *heard.answer)
            elif heard.feedback and t_ns < since_ns:
                owed[leg] -= 1
                rejected += not unasked and dialogue.done[leg] > len(dialogue.exchanges[leg])
                if last["age"][leg] > 0 and before >= 0:
                    late[leg] = heard
            elif heard.feedback and leg in answers and owed[leg] <= 0 and not unasked:
                doubled |= (answers[leg] != heard) << leg
            else:
                if heard.power is not None or not self.reports_power:
                    power[leg] = asked if heard.power is None else heard.power
                    faults[leg] = heard.fault
                    said[leg] = number
                if heard.feedback:
                    owed[leg] -= 1
                    answers[leg] = heard
        left = [
            min(max(owes, 0), RESTART_TICKS) * (done > 0)
            for owes, done in zip(owed, dialogue.done, strict=True)
        ]
        dialogue = dialogue._replace(owed=tuple(left))
        if answers or late or (tuple(power), tuple(said)) != (dialogue.power, dialogue.said):
            dialogue = dialogue._replace(power=tuple(power), said=tuple(said))
            dialogue = self._measure(dialogue, late | answers, tick)
            for leg in late.keys() - answers.keys():
                if tick["age"][leg] == 0:
                    tick["age"][leg] = number - before
        tick["counted_age"], tick["rejected"], tick["doubled"] = tick["age"], rejected, doubled
        tick["foreign"] = foreign
        return self._restarted(dialogue, tick)

    def _measure(self, dialogue: MotorDialogue, answers: dict[int, Heard], tick: Record) -> MotorDialogue:
        """Fill in what the answers of this tick say of the legs."""
        t, mode = self.transmission, dialogue.mode
        motion = [answers[leg].motion if leg in answers else None for leg in range(LEGS)]
        turns, speeds = np.array([each or (0.0, 0.0) for each in motion]).T
        length, rate = t.length(turns), t.rate(speeds)
        torque = np.array([answers[leg].torque or 0.0 if leg in answers else 0.0 for leg in range(LEGS)])
        force = t.force(torque, rate)
        done, ran = list(dialogue.done), list(dialogue.ran)
        for leg, heard in answers.items():
            done[leg] = max(done[leg], 1)
            if heard.motion is None:
                tick["blind"][leg] = 1
                continue
            tick["length"][leg], tick["rate"][leg], tick["age"][leg] = length[leg], rate[leg], 0
            if heard.torque is not None:
                tick["drive_force"][leg] = force[leg]
        for leg, power in enumerate(dialogue.power):
            set_up = done[leg] > len(dialogue.exchanges[leg]) and power != DriveState.BOOT
            tick["drive_state"][leg] = wire_state(power, mode, set_up=set_up, ran=ran[leg])
            ran[leg] = mode == DriveMode.RUN and (ran[leg] or power == _RUN)
        rates = tuple(tick["rate"].tolist())
        return dialogue._replace(done=tuple(done), ran=tuple(ran), rate=rates)

    def _confirm(self, dialogue: MotorDialogue, leg: int, register: int, value: float) -> MotorDialogue:
        step = dialogue.done[leg] - 1
        if not 0 <= step < len(dialogue.exchanges[leg]):
            return dialogue
        asked = dialogue.exchanges[leg][step]
        if register != asked.register:
            return dialogue
        if np.float32(value) != np.float32(asked.value):
            return dialogue._replace(read=put(dialogue.read, leg, value))
        return dialogue._replace(
            done=put(dialogue.done, leg, step + 2),
            asked=put(dialogue.asked, leg, -RETRY_TICKS),
            read=put(dialogue.read, leg, None),
        )

    @staticmethod
    def _restarted(dialogue: MotorDialogue, tick: Record) -> MotorDialogue:
        """Forget the set-up of drives that were silent for long, and the state of those that tell none."""
        for leg, age in enumerate(tick["age"].tolist()):
            if age > RESTART_TICKS and dialogue.done[leg]:
                dialogue = dialogue._replace(done=put(dialogue.done, leg, 0))
            if tick["tick"] - dialogue.said[leg] > dialogue.patience_ticks:
                dialogue = dialogue._replace(power=put(dialogue.power, leg, int(DriveState.BOOT)))
        return dialogue

    def command(
        self, dialogue: MotorDialogue, command: Command, _tick: int
    ) -> tuple[MotorDialogue, tuple[Frame, ...]]:
        """Remember one tick's command for the next polls. Raises ProtocolError if a force does not fit."""
        force = command.force
        if force.shape != (LEGS,) or not np.isfinite(force).all():
            raise ProtocolError(f"force command {force.tolist()} N: six finite ones are allowed")
        torque = self.transmission.torque(force, np.array(dialogue.rate))
        if np.abs(torque).max() > self.torque_limit * (1.0 + 1e-9):
            raise ProtocolError(
                f"force command {force.tolist()} N needs {np.abs(torque).max():.4g} N m: up to "
                f"{self.torque_limit:g} N m are allowed; lower limits.force_N or change drives.transmission"
            )
        ran = dialogue.ran if command.mode == dialogue.mode else (False,) * LEGS
        return dialogue._replace(mode=int(command.mode), torque=tuple(torque.tolist()), ran=ran), ()

    def set_up(self, dialogue: MotorDialogue, tick: Record) -> tuple[MotorDialogue, tuple[Frame, ...]]:
        """Return the next request of one drive, if it is heard and disabled."""
        number = int(tick["tick"])
        for leg, exchanges in enumerate(dialogue.exchanges):
            step = dialogue.done[leg] - 1
            waits = number - dialogue.asked[leg] < RETRY_TICKS
            if not 0 <= step < len(exchanges) or waits or tick["age"][leg] > 1:
                continue
            if dialogue.power[leg] == _RUN or dialogue.mode in (DriveMode.READY, DriveMode.RUN):
                continue
            return dialogue._replace(asked=put(dialogue.asked, leg, number)), exchanges[step].frames
        return dialogue, ()

    def legs_set_up(self, dialogue: MotorDialogue) -> tuple[bool, ...]:
        """Return which drives are heard and have confirmed all that was asked of them."""
        return tuple(not self._lack(dialogue, leg) for leg in range(LEGS))

    def set_up_lacks(self, dialogue: MotorDialogue) -> tuple[str, ...]:
        """Return what is missing: the drive itself, or the register that is not confirmed."""
        return tuple(self._lack(dialogue, leg) for leg in range(LEGS))

    def _lack(self, dialogue: MotorDialogue, leg: int) -> str:
        done, exchanges = dialogue.done[leg], dialogue.exchanges[leg]
        if done == 0:
            return "it has not answered"
        if done > len(exchanges):
            return "" if dialogue.power[leg] != DriveState.BOOT else "it has not said whether it is enabled"
        asked, read = exchanges[done - 1], dialogue.read[leg]
        if read is None:
            return f"{asked.name} is not confirmed"
        return f"{asked.name} is {read:.7g} in the drive, {asked.value:.7g} here"
