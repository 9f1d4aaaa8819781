"""What families of single-motor drives have in common: polled drives whose brake goes with their power stage.

A drive of such a family knows "enabled" and "disabled". DriveMode.READY leaves it disabled, its brake shut;
RUN enables it. The controller's end calls a disabled drive READY while READY is asked for, so a force cannot
build up against the brake: it comes with the enabling, or a tick later. A drive that was enabled and falls
back by itself while RUN is asked for has restarted: BOOT. It is not enabled again until RUN is
requested again, where it says so: a moteus may have obeyed the next command before it answers.
"""

from abc import abstractmethod
from collections.abc import Iterable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from drivers import motor_kernels as kernels
from drivers.arrays import Array, Rows
from drivers.compiled.compiler import INTEGER, record
from drivers.compiled.pointed import FAILED, Pointed, address_of, call, data_at, pointed
from drivers.controller_end import ControllerEnd
from drivers.errors import ProtocolError
from drivers.family import Family
from drivers.frame_array import FRAME, NO_FRAMES, sent_array
from drivers.frame_pointers import NOBODY, code, frame_at, legs_of, value, whole
from drivers.motor_kernels import EAR, FEEDBACK, FOREIGN, HEARD, KEEPS, MOTORS, RETRY_TICKS
from drivers.protocol import ALL_LEGS, SINGLE, DriveSetup, FARTHEST_m, Frame, Resolution, Traits
from drivers.signals import LEGS, NEVER, DriveMode, DriveState
from drivers.tick_columns import Record
from drivers.transmission import Transmission

NO_BRAKE = (
    "drives.protocol: no frame of these drives works a brake, so a platform without power falls unless "
    "brakes of your own close by themselves when a drive is disabled; the brake tests test those"
)
_FRAME_BYTES = FRAME.itemsize


class Exchange(NamedTuple):
    """One request of the start-up dialogue, and what its answer must be."""

    name: str
    register: int
    frames: tuple[Frame, ...]
    """Sent together; the last one is answered."""
    value: float
    """What the drive must answer, in the drive's unit."""


class MotorController(ControllerEnd):
    """The controller's end, compiled in `drivers.motor_kernels`.

    Feedback from before the poll answers an older one: it is counted in `rejected` once its drive is set up,
    and measures at its age where the drive owed it, so that a stall makes no leg stale. A second answer that
    says something else makes its node `doubled`, unless the drive owes answers of the ticks before: then the
    first ones may be those, and the last one counts. Of drives that send readings unasked, too, the newest
    counts; the others say nothing of them.
    """

    first = "mode"

    def __init__(self, family: "MotorProtocol", setup: DriveSetup) -> None:
        """Take a set-up. Raises ProtocolError if it does not fit."""
        family.check(setup)
        self._family, self._exchanges = family, family.exchanges(setup)
        self._frames = sent_array([frame for row in family.requests(setup.watchdog_s) for frame in row])
        m = np.zeros((), MOTORS)
        m["ear"], m["frames"] = data_at(family.tables), data_at(self._frames)
        m["rule"], m["clears"] = family.rule, family.clears
        m["torque_at"], m["torque_bits"], m["torque_end"] = family.torque_field
        m["torque_limit"], m["unasked"] = family.torque_limit, family.traits.unasked_s > 0.0
        m["reports"] = family.traits.power_told != "never"
        family.transmission.fill(m)
        for leg, exchanges in enumerate(self._exchanges):
            n = m["exchanges"][leg] = len(exchanges)
            m["registers"][leg, :n] = [each.register for each in exchanges]
            m["values"][leg, :n] = [each.value for each in exchanges]
        m["power"], m["asked"] = DriveState.BOOT, -RETRY_TICKS
        m["patience_ticks"] = family.patience_ticks(setup.rate_Hz)
        polls = sent_array(family.polls)[np.newaxis] if family.polls else kernels.begin
        super().__init__(m, kernels.decode, family.commanding, polls)

    def set_up(self, tick: Record) -> Rows:
        """Return the next request of one drive, if it is heard and disabled."""
        m: Any = self.state
        number, powered = int(tick["tick"]), m["mode"] in (DriveMode.READY, DriveMode.RUN)
        for leg, exchanges in enumerate(self._exchanges):
            step = m["done"][leg] - 1
            waits = powered or m["power"][leg] == DriveState.RUN or number - m["asked"][leg] < RETRY_TICKS
            if 0 <= step < len(exchanges) and not waits and tick["age"][leg] <= 1:
                m["asked"][leg] = number
                return sent_array([self._family.to_leg(leg, each) for each in exchanges[step].frames])
        return NO_FRAMES

    def lack(self, leg: int) -> str:
        """Return what is missing: the drive itself, or the register that is not confirmed."""
        m: Any = self.state
        done, exchanges = int(m["done"][leg]), self._exchanges[leg]
        if done == 0:
            return "it has not answered"
        if done > len(exchanges):
            return "" if m["power"][leg] != DriveState.BOOT else "it has not said whether it is enabled"
        asked = exchanges[done - 1]
        if not m["has_read"][leg]:
            return f"{asked.name} is not confirmed"
        return f"{asked.name} is {float(m['read'][leg]):.7g} in the drive, {asked.value:.7g} here"

    def carried(self, force: Array) -> Array:
        """Return what the torques give legs at rest that are sent at the rates last read: no losses."""
        family, rate = self._family, self.state["rate"]
        return family.transmission.force(
            family.coded(family.transmission.torque(force, rate)), np.zeros(LEGS)
        )

    def presume_running(self) -> None:
        """Take all drives for enabled."""
        self.state["power"] = DriveState.RUN

    def unfit(self, force: Array) -> ProtocolError:
        """Return what is wrong with forces that do not fit."""
        if force.shape != (LEGS,) or not np.isfinite(force).all():
            return ProtocolError(f"force command {force.tolist()} N: six finite ones are allowed")
        family = self._family
        most = np.abs(family.transmission.torque(force, self.state["rate"])).max()
        return ProtocolError(
            f"force command {force.tolist()} N needs {most:.4g} N m: up to {family.torque_limit:g} N m are "
            "allowed; lower limits.force_N or change drives.transmission"
        )


