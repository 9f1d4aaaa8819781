"""The controller's end of CiA 402 drives: the kernels' record, and the start-up dialogue's part in Python.

A dialogue first reads the drive's properties. Then it writes, in Pre-operational, the PDOs in the order of
CiA 301, 7.5.2.36 (COB-ID not valid, transmission type, no entries, entries, their number, COB-ID), the
watchdog, the reactions and the mode. Then it reads all of these back, and requests Operational.
"""

from collections.abc import Sequence
from math import ceil
from typing import Any, Literal, NamedTuple

import numpy as np

from drivers.arrays import Array, Rows
from drivers.cia402 import kernels
from drivers.cia402 import objects as o
from drivers.cia402.kernels import MOST_PERMILLE, NOT_ASKED, OPTIONAL
from drivers.cia402.objects import Key
from drivers.cia402.states import ENABLED, UNHEARD
from drivers.compiled.compiler import INTEGER, record
from drivers.compiled.pointed import pointed
from drivers.controller_end import ControllerEnd
from drivers.errors import ProtocolError
from drivers.frame_array import NO_FRAMES, sent_array
from drivers.frame_pointers import EVERYONE, NOBODY, frame_at, legs_of, place_of
from drivers.protocol import STRANGE, DriveSetup, Frame
from drivers.signals import LEGS, DriveState, Reaction
from drivers.tick_columns import Record

LEAST_TICKS = 4
"""Shortest watchdog of the drives: a heartbeat goes out every second tick at most, and one may be lost."""
_ALL_BITS = 0xFFFF_FFFF
_NO_RTR = 1 << 30
"""Bit of a COB-ID that a drive may set by itself: no remote frames."""
_TPDO1 = ((o.STATUSWORD, 16), (o.POSITION, 32), (o.TORQUE, 16))
_TPDO2 = ((o.VELOCITY, 32),)
_RPDO1 = ((o.CONTROLWORD, 16), (o.TARGET_TORQUE, 16))
FAULT_REACTIONS = {Reaction.BRAKE: 0, Reaction.DAMP: 2}
"""Fault reaction option codes: disable at once; slow down on the quick stop ramp, then disable."""


class Step(NamedTuple):
    """One request of a drive's start-up dialogue: an SDO read, an SDO write or an NMT command."""

    kind: Literal["read", "write", "nmt"]
    key: Key
    value: int
    """Raw value, written or expected; for `nmt` the command."""
    size: int = 4
    """Bytes of the object."""
    optional: bool = False
    """True if a drive may lack the object."""
    mask: int = _ALL_BITS
    """Mask of the bits that are compared with the expected value."""

    def request(self, node: int) -> bytes:
        """Data bytes of the frame that makes this request of a node."""
        if self.kind == "nmt":
            return bytes((self.value, node))
        return o.download(self.key, self.value, self.size) if self.kind == "write" else o.upload(self.key)


def watchdog_ms(setup: DriveSetup) -> int:
    """Consumer heartbeat time, ms, after which a drive reacts to a silent controller.

    Raises ProtocolError if it does not fit into object 0x1016 or is too short for the loop rate.
    """
    time_ms = 1e3 * setup.watchdog_s
    least_s = max(5e-4, LEAST_TICKS * (1 - 1e-9) / setup.rate_Hz)
    if not least_s <= setup.watchdog_s < 65.535:
        raise ProtocolError(
            f"drives.watchdog_ms: {time_ms:g} ms, allowed at {setup.rate_Hz:g} Hz: at least {LEAST_TICKS} "
            f"periods, {1e3 * least_s:.4g} ms, and up to 65534 ms in object 0x1016"
        )
    return round(time_ms)


def _period(rate_Hz: float) -> tuple[int, int]:
    """(mantissa 1..255, power of ten) of the loop period, s: object 0x60C2, as exact as it can hold."""
    exponent = -5
    while 10.0**-exponent / rate_Hz > 255:
        exponent += 1
    return max(round(10.0**-exponent / rate_Hz), 1), exponent & 0xFF


