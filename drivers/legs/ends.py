"""Both ends of the own protocol; the controller's is compiled in `drivers.legs.kernels`, the drives' here.

Fields and checks as there. CONFIG and E-stop are left to Python.
"""

from typing import Any

import numpy as np

from drivers.arrays import Array, Rows
from drivers.compiled.compiler import INTEGER, helper
from drivers.compiled.pointed import FAILED, integers_at, pointed
from drivers.controller_end import CompiledController
from drivers.ends import COMMAND, REJECTED, SYNC, CompiledDrives, frame_at, message_at, reading_at
from drivers.errors import ProtocolError
from drivers.frame_array import FRAME, NO_FRAMES, sent_array
from drivers.frame_pointers import begin_sent, place_of, whole
from drivers.legs import kernels
from drivers.legs.kernels import EXACT, QUANTITIES, STRANGE, check_of, ends, intact, natural, read, write
from drivers.legs.messages import set_up_checksum
from drivers.protocol import (
    ALL_LEGS,
    Configure,
    DeviceMessage,
    DriveSetup,
    EmergencyStop,
    Frame,
    Rejected,
)
from drivers.signals import LEGS, DriveMode, DriveState, Reaction
from drivers.tick_columns import Record

TRIES = 10
"""How often a drive that does not confirm its set-up is sent its CONFIG."""
SETUP_S = 0.02
"""From one CONFIG of a drive to its next."""
NOT_HEARD = -1
"""Said by a drive whose status has not been heard."""
_POWERED = (DriveState.READY, DriveState.RUN)
_REASONS = (
    "length or CRC of SYNC",
    "repeated SYNC",
    "command of {size} bytes",
    "CRC of a command",
    "unknown mode",
    "force not finite or out of range",
    "command {counter} while the present SYNC is {present}",
)
"""By the numbers of SYNC_BROKEN and what follows."""
NO_SYNC = -1
"""Of drives that have heard no SYNC yet."""
SYNC_BROKEN, SYNC_REPEATED, LENGTH, BROKEN, UNKNOWN_MODE, UNFIT, NOT_PRESENT = range(7)
"""Why a frame cannot be trusted: `mode` of a message REJECTED; of the last one `counter` is the command's."""
_MODES = len(DriveMode)
_FRAME = FRAME.itemsize


@helper
def _reject(message: Any, why: int) -> int:
    message.kind, message.mode, message.count = REJECTED, why, 0
    return 1


@helper
def _parse_sync(e: Any, frame: Any, bus: int, message: Any) -> int:
    if frame.length != e.sync_length or not intact(frame):
        return _reject(message, SYNC_BROKEN)
    counter = np.int64(frame.data[0])
    if counter == e.present[bus]:
        return _reject(message, SYNC_REPEATED)
    e.present[bus] = counter
    message.kind, message.counter, message.count = SYNC, counter, 0
    for leg in range(LEGS):
        if e.home[leg] == bus:
            message.legs[message.count] = leg
            message.count += 1
    return 1


@helper
def _parse_command(e: Any, of: Any, frame: Any, message: Any) -> int:
    """Take a command; bytes behind the check, which it does not cover, are 0 or the frame is BROKEN."""
    data, at, width = frame.data, of.check[0] >> 3, of.check[1] >> 3
    if frame.length != of.length:
        return _reject(message, LENGTH)
    if check_of(of.id, data, at, width) != whole(data, at, width):
        return _reject(message, BROKEN)
    for k in range(at + width, of.length):
        if data[k]:
            return _reject(message, BROKEN)
    mode = natural(data, of.mode[0], of.mode[1])
    if mode >= _MODES:
        return _reject(message, UNKNOWN_MODE)
    word = np.empty(1, np.int64)
    for k in range(of.forces):
        value = read(data, of.first + k * of.bits, of.bits, word)
        if not e.least <= value <= e.most:
            return _reject(message, UNFIT)
        message.force[k] = value if of.bits == EXACT else value * e.step
    present, counter = e.present[of.bus], natural(data, of.counter[0], of.counter[1])
    message.counter = counter
    if present == NO_SYNC or counter != present & ((1 << of.counter[1]) - 1):
        return _reject(message, NOT_PRESENT)
    message.kind, message.mode, message.count = COMMAND, mode, of.legs
    message.legs[:] = of.leg
    return 1


