"""Common parts of single-motor drive families: polled drives whose brake follows their power stage.

Such a drive is enabled or disabled. DriveMode.READY leaves it disabled, with its brake closed; RUN enables
it. The controller's end reports a disabled drive as READY while READY is requested, so a force cannot build
up against the brake: it comes with the enabling, or a tick later. A drive that was enabled and becomes
disabled while RUN is requested has restarted: BOOT. It is not enabled again until RUN is requested again,
provided that it reports this: a moteus may have obeyed the next command before it answers.
"""

from abc import abstractmethod
from collections.abc import Iterable, Mapping, Sequence
from math import isnan
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
    "drives.protocol: no frame of these drives operates a brake, so a platform without power falls unless "
    "it has brakes of its own that close when a drive is disabled; the brake tests check them"
)
_FRAME_BYTES = FRAME.itemsize


class Exchange(NamedTuple):
    """One request of the start-up dialogue, and the required answer of the drive."""

    name: str
    register: int
    frames: tuple[Frame, ...]
    """Frames sent together; the drive answers the last one."""
    value: float
    """Required answer, in the drive's unit."""


class MotorController(ControllerEnd):
    """The controller's end of single-motor drives, compiled in `drivers.motor_kernels`.

    Feedback from before the poll answers an older poll. It counts in `rejected` once its drive is set up. If
    the drive owed it, it measures at its age, so that a stall makes no leg stale. A second answer with other
    content marks its node as `doubled`, unless the drive owes answers of earlier ticks: then the first ones
    may be those, and the last one counts. Of drives that also send unrequested readings the newest counts,
    and different ones do not mark a node.
    """

    first = "mode"

    def __init__(self, family: "MotorProtocol", setup: DriveSetup) -> None:
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
        if family.traits.timed:
            m["parts"] = (1 << family.tables["parts"]) - 1
            m["gap_ns"] = round(0.5e9 * family.traits.unasked_s)
            m["period_ns"] = round(1e9 / setup.rate_Hz)
        stored = family.commanding is kernels.command
        polls = kernels.begin if stored else sent_array(family.polls)[np.newaxis]
        super().__init__(m, kernels.decode, family.commanding, polls)

    def set_up(self, tick: Record) -> Rows:
        """Next start-up request to the first drive that needs one, answers and is disabled; else none."""
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
        """Text: the drive that does not answer, or its unconfirmed register; empty if all is confirmed."""
        m: Any = self.state
        done, exchanges = int(m["done"][leg]), self._exchanges[leg]
        if done == 0:
            return "it has not answered"
        if done > len(exchanges):
            return "" if m["power"][leg] != DriveState.BOOT else "it has not reported whether it is enabled"
        asked = exchanges[done - 1]
        if not m["has_read"][leg]:
            return f"{asked.name} is not confirmed"
        read = float(m["read"][leg])
        if isnan(read):
            return f"{asked.name}: read refused"
        return f"{asked.name} is {read:.7g} in the drive, expected {asked.value:.7g}"

    def carried(self, force: Array) -> Array:
        """Forces (6,) N, push positive, at rest, of the torques sent for these, after truncation to steps."""
        family, rate = self._family, self.state["rate"]
        return family.transmission.force(
            family.coded(family.transmission.torque(force, rate)), np.zeros(LEGS)
        )

    def presume_running(self) -> None:
        """Mark all drives as enabled, even if none has reported: for an emulated second controller."""
        self.state["power"] = DriveState.RUN

    def unfit(self, force: Array) -> ProtocolError:
        """Error for leg forces (6,) N that need more torque than a command carries."""
        if force.shape != (LEGS,) or not np.isfinite(force).all():
            return ProtocolError(f"force command {force.tolist()} N: six finite numbers are allowed")
        family = self._family
        most = np.abs(family.transmission.torque(force, self.state["rate"])).max()
        return ProtocolError(
            f"force command {force.tolist()} N needs {most:.4g} N m: up to {family.torque_limit:g} N m are "
            "allowed; lower limits.force_N or change drives.transmission"
        )