def _pdo(index: int, n: int, cob: int, transmission: int, entries: tuple[tuple[Key, int], ...]) -> list[Step]:
    parameters, mapping = index + n, index + 0x200 + n
    return [
        Step("write", (parameters, 1), o.NOT_VALID | cob),
        Step("write", (parameters, 2), transmission, 1),
        Step("write", (mapping, 0), 0, 1),
        *(Step("write", (mapping, k), o.mapped(key, bits)) for k, (key, bits) in enumerate(entries, 1)),
        Step("write", (mapping, 0), len(entries), 1),
        Step("write", (parameters, 1), cob),
    ]


def _drive(setup: DriveSetup, family: Any) -> list[Step]:
    family.refuse_reaction(setup)
    consumer = family.controller_node << 16 | watchdog_ms(setup)
    mantissa, exponent = _period(setup.rate_Hz)
    return [
        Step("write", o.CONSUMER_HEARTBEAT, consumer),
        Step("write", o.PRODUCER_HEARTBEAT, family.heartbeat_ms, 2),
        Step("write", o.COMMUNICATION_ERROR, 1, 1, optional=True),
        Step("write", o.ABORT_CONNECTION, 1, 2, optional=o.ABORT_CONNECTION in family.may_lack),
        Step("write", o.QUICK_STOP, 2, 2),
        Step("write", o.FAULT_REACTION, FAULT_REACTIONS[setup.reaction], 2),
        Step("write", o.MODE, o.CYCLIC_TORQUE, 1),
        Step("write", o.MAX_TORQUE, family.max_torque_permille, 2),
        Step("write", o.PERIOD_MANTISSA, mantissa, 1, optional=True),
        Step("write", o.PERIOD_EXPONENT, exponent, 1, optional=True),
    ]


def _read_back(writes: list[Step]) -> list[Step]:
    """Steps that read each written object back and expect its last value; for the mode, object 0x6061."""
    last = {step.key: step for step in writes}
    steps = []
    for key, step in last.items():
        is_cob = key[1] == 1 and (o.RPDO <= key[0] < o.RPDO_MAP or o.TPDO <= key[0] < o.TPDO_MAP)
        mask = _ALL_BITS & ~_NO_RTR if is_cob else _ALL_BITS
        if is_cob and step.value & o.NOT_VALID:
            mask = o.NOT_VALID
        shown = o.MODE_SHOWN if key == o.MODE else key
        steps.append(step._replace(kind="read", key=shown, mask=mask))
    return steps


def plan(node: int, setup: DriveSetup, family: Any, increments: int = 0) -> tuple[Step, ...]:
    """Steps of the start-up dialogue with one drive. Raises ProtocolError if the set-up does not fit.

    family: the `Cia402Protocol`; increments: required encoder counts per turn, 0: not checked.
    """
    first = [
        Step("read", o.DEVICE_TYPE, o.PROFILE_402, mask=0xFFFF),
        Step("nmt", o.DEVICE_TYPE, o.PRE_OPERATIONAL),
        Step(
            "read", o.SUPPORTED_MODES, o.SUPPORTS_CYCLIC_TORQUE, optional=True, mask=o.SUPPORTS_CYCLIC_TORQUE
        ),
        Step("read", o.RATED_TORQUE, family.rated_torque_mNm, optional=o.RATED_TORQUE in family.may_lack),
    ]
    if increments:
        first.append(Step("read", o.ENCODER_INCREMENTS, increments, optional=True))
        first.append(Step("read", o.MOTOR_REVOLUTIONS, 1, optional=True))
    writes = _pdo(o.RPDO, 0, o.RPDO_ID[0] + node, o.AT_ONCE, _RPDO1)
    writes += _pdo(o.TPDO, 0, o.TPDO_ID[0] + node, o.AT_EVERY_SYNC, _TPDO1)
    if family.velocity:
        writes += _pdo(o.TPDO, 1, o.TPDO_ID[1] + node, o.AT_EVERY_SYNC, _TPDO2)
    for n in range(1 + family.velocity, len(o.TPDO_ID)):
        unused = o.NOT_VALID | o.TPDO_ID[n] + node
        writes.append(Step("write", (o.TPDO + n, 1), unused, optional=True))
    writes += _drive(setup, family)
    return (*first, *writes, *_read_back(writes), Step("nmt", o.DEVICE_TYPE, o.START))


