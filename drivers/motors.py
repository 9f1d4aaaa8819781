"""What families of single-motor drives have in common: polled drives whose brake goes with their power stage.

A drive of such a family knows "enabled" and "disabled". DriveMode.READY leaves it disabled, its brake shut;
RUN enables it. The controller's end calls a disabled drive READY while READY is asked for, so a force cannot
build up against the brake: it comes with the enabling, or a tick later. A drive that was enabled and falls
back by itself while RUN is asked for has restarted: BOOT. It is not enabled again until RUN is asked for
anew, where it says so: a moteus may have obeyed the next command before it answers.
"""

import struct
from abc import abstractmethod
from collections.abc import Sequence
from functools import lru_cache

import numpy as np

from drivers import motor_kernels as kernels
from drivers.arrays import Array, Rows
from drivers.compiled.pointed import FAILED, data_at
from drivers.controller_end import MOST_FRAMES
from drivers.errors import ProtocolError
from drivers.frame_array import FRAME, sent_array, sent_frames
from drivers.motor_dialogue import OWN_CODE, RETRY_TICKS, Exchange, Heard, MotorDialogue
from drivers.motor_drives import MotorDrives, put
from drivers.motor_end import MotorsEnd, after, remember
from drivers.motor_kernels import (
    ANSWER,
    BROKEN,
    FEEDBACK,
    FOREIGN,
    HEARD,
    KEEPS,
    MOTION,
    MOTORS,
    POWER,
    TORQUE,
    wire_state,
)
from drivers.protocol import ALWAYS, BUS, OTHER_BUSES, DriveSetup, Frame, PowerTold, Received
from drivers.resolution import Resolution
from drivers.several_buses import SeveralBuses
from drivers.signals import LEGS, Command, DriveMode, DriveState
from drivers.tick_columns import Record
from drivers.transmission import Transmission

__all__ = ["OWN_CODE", "RETRY_TICKS", "Exchange", "Heard", "MotorDialogue", "MotorProtocol", "wire_state"]
_NO_BRAKE = (
    "drives.protocol: no frame of these drives works a brake, so a platform without power falls unless "
    "brakes of your own close by themselves when a drive is disabled; the brake tests test those"
)
_RUN = DriveState.RUN
_pack = struct.Struct("<qI4B64s").pack
"""Makes an element of FRAME."""


@lru_cache(maxsize=64)
def prepared(protocol: "MotorProtocol", watchdog_s: float) -> tuple[Record, Rows]:
    """Return the record of a family before its first frame, and the frames that it points to."""
    m = np.zeros((), MOTORS)
    frames = sent_array([frame for row in protocol.requests(watchdog_s) for frame in row])
    m["hear"], m["ear"], m["frames"] = protocol.ear.address, data_at(protocol.tables), data_at(frames)
    m["rule"], m["clears"] = protocol.rule, protocol.clears
    m["torque_at"], m["torque_bits"], m["torque_end"] = protocol.torque_field
    m["torque_limit"], m["unasked"] = protocol.torque_limit, protocol.unasked_s > 0.0
    m["reports"] = protocol.reports_power
    protocol.transmission.fill(m)
    return m, frames