_EAR = record(kernels.EAR)


@pointed(_EAR, INTEGER, INTEGER, INTEGER)
def fresh(e: Any, frame_address: int, _tick: int, since_ns: int) -> int:
    """Leg + 1 of a feedback to this tick's poll, received on the leg's bus after the poll; else 0."""
    frame = frame_at(frame_address)
    at = np.int64(e.heard.ctypes.data)
    if e.parts or frame.t_ns < since_ns or frame.bus >= e.buses:
        return 0
    if not call(e.hear, (address_of(e), frame_address, at)):
        return 0
    heard = kernels.heard_at(at, 1)[0]
    return heard.leg + 1 if heard.has & kernels.FEEDBACK and e.bus_of[heard.leg] == frame.bus else 0


@pointed(_EAR, INTEGER)
def addressed(e: Any, frame_address: int) -> int:
    """Legs that a frame sent by a controller addresses, bit i: leg i."""
    frame = frame_at(frame_address)
    identifier = np.int64(frame.id)
    number = identifier >> e.shift & e.mask
    if identifier == e.requests:
        number = whole(frame.data, 0, 2) if frame.length > 1 else NOBODY
    return legs_of(number, e.nodes, frame.bus, e.bus_of)


@pointed(record(kernels.MOTORS), INTEGER, INTEGER, INTEGER, INTEGER, INTEGER)
def push(m: Any, number: int, mode: int, _stop: int, force_at: int, into: int) -> int:
    """Write each drive's command frame, and those that enable it or clear its fault, to address `into`.

    For drives that report only by heartbeat whether they are enabled. force_at: address of (6,) N. Returns
    the number of frames, or FAILED if a force does not fit.
    """
    before = m.mode
    if not kernels.remember(m, mode, force_at):
        return FAILED
    begins = mode == DriveMode.RUN and before != DriveMode.RUN
    sent = 0
    for leg in range(LEGS):
        # a heartbeat from before the end of RUN may have reported it as off
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
"""Mask of a 29-bit identifier."""