def max_torque(force_limit_N: float, N_per_permille: list[float]) -> int:
    """Value for object 0x6072, max torque, permille of rated, that allows each leg its `force_limit_N`."""
    return min(ceil(force_limit_N / min(map(abs, N_per_permille)) * (1 - 1e-12)), 0xFFFF)


_DRIVES = record(kernels.DRIVES)
_NODE = 0x7F


@pointed(_DRIVES, INTEGER, INTEGER, INTEGER)
def fresh(c: Any, frame_address: int, _tick: int, since_ns: int) -> int:
    """Leg + 1 (TPDO1) or leg + 1 + LEGS (TPDO2) of an answer to this tick's SYNC on its bus; else 0."""
    frame = frame_at(frame_address)
    identifier = int(frame.id)
    leg = place_of(identifier & _NODE, c.nodes)
    if leg < 0 or frame.flags & STRANGE or frame.bus != c.bus_of[leg] or frame.t_ns < since_ns:
        return 0
    base = identifier & ~_NODE
    if base == o.TPDO_ID[0]:
        return leg + 1 if frame.length == 8 else 0
    return leg + LEGS + 1 if base == o.TPDO_ID[1] and c.velocity and frame.length == 4 else 0


@pointed(_DRIVES, INTEGER)
def addressed(c: Any, frame_address: int) -> int:
    """Legs that a controller's frame addresses, bit i: leg i. SYNC and heartbeat address all."""
    frame = frame_at(frame_address)
    identifier = int(frame.id)
    base = identifier & ~_NODE
    node = identifier & _NODE if base in o.RPDO_ID or base == o.SDO_REQUEST_ID else 0
    if identifier == o.NMT_ID:
        node = int(frame.data[1]) if frame.length > 1 else NOBODY
    return legs_of(node or EVERYONE, c.nodes, frame.bus, c.bus_of)


PATIENCE_S = 0.05
"""Time after which a request without an answer is repeated."""
LEAST_PATIENCE = 6
"""Least number of ticks before a request is repeated."""
TRIES = 20
"""Requests without an answer after which the dialogue starts again."""
MOST_REQUESTS = 3
"""Most start-up requests in a tick."""
_BEATS = 4
"""Heartbeats of the controller within the drives' watchdog, if the rate allows."""
_POWERED = (DriveState.READY, DriveState.RUN)


