"""CiA 402 drives over CANopen as a `Family`: cyclic synchronous torque by SYNC and PDO.

In a tick SYNC is sent, without counter. Each drive answers with TPDO1 (statusword, position, torque) and, if
configured, TPDO2 (velocity). Each gets RPDO1 (controlword, target torque), which acts at once; every few
ticks the controller's heartbeat follows. A TPDO has no counter: it answers the SYNC after which it arrived.
The node number in an identifier gives the drive, by the predefined connection set. No clock.
"""

import struct
from functools import cached_property

import numpy as np

from drivers.arrays import Rows
from drivers.cia402 import kernels
from drivers.cia402 import objects as o
from drivers.cia402.controller_end import (
    FAULT_REACTIONS,
    MOST_REQUESTS,
    Cia402End,
    Step,
    addressed,
    fresh,
    max_torque,
    plan,
)
from drivers.cia402.kernels import FROM_DRIVES
from drivers.cia402.states import STOP_QUICKLY, meaning
from drivers.config import BusSettings, DriveSettings
from drivers.family import Family
from drivers.motor_settings import Options
from drivers.protocol import REVISION, SERIAL, STRANGE, DriveSetup, Frame, Resolution, Said, Traits

MAX_NODE = 127
_RPDO = struct.Struct("<Hh")
_NODE = 0x7F
_IDENTITY = {o.SERIAL: SERIAL, o.REVISION: REVISION}
_ALLOWED = ("rated_torque_Nm", "velocity", "controller_node", "check_encoder", "eds", *o.HAS)
_MOST_Nm = 4_294_967.0
"""Largest value of 0x6076, N m."""


_BRAKES = (
    "drives.protocol cia402: the drives operate their own brakes, open only in Operation Enabled, and give "
    "no force while these are closed: the brake tests prove that the brakes carry the platform, but no "
    "force holds a leg whose brake slips (modes LOADING, UNLOADING and HELD); set the drives' own delays "
    "between torque and brake"
)
_DIFFERENCE = (
    "drives.options.velocity difference: leg rates are differences of lengths; their noise is that of the "
    "encoder times the rate of the loop"
)
_VOUCHED = {
    o.RATED_TORQUE: (
        "drives.options.has_rated_torque false: without 0x6076 nothing checks rated_torque_Nm, and "
        "all forces are wrong by as much as it is: take it from the motor's data sheet, and compare a force "
        "of each leg in a bring-up"
    ),
    o.ABORT_CONNECTION: (
        "drives.options.has_abort_connection false: nothing here sets what a drive without 0x6007 does when "
        "the controller's heartbeat is lost: set a fault that closes the brake with the maker's tool, and "
        "try it on each drive by stopping the controller"
    ),
}
"""Danger, for `hil check`, of drives without an object."""


