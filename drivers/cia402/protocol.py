"""CiA 402 drives over CANopen as a `DriveProtocol`: cyclic synchronous torque by SYNC and PDO.

A tick: SYNC without counter; each drive answers with TPDO1 (statusword, position, torque), where asked for
with TPDO2 (velocity) too; each gets RPDO1 (controlword, target torque), which acts at once; every few ticks
our heartbeat follows. A TPDO carries no counter: it answers the SYNC after which it arrived. No clock.
"""

import struct
from collections.abc import Sequence

import numpy as np

from drivers.arrays import Array, Ints, Rows
from drivers.cia402 import kernels
from drivers.cia402 import objects as o
from drivers.cia402.devices import Devices, DevicesEnd, Memory
from drivers.cia402.emergency import meaning
from drivers.cia402.end import Cia402End, Drives
from drivers.cia402.kernels import MOST_PERMILLE
from drivers.cia402.plan import FAULT_REACTIONS, Settings, max_torque, plan
from drivers.cia402.routes import Routes
from drivers.cia402.set_up import Cia402Dialogue, lack, next_frames
from drivers.cia402.states import STOP_QUICKLY
from drivers.compiled.pointed import FAILED, data_at
from drivers.ends import Hearing
from drivers.errors import ConfigurationError, ProtocolError
from drivers.frame_array import FRAME, sent_frames
from drivers.protocol import (
    ALWAYS,
    DeviceMessage,
    DriveSetup,
    Frame,
    PowerTold,
    Received,
    Status,
    Sync,
)
from drivers.resolution import Resolution
from drivers.several_buses import SeveralBuses
from drivers.signals import LEGS, Command, DriveMode, DriveState
from drivers.tick_columns import Record
from drivers.transmission import Transmission

MAX_NODE = 127
_RPDO = struct.Struct("<Hh")
_BEATS = 4
"""Heartbeats of ours within the drives' watchdog, where the rate allows."""


_BRAKES = (
    "drives.protocol cia402: the drives keep their own brakes, open in Operation Enabled alone, and give no "
    "force while these are closed: the brake tests prove that the brakes carry the platform, but a brake "
    "that slips is not backed by a force (modes LOADING, UNLOADING and HELD); set the drives' own delays "
    "between torque and brake"
)
_DIFFERENCE = (
    "drives.options.velocity difference: leg rates are differences of lengths, with the noise of the encoder "
    "times the rate of the loop"
)