class Cia402End(ControllerEnd):
    """The controller's end of six CiA 402 drives. Mutable state: its record, with the start-up dialogue."""

    first = "patience"

    def __init__(self, family: Any, setup: DriveSetup, plans: Sequence[Sequence[Step]]) -> None:
        self._family, self._plans = family, plans
        rate_Hz, c = setup.rate_Hz, family.tables.copy()
        c["period_s"], c["beat"] = 1.0 / rate_Hz, max(2, int(setup.watchdog_s * rate_Hz) // _BEATS)
        c["patience"] = max(LEAST_PATIENCE, round(PATIENCE_S * rate_Hz))
        for leg, (node, steps) in enumerate(zip(c["nodes"].tolist(), plans, strict=True)):
            c["steps"][leg] = len(steps)
            for k, step in enumerate(steps):
                c["requests"][leg, k] = int.from_bytes(step.request(node), "little", signed=True)
                c["values"][leg, k], c["masks"][leg, k] = step.value, step.mask | OPTIONAL * step.optional
        c["asked"], c["states"] = NOT_ASKED, UNHEARD
        sync = sent_array(family.to_all(Frame(o.SYNC_ID, b"")))  # without counter
        super().__init__(c, kernels.decode, kernels.command, sync[np.newaxis])

    def presume_running(self) -> None:
        """Mark all drives as enabled, even if none has reported: for an emulated second controller."""
        self.state["states"] = ENABLED

    def unfit(self, force: Array) -> ProtocolError:
        """Error for leg forces (6,) N that need more torque than the drives' field can carry."""
        most = MOST_PERMILLE / np.abs(self.state["permille_per_N"]).max()
        return ProtocolError(
            f"force command {force.tolist()} N does not fit 0x6071: six values up to {most:.6g} N are "
            "allowed; lower limits.force_N, or correct drives.options.rated_torque_Nm or "
            "drives.transmission"
        )

    def carried(self, force: Array) -> Array:
        """Forces (6,) N, push positive, that drives at rest give for a command, rounded to whole permille."""
        c, t = self.state, self._family.transmission
        permille = (
            force * c["permille_per_N"] if c["lossless"] else t.torque(force, c["rate"]) / c["permille_Nm"]
        )
        carried: Array = np.rint(permille) / c["permille_per_N"]
        return carried

    # the start-up dialogue, see `plan`

    def set_up(self, tick: Record) -> Rows:
        """Frames of the start-up dialogue for this tick, at most MOST_REQUESTS; the legs take turns.

        A drive that reports READY or RUN gets none. A drive in fault is asked for its error code if its EMCY
        is missing: it was sent before the controller started, or was lost.
        """
        states, ages, codes = (tick[name].tolist() for name in ("drive_state", "age", "drive_fault"))
        done = (self.state["at"] == self.state["steps"]).tolist()
        unknown = [state == DriveState.FAULT and not code for state, code in zip(states, codes, strict=True)]
        if all(ready and not fault for ready, fault in zip(done, unknown, strict=True)):
            return NO_FRAMES
        c, number, waits = self.state, int(tick["tick"]), int(self.state["patience"])
        frames: list[Frame] = []
        for k in range(LEGS):
            leg = (number * MOST_REQUESTS + k) % LEGS
            asked = int(c["asked"][leg])
            if (done[leg] and not unknown[leg]) or (asked != NOT_ASKED and number - asked < waits):
                continue
            if states[leg] in _POWERED and ages[leg] < waits:
                continue
            if len(frames) == MOST_REQUESTS:
                break
            frames.append(self._family.to_leg(leg, self._request(leg, number, done=done[leg])))
        return sent_array(frames)

    def _request(self, leg: int, number: int, *, done: bool) -> Frame:
        c, node = self.state, int(self.state["nodes"][leg])
        if done:
            c["asked"][leg], c["tries"][leg] = number, 0
            return Frame(o.SDO_REQUEST_ID + node, o.upload(o.ERROR_CODE))
        if c["tries"][leg] >= TRIES and c["at"][leg]:
            c["at"][leg] = c["tries"][leg] = 0
        step = self._plans[leg][c["at"][leg]]
        c["asked"][leg], c["tries"][leg] = number, c["tries"][leg] + 1
        if step.kind != "nmt":
            return Frame(o.SDO_REQUEST_ID + node, step.request(node))
        if step.value != o.START:
            c["at"][leg], c["asked"][leg], c["tries"][leg] = c["at"][leg] + 1, NOT_ASKED, 0
        return Frame(o.NMT_ID, step.request(node))

    def lack(self, leg: int) -> str:
        """Text: the object that a drive refused, reports with another value, or does not answer for."""
        c, refused = self.state, int(self.state["refused"][leg])
        if c["at"][leg] == c["steps"][leg]:
            return ""
        step, abort = self._plans[leg][refused - 1 if refused else c["at"][leg]], int(c["abort"][leg])
        what = o.place(step.key)
        if not refused:
            why = f"no answer to {c['tries'][leg]} requests for {what}"
            return why if step.kind != "nmt" else "it sends no TPDO after its start by NMT"
        if abort:
            text = o.ABORTS.get(abort, "not a code of CiA 301: see the manual of the drive")
            way_out = o.way_out(step.key) if abort in {o.NO_OBJECT, o.NO_SUB_INDEX} else ""
            return f"{what}: {step.kind} refused with abort 0x{abort:08X} ({text}){way_out}"
        return f"{what} is {int(c['read'][leg]) & step.mask}, expected {step.value & step.mask}"