class MotorProtocol(Family):
    """Base of the codecs of drive families with one motor per node: their tables and rules."""

    ear: Pointed
    """The family's `hear`, see `drivers.motor_kernels`."""
    fresh_by, addressed_by = fresh, addressed
    rule = KEEPS
    """Rule for the frames to a drive, see `drivers.motor_kernels`."""
    clears = False
    """True if CLEAR is sent only to a drive in fault."""
    commanding = kernels.command
    """Kernel that stores or sends a command."""
    polls: tuple[Frame, ...] = ()
    """Frames that start a tick, if they are not the command."""
    number_at: tuple[int, int]
    """Shift and mask of a node number in an identifier."""
    delivered_s = 1e6
    """Factory setting of a drive's watchdog, s."""
    fault_names: Mapping[int, str] = {}
    """Meaning of the family's fault codes, without the offset OWN_CODE."""
    fault_bits = False
    """True if a fault code is a sum of bits of `fault_names`."""
    silence = stopped = -1
    """Fault code of a drive's own watchdog, and of an emergency stop; -1: none."""
    torque_limit: float
    """Largest torque that a command carries, N m."""

    def __init__(
        self,
        transmission: Transmission,
        nodes: Sequence[int],
        torque_field: tuple[int, int, float],
        legs: Sequence[Sequence[int]] = (ALL_LEGS,),
        answers: Sequence[int] = ALL_LEGS,
    ) -> None:
        """Set node numbers, torque field, legs of each bus, and identifiers of the drives' feedbacks.

        torque_field: first byte, bits, end in N m, see `drivers.motor_kernels.MOTORS`. answers: identifiers
        of the feedbacks; leg numbers instead, if several drives share an identifier or change it.
        """
        super().__init__(nodes, legs)
        self.transmission, self.torque_field = transmission, torque_field
        self.legs_of = {node: leg for leg, node in enumerate(nodes)}
        self.tables: Record = np.zeros((), EAR)
        """Tables of `ear`."""
        self.tables["nodes"], self.tables["hear"], self.tables["requests"] = nodes, self.ear.address, -1
        self.tables["silence"], self.tables["stopped"] = self.silence, self.stopped
        self.tables["shift"], self.tables["mask"] = self.number_at
        self.tables["buses"], self.tables["bus_of"] = self.buses, self.bus_of
        self.wanted = tuple(answers)

    # members that a family supplies

    @abstractmethod
    def requests(self, watchdog_s: float) -> Sequence[Sequence[Frame]]:
        """Frames to the six drives for each purpose, in order: IDLE, CLEAR, ENABLE, DRIVE, PREPARE."""

    def exchanges(self, _setup: DriveSetup) -> tuple[tuple[Exchange, ...], ...]:
        """Requests of each leg's start-up dialogue. Raises ProtocolError if the set-up does not fit."""
        return ((),) * LEGS

    def patience_ticks(self, _rate_Hz: float) -> int:
        """Ticks without a report after which a drive's power state counts as unknown."""
        return NEVER

    # common to all families

    def traits_of(self, feedbacks: Iterable[Frame], **own: Any) -> Traits:
        """Properties from example feedbacks, once or more often of each drive; own: fields of `Traits`."""
        torques = self.to_each(self.requests(1.0)[kernels.DRIVE])
        singles = Resolution.of(SINGLE * FARTHEST_m, 0.0, 0.0)
        same = {"resolution": singles, "feedback_ids": frozenset(self.wanted)}
        answers = tuple(self.to_leg(k % LEGS, frame) for k, frame in enumerate(feedbacks))
        return Traits(sent=(*self.polls, *torques), feedbacks=answers, **same | own)

    def fault_text(self, code: int) -> str:
        """Meaning of a value of the column `drive_fault` from OWN_CODE on; empty if unknown."""
        own, names = code - kernels.OWN_CODE, self.fault_names
        if self.fault_bits:
            return ", ".join(text for bit, text in names.items() if own > 0 and own & bit)
        return names.get(own, "")

    def coded(self, torque: Array) -> Array:
        """Torques (6,) N m after truncation to the steps of their field; float32 fields leave them as is."""
        _, bits, end = self.torque_field
        if bits == kernels.SIGNED:
            return np.array([kernels.signed_code(each, end) * end / 32768.0 for each in torque.tolist()])
        if bits == kernels.MAPPED:
            return np.trunc(torque / end + np.copysign(1e-3, torque)) * end if end else torque
        codes = [code(each, -end, end, bits) for each in torque.tolist()] if bits < 32 else ()
        return np.array([value(each, -end, end, bits) for each in codes]) if codes else torque

    def check(self, setup: DriveSetup) -> None:
        """Raise ProtocolError if the drives cannot have the set-up's watchdog or reaction."""
        if not 0.0 < setup.watchdog_s <= 100.0:
            raise ProtocolError(
                f"drives.watchdog_ms: {1e3 * setup.watchdog_s:g} ms, allowed: more than 0, up to 100000 ms"
            )
        self.refuse_reaction(setup)

    def controller_end(self, setup: DriveSetup) -> MotorController:
        """Compiled controller's end of the drives. Raises ProtocolError if the set-up does not fit."""
        return MotorController(self, setup)

    def _heard(self, frame: Frame) -> Any:
        heard = np.zeros((), HEARD)
        said = self.ear(self.tables, sent_array([frame]), heard)
        return heard if said and self.bus_of[heard["leg"]] == frame.bus else None

    def sender(self, frame: Frame) -> int:
        """Leg whose drive sends a frame on its own bus; -1 for any other frame."""
        heard = self._heard(frame)
        return -1 if heard is None or heard["has"] & FOREIGN else int(heard["leg"])

    def awaited(self, frame: Frame) -> int:
        """Identifier, an element of `wanted`, by which the loop waits for this feedback; -1: no feedback."""
        heard = self._heard(frame)
        return self.wanted[heard["leg"]] if heard is not None and heard["has"] & FEEDBACK else -1