_EAR = record(kernels.EAR)


@pointed(_EAR, INTEGER, INTEGER, INTEGER)
def fresh(e: Any, frame_address: int, _tick: int, since_ns: int) -> int:
    """Return the leg, from 1 on, of a feedback to this tick's poll on its own bus; else 0: its time tells."""
    frame = frame_at(frame_address)
    at = np.int64(e.heard.ctypes.data)
    if frame.t_ns < since_ns or frame.bus >= e.buses:
        return 0
    if not call(e.hear, (address_of(e), frame_address, at)):
        return 0
    heard = kernels.heard_at(at, 1)[0]
    return heard.leg + 1 if heard.has & kernels.FEEDBACK and e.bus_of[heard.leg] == frame.bus else 0


@pointed(_EAR, INTEGER)
def addressed(e: Any, frame_address: int) -> int:
    """Return which legs a frame of the controller's end is for, bit i: leg i."""
    frame = frame_at(frame_address)
    identifier = np.int64(frame.id)
    number = identifier >> e.shift & e.mask
    if identifier == e.requests:
        number = whole(frame.data, 0, 2) if frame.length > 1 else NOBODY
    return legs_of(number, e.nodes, frame.bus, e.bus_of)


@pointed(record(kernels.MOTORS), INTEGER, INTEGER, INTEGER, INTEGER, INTEGER)
def push(m: Any, number: int, mode: int, _stop: int, force_at: int, into: int) -> int:
    """Put one frame a drive at an address, and one more to enable it or clear its fault; see `command`.

    For drives of which a heartbeat alone tells whether they are enabled.
    """
    before = m.mode
    if not kernels.remember(m, mode, force_at):
        return FAILED
    begins = mode == DriveMode.RUN and before != DriveMode.RUN
    sent = 0
    for leg in range(LEGS):
        # a heartbeat of before RUN ended may have said that it was off
        if before == DriveMode.RUN and mode != DriveMode.RUN and m.power[leg] == DriveState.OFF:
            m.power[leg] = DriveState.RUN.value
        has_had_time = m.said[leg] - m.asked[leg] >= kernels.RETRY_TICKS
        idle = has_had_time and m.power[leg] == DriveState.OFF and not m.ran[leg]
        if begins or (mode == DriveMode.RUN and idle):
            m.asked[leg] = number
            kernels.send(m, kernels.ENABLE, leg, into + sent * _FRAME_BYTES)
            sent += 1
        kernels.send(m, kernels.row_of(m, leg), leg, into + sent * _FRAME_BYTES)
        sent += 1
        if mode == DriveMode.RESET:
            kernels.send(m, kernels.CLEAR, leg, into + sent * _FRAME_BYTES)
            sent += 1
    return sent


ANY = 0x1FFFFFFF
"""Bits of an identifier."""