@pointed(ends, INTEGER, INTEGER)
def parse(e: Any, frame_address: int, message_address: int) -> int:
    """Decode a SYNC or a command; FAILED for a CONFIG or an E-stop.

    Rejected: wrong length or check, an unknown mode, a force that is not finite, a command that is not for
    the present SYNC, a SYNC that repeats the present one.
    """
    frame, message = frame_at(frame_address), message_at(message_address)
    identifier: Any = np.int64(frame.id)
    bus: Any = np.int64(frame.bus)
    if frame.flags & STRANGE or bus >= e.buses:
        return 0
    if identifier == e.sync:
        return _parse_sync(e, frame, bus, message)
    commands = kernels.commands_at(e.commands, e.frames)
    for n in range(e.frames):
        if identifier == commands[n].id and bus == commands[n].bus:
            return _parse_command(e, commands[n], frame, message)
    return FAILED if identifier == e.estop or place_of(identifier, e.config) >= 0 else 0


@pointed(ends, INTEGER, INTEGER, INTEGER, INTEGER)
def answer(e: Any, sync_address: int, reading_address: int, into: int, senders: int) -> int:
    """Fill in the feedbacks to a SYNC and the leg of each, leg order on each bus; FAILED for a NaN.

    What exceeds its field saturates.
    """
    sync, reading = message_at(sync_address), reading_at(reading_address)
    values = (reading.length, reading.rate, reading.force)
    asked, count, last = 0, 0, e.feedback_length - 1
    for k in range(sync.count):
        asked |= 1 << sync.legs[k]
    for k in range(QUANTITIES):
        for leg in range(LEGS):
            if e.bits[k] > 0 and np.isnan(values[k][leg]):
                return FAILED
    legs, word = integers_at(senders, LEGS), np.empty(1, np.int64)
    for bus in range(e.buses):
        for leg in range(LEGS):
            if e.home[leg] != bus or not asked >> leg & 1:
                continue
            frame = frame_at(into + count * _FRAME)
            begin_sent(frame, e.feedback[leg], e.feedback_length, e.feedback_flags, bus)
            data = frame.data
            for k in range(QUANTITIES):
                if e.bits[k] > 0:
                    value = min(max(values[k][leg], e.low[k]), e.high[k])
                    steps = value if e.bits[k] == EXACT else np.rint(value / e.scale[k])
                    write(steps, data, e.start[k], e.bits[k], word)
            data[e.counter_at] = reading.state[leg] << 4 | sync.counter & 0xF
            data[last] = check_of(e.feedback[leg], data, last, 1)
            legs[count] = leg
            count += 1
    return count


@pointed(ends, INTEGER, INTEGER, INTEGER, INTEGER, INTEGER, INTEGER, INTEGER)
def report(
    e: Any, leg: int, state: int, fault: int, watchdog_ns: int, reaction: int, _due: int, into: int
) -> int:
    """Fill in one drive's status."""
    checksum, last = 0, e.status_length - 1
    if watchdog_ns >= 0:
        watchdog = np.int64(np.rint(watchdog_ns * 1e-9 / e.watchdog_s))
        said = np.empty(11, np.uint8)
        said[4], said[5], said[6] = reaction, e.place[leg], e.version
        for k in range(4):
            said[k], said[7 + k] = watchdog >> 8 * k & 0xFF, e.rated_mN >> 8 * k & 0xFF
        checksum = check_of(e.config[leg], said, 11, 2)
    frame = frame_at(into)
    begin_sent(frame, e.status[leg], e.status_length, e.status_flags, e.home[leg])
    data = frame.data
    data[0], data[1], data[2], data[3] = state, fault, checksum & 0xFF, checksum >> 8
    data[last] = check_of(e.status[leg], data, last, 1)
    return 1


@pointed(ends, INTEGER, INTEGER, INTEGER)
def fresh(e: Any, frame_address: int, tick: int, since_ns: int) -> int:
    """Return the leg, from 1 on, of an intact feedback to this tick's SYNC on its own bus; else 0."""
    frame = frame_at(frame_address)
    identifier: Any = np.int64(frame.id)
    leg = place_of(identifier, e.feedback)
    good = leg >= 0 and frame.bus == e.home[leg] and not frame.flags & STRANGE
    good = good and frame.length == e.feedback_length and frame.t_ns >= since_ns
    good = good and (tick - np.int64(frame.data[e.counter_at])) & 0xF == 0
    return leg + 1 if good and intact(frame) else 0


@pointed(ends, INTEGER)
def addressed(e: Any, frame_address: int) -> int:
    """Return which legs on its bus a frame is for, bit i: leg i. Only a CONFIG is for one."""
    frame = frame_at(frame_address)
    identifier: Any = np.int64(frame.id)
    only, legs = place_of(identifier, e.config), 0
    for leg in range(LEGS):
        if frame.bus == e.home[leg] and only in (-1, leg):
            legs |= 1 << leg
    return legs


