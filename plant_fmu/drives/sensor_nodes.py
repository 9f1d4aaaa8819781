"""Emulated sensors in addition to the drives, of any family: they sample the plant's truth.

A sample is taken at its own instant, or at the SYNC or poll that it answers, and enters the bus after its
latency. The messages are those of the family's tables, written in the other direction. Between grid points of
the plant the pose is extrapolated with the twist. The specific force is the mean over the plant's last
internal step, as of a device that integrates.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np

from drivers.arrays import Array, Rows
from drivers.compiled.pointed import FAILED, data_at
from drivers.errors import PlantError, ProtocolError
from drivers.frame_array import FRAME, sent_frames, timed_array
from drivers.protocol import Frame
from drivers.rotations import turn
from drivers.sensing.family import SYNC_ID
from drivers.sensing.layout import FORCE, FREE, IMU, LENGTH, STAMPED, unheard
from drivers.sensors import SensorProtocol
from drivers.tick_columns import SENSORS, Record
from plant_fmu.config import SensorEmulation
from plant_fmu.drives.drive_rules import NEVER_NS
from plant_fmu.drives.nodes import Nodes
from plant_fmu.drives.sensor_kernels import SENSED, SILENT, fill_frame, listen, measure, velocity_at
from plant_fmu.plant import Truth


class SensedNodes(Nodes):
    """Six drives, the plant behind them, and the configured sensors.

    Mutable state, in addition to that of `Nodes`: of each sensor the next sample time, the counter, whether
    it has been started, and its last frames; a record of SENSED; the generator of random numbers. `start`
    resets all of it.
    """

    def __init__(
        self, sensors: SensorProtocol, noise: SensorEmulation, gravity: Sequence[float], *given: Any
    ) -> None:
        """Create drives and sensors; given: arguments of `Nodes`."""
        self._sensors, self._noise, self._gravity = sensors, noise, gravity
        self._of = sensors.sensors
        """Slot -> sensor."""
        self._period_ns = {slot: 1e9 / each.rate_Hz for slot, each in self._of.items()}
        timings = {slot: each.device.timing for slot, each in self._of.items()}
        self._own_clock = {slot for slot, timing in timings.items() if timing in (STAMPED, FREE)}
        """Slots that no frame triggers."""
        slots = sensors.tables.rows["slot"]
        self._rows = {slot: np.flatnonzero(slots == slot).tolist() for slot in self._of}
        """Slot -> places of its messages in the table."""
        self._calls: dict[Frame, list[tuple[int, bool]]] = {}
        """Frame -> slots that it starts (True) or triggers (False)."""
        for slot, each in self._of.items():
            device = each.device
            starts, polls = each.on_bus(device.start[-1:]), () if device.poll is None else (device.poll,)
            for frame, begins in [(f, True) for f in starts] + [(f, False) for f in each.on_bus(polls)]:
                self._calls.setdefault(frame, []).append((slot, begins))
        synced = {slot for slot in self._of if slot not in self._own_clock}
        self._synced = {slot: self._of[slot].bus for slot in synced if self._of[slot].device.poll is None}
        """Slots that sample at each SYNC, and their buses."""
        self._called_by = np.array(sorted({frame.id for frame in self._calls} | {SYNC_ID}), np.uint32)
        super().__init__(*given)

    def start(self, t0_ns: int) -> None:
        """`Nodes.start`; sensors with a clock of their own take the first sample at `t0_ns`."""
        super().start(t0_ns)
        self._start_ns = self._sense_ns = t0_ns
        self._count = dict.fromkeys(self._period_ns, 0)
        self._due_ns = {slot: t0_ns if slot in self._own_clock else NEVER_NS for slot in self._of}
        self._started = {slot: not each.device.start for slot, each in self._of.items()}
        self._last: dict[int, bytes] = {}
        self._held: dict[tuple[int, int], Array] = {}
        """(slot, start of a fault ns) -> the values then."""
        self._note_ns = NEVER_NS
        """When to store the velocity: one step of the plant before the IMU measures."""
        self._reception = unheard(self._sensors.tables)
        self._sensed: Record = np.zeros((), SENSED)
        n, drives = self._sensed, self._record
        n["sensors"], n["wrench"] = data_at(self._reception.record), data_at(drives["wrench"])
        n["length"], n["rate"] = data_at(drives["length"]), data_at(drives["rate"])
        self._applied: Array = np.zeros(6)
        n["force"], n["sync_id"], n["start_ns"] = data_at(self._applied), SYNC_ID, t0_ns
        n["before_ns"], n["heard_ns"], n["gravity"] = t0_ns, -NEVER_NS, self._gravity
        for slot, each in self._of.items():
            node, leg = getattr(self._noise, each.role), max(slot - LENGTH, 0) % 6
            n["bus"][slot] = each.bus
            n["noise"][slot], n["bias"][slot], n["drift"][slot] = node.errors(leg)
            frame_rad = np.deg2rad(node.frame_rotation_deg)
            n["turns"][slot], n["frame"][slot] = frame_rad.any(), turn(frame_rad, np.eye(3))
            n["lever"][slot] = node.lever_arm_m
        n["target"] = turn(np.deg2rad(self._noise.tracker.target_rotation_deg), np.eye(3))
        self._chance = np.random.default_rng((self._noise.seed, self._faults.seed))

    @property
    def unasked(self) -> bool:
        """True if a node sends readings by a clock of its own, without a time stamp."""
        return super().unasked or any(each.device.timing == FREE for each in self._of.values())

    @property
    def address(self) -> int:
        """Always 0: the sensors' frames have to be added after each pass."""
        return 0

    def advance(self, t_ns: int, received: Rows) -> Rows:
        """`Nodes.advance`, with the frames of the sensors among those of the drives.

        A pass ends at each sample of a sensor, as faults change the truth between samples. A frame is
        returned at its sample, with the later instant at which it enters the bus.
        """
        out: list[Rows] = []
        frames = received[np.argsort(received["t_ns"], kind="stable")]
        ends, calls = False, bool(self._calls or self._synced)
        while not ends:
            called = (
                frames["t_ns"][np.isin(frames["id"], self._called_by)][:1] if calls else frames["t_ns"][:0]
            )
            ends = self._sense_ns > t_ns and len(called) == 0
            at_ns = (
                t_ns if ends else min(self._sense_ns, t_ns, *(max(t, self.now_ns) for t in called.tolist()))
            )
            early = frames["t_ns"] <= at_ns
            heard, frames = frames[early], frames[~early]
            for k in range(len(heard)):  # sensors receive them unchanged by faults
                listen(self._sensed, data_at(heard[k:]))
            if calls:
                self._answer(sent_frames(heard), at_ns)
            out.append(super().advance(at_ns, heard).copy())
            if not ends and self._sense_ns <= at_ns:
                out += self._sense(at_ns)
        both = np.concatenate(out, dtype=FRAME)
        return both[np.argsort(both["t_ns"], kind="stable")]

    def _answer(self, frames: Sequence[Frame], t_ns: int) -> None:
        """Start sensors, and let those sample that a frame asks."""
        for frame in frames:
            due = [slot for slot, bus in self._synced.items() if (frame.id, frame.bus) == (SYNC_ID, bus)]
            for slot, begins in self._calls.get(frame, ()):
                if begins:
                    self._started[slot] = True
                else:
                    due.append(slot)
            for slot in due:
                self._due_ns[slot] = self._sense_ns = t_ns

    def _sense(self, t_ns: int) -> list[Rows]:
        truth, grid_ns = self._known_truth(), self._grid_ns()
        if truth is None and any(slot < LENGTH for slot in self._of):
            raise PlantError("sensors: the plant does not know its pose, so nothing can measure it")
        self._applied[:] = self._record["force"] if truth is None else truth.applied_force
        if FORCE in self._of and (rods := self._plant.rod_force()) is not None:
            self._applied[:] = rods
        frames: dict[tuple[int, ...], Rows | None] = {}
        for slot, due_ns in self._due_ns.items():
            if due_ns == t_ns:
                self._sample(slot, t_ns, truth or _NOWHERE, grid_ns, frames)
                self._count[slot] += 1
                next_ns = self._start_ns + round(self._count[slot] * self._period_ns[slot])
                self._due_ns[slot] = next_ns if slot in self._own_clock else NEVER_NS
                if slot == IMU:
                    noted_ns = next_ns - round(self._h_ns) if slot in self._own_clock else t_ns
                    self._note_ns = max(noted_ns, t_ns)
        if self._note_ns <= t_ns and truth is not None:
            lever = self._sensed["lever"][IMU]
            self._sensed["before_ns"] = grid_ns
            self._sensed["before"] = velocity_at(lever, truth.R, truth.twist)
            self._note_ns = NEVER_NS
        self._sense_ns = min(self._note_ns, *self._due_ns.values())
        return [sent for frame in frames.values() if frame is not None for sent in self._carried(frame)]

    def _sample(
        self, slot: int, t_ns: int, truth: Truth, grid_ns: int, frames: dict[tuple[int, ...], Rows | None]
    ) -> None:
        """Take one sample, and add its fields to the frames of this instant; None is a frame not sent.

        Slots that share a message share its frame: the first one decides on its latency and loss.
        """
        n, each, chance = self._sensed, self._of[slot], self._chance
        node = getattr(self._noise, each.role)
        chance.standard_normal(out=n["drawn"])
        if node.outlier_percent and chance.random() < 0.01 * node.outlier_percent:
            n["drawn"] *= node.outlier_stds
        status = measure(n, slot, t_ns, grid_ns, *truth[:3])
        lost, late_ns = chance.random() < 0.01 * node.lost_percent, round(node.latency_ms * 1e6)
        for own in self._present.sensors:
            fault: Any = own.fault
            if fault.sensor != SENSORS[slot]:
                continue
            held = self._held.setdefault((slot, own.start_ns), n["values"].copy())
            match fault.kind:
                case "sensor_lost":
                    lost = True
                case "sensor_late":
                    late_ns += round(1e6 * fault.by_ms)
                case "sensor_frozen":
                    n["values"] = held
                case "sensor_offset":
                    n["values"][fault.axis] += fault.by
                case "sensor_drift":
                    n["values"][fault.axis] += fault.by * (1e-9 * (t_ns - own.start_ns))
                case "sensor_outlier":
                    n["values"][fault.axis] += fault.by * (own.generator.random() < 0.01 * fault.percent)
        if self._present.hangs or status == SILENT or not self._started[slot]:
            return
        late_ns += round(chance.random() * node.jitter_ms * 1e6) if node.jitter_ms else 0
        raw = n["values"].copy() if each.device.mix is None else np.linalg.solve(each.device.mix, n["values"])
        for row, message in zip(self._rows[slot], each.device.messages, strict=True):
            frame = np.zeros(1, FRAME)
            given = row, self._count[slot] & 0xFFFF, t_ns, 1e-3 * node.time_offset_ms, raw
            if fill_frame(n, *given, frame.reshape(())) == FAILED:
                raise ProtocolError(f"sample of {each.role} is not a number: {n['values'].tolist()}")
            frame["t_ns"] = t_ns + late_ns
            content = frame["data"].tobytes()
            stays = each.device.changes and self._last.get(row) == content
            whole = frames.setdefault((each.bus, *message.key), None if lost or stays else frame)
            if whole is frame:
                self._last[row] = content
            elif whole is not None:
                whole["data"] |= frame["data"]

    def _carried(self, frame: Rows) -> list[Rows]:
        """The frame as faults of the bus leave it: lost, late, altered or doubled."""
        if self._gateway is None:
            return [frame]
        carried = self.schedule.carry(int(frame["t_ns"][0]), sent_frames(frame)[0], to_drives=False)
        return [timed_array([(at_ns, arriving)]) for at_ns, arriving, _ in carried]


_NOWHERE = Truth(np.zeros(3), np.eye(3), np.zeros(6), np.zeros(6))
"""Pose for sensors of legs on a plant that knows none."""