class MotorProtocol(Family):
    """The tables of such a family."""

    ear: Pointed
    """The family's `hear`, see `drivers.motor_kernels`."""
    fresh_by, addressed_by = fresh, addressed
    rule = KEEPS
    """What a drive is sent, see `drivers.motor_kernels`."""
    clears = False
    """Whether CLEAR is sent to a drive in fault alone."""
    commanding = kernels.command
    """What takes a command."""
    polls: tuple[Frame, ...] = ()
    """What starts a tick, where that is not the command."""
    number_at: tuple[int, int]
    """Where an identifier has the number of a drive, and its bits there."""
    delivered_s = 1e6
    """The watchdog of a drive as it is delivered."""
    fault_names: Mapping[int, str] = {}
    """What the family's fault codes mean, less OWN_CODE."""
    fault_bits = False
    """Whether a fault code is a sum of those."""
    silence = stopped = -1
    """Fault code of a drive's own watchdog, and of an emergency stop; -1: it has none."""
    torque_limit: float
    """N m, the largest that a command carries."""

    def __init__(
        self,
        transmission: Transmission,
        nodes: Sequence[int],
        torque_field: tuple[int, int, float],
        legs: Sequence[Sequence[int]] = (ALL_LEGS,),
        answers: Sequence[int] = ALL_LEGS,
    ) -> None:
        """Take the drives' numbers, where a command has its torque, the legs of each bus and their answers.

        torque_field: first byte, bits, end in N m, see `drivers.motor_kernels.MOTORS`. answers: identifiers
        of the feedbacks; legs, where several drives share an identifier or change it.
        """
        super().__init__(nodes, legs)
        self.transmission, self.torque_field = transmission, torque_field
        self.legs_of = {node: leg for leg, node in enumerate(nodes)}
        self.tables: Record = np.zeros((), EAR)
        """What `ear` works on."""
        self.tables["nodes"], self.tables["hear"], self.tables["requests"] = nodes, self.ear.address, -1
        self.tables["silence"], self.tables["stopped"] = self.silence, self.stopped
        self.tables["shift"], self.tables["mask"] = self.number_at
        self.tables["buses"], self.tables["bus_of"] = self.buses, self.bus_of
        self.wanted = tuple(answers)

    # what a family gives

    @abstractmethod
    def requests(self, watchdog_s: float) -> Sequence[Sequence[Frame]]:
        """Return the frames to the six drives, by what they ask for: IDLE, CLEAR, ENABLE, DRIVE, PREPARE."""

    def exchanges(self, _setup: DriveSetup) -> tuple[tuple[Exchange, ...], ...]:
        """Return the start-up dialogue of each leg. Raises ProtocolError if the set-up does not fit."""
        return ((),) * LEGS

    def patience_ticks(self, _rate_Hz: float) -> int:
        """Return after how many ticks a drive is unknown that does not say whether it is enabled."""
        return NEVER

    # what is the same in all

    def traits_of(self, feedbacks: Iterable[Frame], **own: Any) -> Traits:
        """Return the traits of a family, given an example of each drive's feedback and what is its own."""
        torques = self.to_each(self.requests(1.0)[kernels.DRIVE])
        singles = Resolution.of(SINGLE * FARTHEST_m, 0.0, 0.0)
        same = {"resolution": singles, "feedback_ids": frozenset(self.wanted)}
        return Traits(sent=(*self.polls, *torques), feedbacks=self.to_each(feedbacks), **same | own)

    def fault_text(self, code: int) -> str:
        """Return the meaning of a code of the column `drive_fault`, at least OWN_CODE; empty: unknown."""
        own, names = code - kernels.OWN_CODE, self.fault_names
        if self.fault_bits:
            return ", ".join(text for bit, text in names.items() if own > 0 and own & bit)
        return names.get(own, "")

    def coded(self, torque: Array) -> Array:
        """Return torques (6,) N m as the field carries them: truncated to its steps; singles unchanged."""
        _, bits, end = self.torque_field
        if bits == kernels.SIGNED:
            return np.array([kernels.signed_code(each, end) * end / 32768.0 for each in torque.tolist()])
        codes = [code(each, -end, end, bits) for each in torque.tolist()] if bits < 32 else ()
        return np.array([value(each, -end, end, bits) for each in codes]) if codes else torque

    def check(self, setup: DriveSetup) -> None:
        """Raise ProtocolError if the set-up does not fit."""
        if not 0.0 < setup.watchdog_s <= 100.0:
            raise ProtocolError(
                f"drive watchdog of {setup.watchdog_s} s: more than 0 up to 100 s are allowed"
            )
        self.refuse_reaction(setup)

    def controller_end(self, setup: DriveSetup) -> MotorController:
        """Return the controller's end. Raises ProtocolError if the set-up does not fit."""
        return MotorController(self, setup)

    def _heard(self, frame: Frame) -> Any:
        """Content of a drive's frame, an element of HEARD; None for a frame of an unknown drive."""
        heard = np.zeros((), HEARD)
        said = self.ear(self.tables, sent_array([frame]), heard)
        return heard if said and self.bus_of[heard["leg"]] == frame.bus else None

    def sender(self, frame: Frame) -> int:
        """Return the leg whose drive sends a frame on its own bus, -1 for any other frame."""
        heard = self._heard(frame)
        return -1 if heard is None or heard["has"] & FOREIGN else int(heard["leg"])

    def awaited(self, frame: Frame) -> int:
        """Return whose feedback a frame is, see `wanted`; -1 for none."""
        heard = self._heard(frame)
        return self.wanted[heard["leg"]] if heard is not None and heard["has"] & FEEDBACK else -1