class LegsController(CompiledController):
    """The controller's end. Mutable state: the record."""

    first = "expected"

    def __init__(self, family: Any, setup: DriveSetup) -> None:
        """Begin the dialogue. Raises ProtocolError if the watchdog does not fit."""
        configs, begun = family.configure(setup.watchdog_s, setup.reaction), family.tables.copy()
        self._family, self._configs = family, sent_array(configs)
        begun["expected"] = [set_up_checksum(n, data[:-1], family.rated_force_N) for n, data, _ in configs]
        begun["interval"], begun["said"] = max(LEGS, round(SETUP_S * setup.rate_Hz)), NOT_HEARD
        super().__init__(begun, kernels.decode, kernels.command, family.syncs)

    def set_up(self, tick: Record) -> Rows:
        """Return the CONFIG of a drive that is heard and has none from us or does not confirm it, one a tick.

        A drive that is out of boot gets it TRIES times at most.
        """
        s, leg = self.state, int(tick["tick"]) % int(self.state["interval"])
        if leg >= LEGS or tick["age"][leg] > 1:
            return NO_FRAMES
        state = tick["drive_state"][leg]
        enough = s["sent"][leg] >= (1 if s["confirmed"] >> leg & 1 else TRIES)
        if state != DriveState.BOOT and (enough or state in _POWERED):
            return NO_FRAMES
        s["sent"][leg] += 1
        return self._configs[leg : leg + 1]

    def legs_set_up(self) -> tuple[bool, ...]:
        """Tell which drives have been sent their CONFIG and have confirmed it."""
        confirmed, sent = int(self.state["confirmed"]), self.state["sent"].tolist()
        return tuple([sent[leg] > 0 and confirmed >> leg & 1 == 1 for leg in ALL_LEGS])

    def lack(self, leg: int) -> str:
        """Return why a drive is not taken for set up; a status has a checksum of the set-up alone."""
        times, said, expected = (int(self.state[name][leg]) for name in ("sent", "said", "expected"))
        if self.legs_set_up()[leg]:
            return ""
        if not times:
            return "it was sent no CONFIG"
        if said in (NOT_HEARD, expected):
            return f"no status of it was heard that confirms one of {times} CONFIG"
        if said == 0:
            return "it reports no set-up: it has accepted no CONFIG"
        return (
            f"its set-up has checksum 0x{said:04X}, not 0x{expected:04X}: it holds another than the CONFIG "
            f"sent, or its rated force is not drives.force_limit_N, {self._family.rated_force_N:g} N"
        )

    def unfit(self, force: Array) -> ProtocolError:
        """Return that a force does not fit, with the forces of the first bus on which that is so."""
        s, of, shown = self.state, self._family.commands[0][0], force
        for legs in self._family.legs if force.shape == (LEGS,) else ():
            shown = np.zeros(LEGS)
            shown[: len(legs)] = force[list(legs)]
            steps = shown if self._family.exact else np.rint(shown / s["step"])
            if not ((s["least"] <= steps) & (steps <= s["most"])).all():
                break
        return ProtocolError(
            f"force command {shown.tolist()} N does not fit layout {self._family.layout}: {of.low[0]:.12g} "
            f"to {of.high[0]:.12g} N are allowed; lower limits.force_N or choose another bus.layout"
        )


class LegsDrives(CompiledDrives):
    """Six drives. Mutable state: Cycle of the present SYNC of each bus, in the record."""

    def __init__(self, family: Any) -> None:
        self._family = family
        super().__init__(family.tables.copy(), parse, answer, report)

    def reason(self, why: int, counter: int, _number: float, frame: Frame) -> str:
        """Return why a SYNC or a command is rejected."""
        present = self.record["present"][frame.bus]
        return _REASONS[why].format(size=len(frame.data), counter=counter, present=present)

    def converse(self, frame: Frame) -> tuple[DeviceMessage, ...]:
        """Take an E-stop, whatever its payload, or a CONFIG."""
        there, config = self._family.legs[frame.bus], self.record["config"].tolist()
        if frame.id not in config:
            return (EmergencyStop(tuple(sorted(there))),)
        leg = config.index(frame.id)
        said = self._configured(leg, frame)
        return (said,) if leg in there or isinstance(said, Rejected) else ()

    def _configured(self, leg: int, frame: Frame) -> DeviceMessage:
        of, version = self._family.config, self.record["version"]
        data = frame.data
        if len(data) != of.length or kernels.check(frame.id, data[:-1], 1) != data[-1]:
            return Rejected("length or CRC of CONFIG")
        watchdog, reaction, place, given, _ = of.unpack(frame.data)
        if given != version:
            return Rejected(f"CONFIG of version {given} of the protocol, this drive has {version}")
        if watchdog < 1 or reaction >= len(Reaction) or place != self.record["place"][leg]:
            return Rejected(f"CONFIG with watchdog {watchdog} us, reaction {reaction}, leg {place}")
        return Configure(leg, watchdog * of.scale[0], Reaction(reaction))