class Cia402Protocol(Routes):
    """Six CiA 402 drives. Holds tables only.

    `node_ids` are the drives' node numbers, leg order; `transmission` says what a turn and a torque are at
    the leg; `rated_torque_Nm` is the motors' (0x6076), the unit of torques being its thousandth;
    `velocity` asks for TPDO2, else leg rates are differences of lengths. Raises ConfigurationError on node
    numbers that are not six different ones of 1..127 beside the controller's own.
    """

    database = None
    command_delay_ticks = 0
    set_up_frames = 3
    shares_identifiers = False
    answers_name_sync = False
    unasked_s = 0.0
    latches_together = True
    stop_latches = True
    force_on_brakes = False
    has_watchdog = True
    power_told: PowerTold = "feedback"
    reactions = tuple(FAULT_REACTIONS)
    reset_ticks = 6

    def __init__(
        self,
        node_ids: Sequence[int],
        transmission: Transmission,
        rated_torque_Nm: float,
        *,
        force_limit_N: float = 60_000.0,
        heartbeat_ms: float = 100.0,
        velocity: bool = True,
        controller_node: int = MAX_NODE,
        check_encoder: bool = True,
    ) -> None:
        self.node_ids = _nodes(node_ids, controller_node)
        self.transmission, self.velocity = transmission, velocity
        self.controller_node = controller_node
        self._permille_Nm = 1e-3 * rated_torque_Nm
        self.dangers = (_BRAKES,) if velocity else (_BRAKES, _DIFFERENCE)
        N_per_permille = (transmission.N_per_Nm * self._permille_Nm).tolist()
        self._permille_per_N = [1.0 / scale for scale in N_per_permille]
        self._increments = [round(count) if check_encoder else 0 for count in transmission.counts.tolist()]
        self._settings = Settings(
            rated_torque_mNm=round(1e3 * rated_torque_Nm),
            max_torque_permille=max_torque(force_limit_N / float(transmission.driving.min()), N_per_permille),
            heartbeat_ms=min(max(round(heartbeat_ms), 1), 0xFFFF),
            controller_node=controller_node,
            velocity=velocity,
        )
        self._heartbeat = Frame(o.HEARTBEAT_ID + controller_node, bytes((o.OPERATES,)))
        self._sync = (Frame(o.SYNC_ID, b""),)
        self._drives = Drives(self._tables(N_per_permille), (self._heartbeat,))
        self._rpdo_ids = [o.RPDO_ID[0] + node for node in self.node_ids]
        self._devices = Devices(
            self.node_ids, transmission, self._settings.rated_torque_mNm, N_per_permille, velocity
        )
        self.feedback_ids = frozenset(self._devices.wanted)

    def _tables(self, N_per_permille: Sequence[float]) -> Record:
        """Return a record of the kernels before its first frame."""
        c, t = np.zeros((), kernels.DRIVES), self.transmission
        c["nodes"], c["controller"], c["velocity"] = self.node_ids, self.controller_node, self.velocity
        c["lossless"] = (t.driving == 1.0).all() and (t.back_driving == 1.0).all()
        c["m_per_count"] = t.m_per_turn / t.counts
        c["N_per_permille"], c["permille_per_N"] = N_per_permille, self._permille_per_N
        c["permille_Nm"] = self._permille_Nm
        t.fill(c)
        return c

    def resolution(self, rate_Hz: float) -> Resolution:
        """Return a count of length, and of rate what TPDO2 or the difference of lengths leaves.

        Counts are rounded or truncated, so their differences are off by half a count each. Of the last three
        lengths `difference` takes 1.5, 2 and 0.5 times: two counts a period.
        """
        count = self.transmission.m_per_turn / self.transmission.counts
        rate = count if self.velocity else 2.0 * rate_Hz * count
        force = 0.5 * self.transmission.N_per_Nm * self._permille_Nm
        return Resolution.of(count, rate, force, differences=not self.velocity)

    def reported_lengths(self) -> tuple[Array, Array]:
        """Return the ends of 0x6064 as leg lengths."""
        edges = np.full(LEGS, -float(1 << 31)), np.full(LEGS, float((1 << 31) - 1))
        ends = [self.transmission.length_of_counts(edge) for edge in edges]
        return np.minimum(*ends), np.maximum(*ends)

    def carried(self, dialogue: Cia402Dialogue, force: Array) -> Array:
        """Return what whole thousandths of the rated torque give legs at rest of forces (6,) N."""
        running = dialogue._replace(stopped=0)
        _, frames = self.command(running, Command(DriveMode.RUN, force), 1)
        permille = [_RPDO.unpack(frame.data)[1] for frame in frames[:LEGS]]
        return np.array([n / scale for n, scale in zip(permille, self._permille_per_N, strict=True)])

    # controller's end

    def start(self, setup: DriveSetup) -> Cia402Dialogue:
        """Return the dialogue before its first request.

        Raises ProtocolError if the watchdog does not fit or is too short for the rate, and for a reaction
        that such drives do not have.
        """
        own = zip(self.node_ids, self._increments, strict=True)
        plans = tuple(plan(node, setup, self._settings, increments) for node, increments in own)
        beat = max(2, int(setup.watchdog_s * setup.rate_Hz) // _BEATS)
        return Cia402Dialogue(setup, plans, beat)

    def controller_end(self, setup: DriveSetup, buses: SeveralBuses | None = None) -> Cia402End:
        """Return the controller's end, compiled, on several buses where these are given."""
        return Cia402End(buses or self, setup, self._drives.record, *self._sync, self._heartbeat)

    def begin(self, _dialogue: Cia402Dialogue, _tick: int) -> tuple[Frame, ...]:
        """Return the SYNC, without counter."""
        return self._sync

    def fresh(self, received: Received, tick: int, since_ns: int) -> bool:
        """Tell whether a frame is a TPDO that arrived after the tick's SYNC."""
        return self._devices.fresh(received, tick, since_ns)

    def awaited(self, frame: Frame) -> int:
        """Return its identifier."""
        return frame.id

    def fault_text(self, code: int) -> str:
        """Return what the code of an EMCY means, with the code as the documents write it."""
        return f"EMCY 0x{code:04X}, {meaning(code)}"

    def decode(
        self, dialogue: Cia402Dialogue, frames: Rows, last: Record, tick: Record, since_ns: int = ALWAYS
    ) -> Cia402Dialogue:
        """Fill the measurement of a tick from that of the last one and the frames since.

        since_ns: when the loop woke up. A TPDO that came after this tick's SYNC had ended answers it; an
        earlier one answers the last one, and counts with age 1 if nothing newer is held. Refused, and counted
        in `rejected`: a wrong length, a statusword or an NMT state that there is not, an SDO frame that is no
        expedited answer. A second TPDO of a tick with other data makes the node `doubled`, and the first one
        counts; unless the drive owes one to an earlier SYNC since it was missed within the last STRAYING
        ticks: then the last one counts. A leg is as old as the older one of its two TPDOs. Boot-up, and a
        drive that has left Operational, begin its set-up anew.
        """
        drives = self._drives
        drives.dialogue = dialogue
        kernels.decode(drives.record, data_at(frames), len(frames), since_ns, last, tick)
        return drives.dialogue

    def command(
        self, dialogue: Cia402Dialogue, command: Command, tick: int
    ) -> tuple[Cia402Dialogue, tuple[Frame, ...]]:
        """Return six RPDO1, and our heartbeat where it is due.

        force (6,) N, > 0 extends. Raises ProtocolError if a torque is not finite or not -32767..32767
        thousandths of the rated one.
        """
        drives, force = self._drives, np.ascontiguousarray(command.force, float)
        drives.dialogue, into = dialogue, np.empty(LEGS + 1, FRAME)
        given = drives.record, tick, int(command.mode), command.stop, data_at(force), data_at(into)
        sent = FAILED if force.shape != (LEGS,) else kernels.command(*given)
        if sent == FAILED:
            most = min(MOST_PERMILLE / abs(scale) for scale in self._permille_per_N)
            raise ProtocolError(
                f"force command {force.tolist()} N does not fit 0x6071: six of up to {most:.6g} N are "
                "allowed; lower limits.force_N, or correct drives.options.rated_torque_Nm or "
                "drives.transmission"
            )
        return drives.dialogue, sent_frames(into[:sent])

    def set_up(self, dialogue: Cia402Dialogue, tick: Record) -> tuple[Cia402Dialogue, tuple[Frame, ...]]:
        """Return the requests of this tick, see `drivers.cia402.plan`."""
        return next_frames(dialogue, tick, self.node_ids, self.set_up_frames)

    def legs_set_up(self, dialogue: Cia402Dialogue) -> tuple[bool, ...]:
        """Tell which drives hold on their own word what was set, and answer the SYNC."""
        return tuple(dialogue.done(leg) for leg in range(LEGS))

    def set_up_lacks(self, dialogue: Cia402Dialogue) -> tuple[str, ...]:
        """Return the object that a drive refused, reads otherwise or does not answer for."""
        return tuple(lack(dialogue, leg) for leg in range(LEGS))

    def emergency_stop(self) -> tuple[Frame, ...]:
        """Return a quick stop for each drive: its option code 2 ends in Switch On Disabled, brake shut."""
        return tuple(Frame(identifier, _RPDO.pack(STOP_QUICKLY, 0)) for identifier in self._rpdo_ids)

    # drives' end

    def drives_end(self, buses: SeveralBuses | None = None) -> DevicesEnd | None:
        """Return the drives' end by address, powered up; None for a protocol that changes it."""
        return self._devices.end(buses) if type(self) is Cia402Protocol else None

    def hearing(self, buses: SeveralBuses | None = None) -> Hearing | None:
        """Return the controller's end by address, as far as it hears; None as `drives_end`."""
        return self._devices.hearing(buses) if type(self) is Cia402Protocol else None

    def addressed(self, frame: Frame) -> tuple[int, ...]:
        """Return the leg of a PDO or SDO, or of the NMT command of one node; the others are for all.

        None for another node, and for an NMT command that names none.
        """
        return self._devices.addressed(frame)

    def power_up(self) -> Memory:
        """Return the memory of six drives that have just been powered up."""
        return self._devices.power_up()

    def parse(self, memory: Memory, frame: Frame) -> tuple[Memory, tuple[DeviceMessage, ...]]:
        """Decode at the drives' end, see `Devices`."""
        return self._devices.parse(memory, frame)

    def answer(
        self,
        memory: Memory,
        sync: Sync,
        length: Array,
        rate: Array,
        force: Array,
        state: Ints,
        _fault: Ints | None = None,
    ) -> tuple[Memory, list[tuple[int, Frame]]]:
        """Encode the TPDOs of the drives that send some, see `Devices`."""
        return self._devices.answer(memory, sync, length, rate, force, state)

    def report(self, memory: Memory, status: Status) -> tuple[Memory, tuple[Frame, ...]]:
        """Encode boot-up, EMCY and heartbeat of a drive, see `Devices`."""
        return self._devices.report(memory, status)

    @staticmethod
    def restarted(memory: Memory, _legs: Sequence[int]) -> Memory:
        """Return the memory as it is: a drive's state tells `Devices`."""
        return memory

    # bus time

    def cyclic_frames(self) -> tuple[Frame, ...]:
        """Return one example of every frame of a tick: SYNC, RPDOs, TPDOs.

        The heartbeats, of which no tick needs one, are left to the free part of the bus, as are SDO and EMCY.
        """
        zeros, off = np.zeros(LEGS), np.full(LEGS, DriveState.OFF, np.int64)
        memory = self._devices.set_up(self._settings, off)
        _, answers = self._devices.answer(memory, Sync(0), zeros, zeros, zeros, off)
        commands = [Frame(identifier, _RPDO.pack(0, 0)) for identifier in self._rpdo_ids]
        return (*self._sync, *commands, *(frame for _, frame in answers))


def _nodes(node_ids: Sequence[int], controller_node: int) -> tuple[int, ...]:
    nodes = tuple(node_ids)
    if len(nodes) != LEGS or len(set(nodes)) != LEGS:
        raise ConfigurationError(f"drives.node_ids: allowed: {LEGS} different ones, given: {list(nodes)}")
    for leg, node in enumerate(nodes):
        if not 1 <= node <= MAX_NODE or node == controller_node:
            raise ConfigurationError(
                f"drives.node_ids[{leg}]: allowed with cia402: 1 to {MAX_NODE} without the controller's own "
                f"{controller_node}, given: {node}"
            )
    return nodes