class Cia402Protocol(Family):
    """Codec of six CiA 402 drives. Has constant tables only; run-time state is in `Cia402End`."""

    fresh_by, addressed_by = fresh, addressed

    def __init__(self, bus: BusSettings, drives: DriveSettings) -> None:
        options = Options(bus, drives, "cia402", "classic", _ALLOWED)
        self.transmission = transmission = options.transmission
        super().__init__(drives.node_ids, bus.legs)
        rated_Nm = options.within("rated_torque_Nm", 1e-3, _MOST_Nm, "the motors' rated torque, 0x6076")
        self.velocity = velocity = options.choice("velocity", ("pdo", "difference"), "pdo") == "pdo"
        self.controller_node = options.whole("controller_node", MAX_NODE, 1, MAX_NODE)
        check_encoder = options.flag("check_encoder", default=True)
        self.may_lack = {key for name, key in o.HAS.items() if not options.flag(name, default=True)}
        """Objects that the drives may lack, by the user's options."""
        own = self.controller_node
        self.refuse_nodes(1, MAX_NODE, "cia402", f" without the controller's own {own}", own)
        self._permille_Nm = 1e-3 * rated_Nm
        N_per_permille = (transmission.N_per_Nm * self._permille_Nm).tolist()
        self._increments = [round(count) if check_encoder else 0 for count in transmission.counts.tolist()]
        self.rated_torque_mNm = round(1e3 * rated_Nm)
        force_N = drives.force_limit_N / float(transmission.driving.min())
        self.max_torque_permille = max_torque(force_N, N_per_permille)
        self.heartbeat_ms = min(max(round(drives.heartbeat_ms), 1), 0xFFFF)
        self.tables: Rows = np.zeros((), kernels.DRIVES)
        c = self.tables
        c["nodes"], c["velocity"] = self.nodes, velocity
        c["N_per_permille"], c["buses"], c["bus_of"] = N_per_permille, self.buses, self.bus_of
        transmission.fill(c)
        c["controller"], c["permille_Nm"] = self.controller_node, self._permille_Nm
        c["permille_per_N"] = [1.0 / scale for scale in N_per_permille]
        c["m_per_count"] = transmission.m_per_turn / transmission.counts
        c["lossless"] = (transmission.driving == 1.0).all() and (transmission.back_driving == 1.0).all()
        self.wanted = tuple(kind + node for kind in o.TPDO_ID[: 1 + velocity] for node in self.nodes)
        self.senders = {base + node: leg for base in FROM_DRIVES for leg, node in enumerate(self.nodes)}

    @cached_property
    def traits(self) -> Traits:
        """Properties of CiA 402 drives for bus load, loop and safety checks.

        Heartbeats, SDO and EMCY have no reserved place in a tick: they use the free part of the bus. A rate
        from TPDO2 is off by one count. An emergency stop is a quick stop: its option code 2 ends in Switch On
        Disabled, brake closed.
        """
        t, sizes = self.transmission, zip(o.TPDO_ID, (8, 4) if self.velocity else (8,), strict=False)
        count = t.m_per_turn / t.counts
        ends = t.length(-float(1 << 31) / t.counts), t.length(float((1 << 31) - 1) / t.counts)
        answers = zip(*(self._to_each(kind, bytes(size)) for kind, size in sizes), strict=True)
        return Traits(
            family="cia402",
            resolution=Resolution.of(
                count, count, 0.5 * t.N_per_Nm * self._permille_Nm, differences=not self.velocity
            ),
            sent=(*self.to_all(Frame(o.SYNC_ID, b"")), *self._to_each(o.RPDO_ID[0], bytes(4))),
            feedbacks=tuple(frame for leg in answers for frame in leg),
            emergency_stop=self._to_each(o.RPDO_ID[0], _RPDO.pack(STOP_QUICKLY, 0)),
            feedback_ids=frozenset(self.wanted),
            identity_requests=tuple(self._to_each(o.SDO_REQUEST_ID, o.upload(key)) for key in _IDENTITY),
            set_up_frames=MOST_REQUESTS,
            reset_ticks=6,
            reactions=tuple(FAULT_REACTIONS),
            dangers=(
                _BRAKES,
                *(() if self.velocity else (_DIFFERENCE,)),
                *(_VOUCHED[key] for key in o.HAS.values() if key in self.may_lack),
            ),
            stop_latches=True,
            latches_together=True,
            reported_lengths=(np.minimum(*ends), np.maximum(*ends)),
        )

    def fault_text(self, code: int) -> str:
        """Meaning of an EMCY error code, with the code in hexadecimal as in CiA documents."""
        return f"EMCY 0x{code:04X}, {meaning(code)}"

    # controller's end

    def plans(self, setup: DriveSetup) -> tuple[tuple[Step, ...], ...]:
        """Steps of each drive's start-up dialogue.

        Raises ProtocolError if the watchdog does not fit or is too short for the rate, and for a reaction
        that such drives do not have.
        """
        own = zip(self.nodes, self._increments, strict=True)
        return tuple(plan(node, setup, self, increments) for node, increments in own)

    def controller_end(self, setup: DriveSetup) -> Cia402End:
        """The controller's end of these drives in compiled form; raises as `plans`."""
        return Cia402End(self, setup, self.plans(setup))

    # the drive of a frame

    def _to_each(self, base: int, data: bytes) -> tuple[Frame, ...]:
        return self.to_each(Frame(base + node, data) for node in self.nodes)

    def said_by(self, frame: Frame) -> Said | None:
        """Serial or revision number in a drive's SDO answer; None for any other frame, or an abort."""
        leg, read = self.senders.get(frame.id, -1), o.read_value(frame.data)
        if leg < 0 or frame.id & ~_NODE != o.SDO_REPLY_ID or frame.flags & STRANGE or read is None:
            return None
        key, value = read
        return Said(leg, _IDENTITY[key], value) if key in _IDENTITY else None