class MotorProtocol(MotorDrives):
    """Controller's end of such a family, compiled in `drivers.motor_kernels`. Holds tables only."""

    rule = KEEPS
    """What a drive is sent, see `drivers.motor_kernels`."""
    clears = False
    """Whether CLEAR is sent to a drive in fault alone."""
    commanding = kernels.command
    """What takes a command."""
    polls: tuple[Frame, ...] = ()
    """What starts a tick, where that is not the command."""
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

    def __init__(
        self, transmission: Transmission, tables: Record, torque_field: tuple[int, int, float]
    ) -> None:
        """Take what `ear` works on, and where a command has its torque: first byte, bits, end in N m."""
        super().__init__(transmission, tables)
        self.torque_field = torque_field

    @property
    def feedback_ids(self) -> frozenset[int]:
        """See `feedback_by_leg`."""
        return frozenset(self.feedback_by_leg)

    # what a family gives

    @abstractmethod
    def requests(self, watchdog_s: float) -> Sequence[Sequence[Frame]]:
        """Return the frames to the six drives, by what they ask for: IDLE, CLEAR, ENABLE, DRIVE, PREPARE."""

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

    def hear(self, frame: Frame) -> Heard | None:
        """Return what a drive's frame says; None for a frame that is nobody's."""
        identifier, data, flags = frame
        heard = np.zeros((), HEARD)
        row = _pack(0, identifier, 0, len(data), flags % BUS, 0, data)
        if flags & OTHER_BUSES or not self.ear(self.tables, row, heard):
            return None
        leg, has, turns, speed, torque, power, fault, register, value = heard.tolist()
        return Heard(
            leg,
            broken=bool(has & BROKEN),
            foreign=bool(has & FOREIGN),
            motion=(turns, speed) if has & MOTION else None,
            feedback=bool(has & FEEDBACK),
            torque=torque if has & TORQUE else None,
            power=power if has & POWER else None,
            fault=fault,
            answer=(register, value) if has & ANSWER else None,
        )

    def sender(self, frame: Frame) -> int:
        """Return the leg whose drive sends a frame, -1 for a frame of nobody or of a controller."""
        heard = self.hear(frame)
        return -1 if heard is None or heard.foreign else heard.leg

    def record(self, dialogue: MotorDialogue) -> Record:
        """Return a record of the kernels with what the dialogue remembers."""
        m = prepared(self, dialogue.watchdog_s)[0].copy()
        remember(m, dialogue)
        return m

    def controller_end(self, setup: DriveSetup, buses: SeveralBuses | None = None) -> MotorsEnd:
        """Return the controller's end, compiled, on several buses where these are given."""
        record, frames = prepared(self, setup.watchdog_s)
        return MotorsEnd(buses or self, setup, (record, frames, self.commanding), self.polls)

    def poll(self, dialogue: MotorDialogue, leg: int) -> Frame:
        """Return what one drive is sent in each tick."""
        return self._next(dialogue)[leg]

    def _next(self, dialogue: MotorDialogue) -> tuple[Frame, ...]:
        into = np.empty(LEGS, FRAME)
        kernels.begin(self.record(dialogue), 0, data_at(into))
        return sent_frames(into)

    def begin(self, dialogue: MotorDialogue, _tick: int) -> tuple[Frame, ...]:
        """Return one poll a drive: it carries the command of the tick before, where `polls` are none."""
        return self.polls or self._next(dialogue)

    def awaited(self, frame: Frame) -> int:
        """Return whose feedback a frame is, see `feedback_by_leg`; -1 for none."""
        heard = self.hear(frame)
        return self.feedback_by_leg[heard.leg] if heard is not None and heard.feedback else -1

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
        m = self.record(dialogue)
        kernels.decode(m, data_at(frames), len(frames), since_ns, last, tick)
        return after(m, dialogue)

    def command(
        self, dialogue: MotorDialogue, command: Command, tick: int
    ) -> tuple[MotorDialogue, tuple[Frame, ...]]:
        """Return a tick's command frames: none where the next polls carry it.

        Raises ProtocolError if a force does not fit.
        """
        m, into = self.record(dialogue), np.empty(MOST_FRAMES, FRAME)
        force = np.ascontiguousarray(command.force, float)
        given = m, tick, int(command.mode), 0, data_at(force), data_at(into)
        sent = FAILED if force.shape != (LEGS,) else self.commanding(*given)
        if sent == FAILED:
            raise self._unfit(force, dialogue.rate)
        return after(m, dialogue), sent_frames(into[:sent])

    def _unfit(self, force: Array, rate: Sequence[float]) -> ProtocolError:
        if force.shape != (LEGS,) or not np.isfinite(force).all():
            return ProtocolError(f"force command {force.tolist()} N: six finite ones are allowed")
        most = np.abs(self.transmission.torque(force, np.array(rate))).max()
        return ProtocolError(
            f"force command {force.tolist()} N needs {most:.4g} N m: up to {self.torque_limit:g} N m are "
            "allowed; lower limits.force_N or change drives.transmission"
        )

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
