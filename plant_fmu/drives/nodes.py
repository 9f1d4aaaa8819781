"""Six emulated drives in front of a plant: encoder, limits, watchdog, heartbeat, brake.

Time. The plant moves on a grid of its internal step h from `start`. A command, a fault or a
watchdog acts at the grid point nearest to its instant, at most h/2 away. An encoder is sampled
between grid points as length + rate dt, |dt| <= h/2. With leg acceleration a its error is at most
a h^2/8 in length and a h/2 in rate (10 m/s^2 and 100 us: 13 nm and 0.5 mm/s). `Plant.step` is called once
between two events, and once per grid point while forces lag or a drive controls from its encoder.
"""

from collections.abc import Iterable, Sequence
from contextlib import suppress
from typing import Any

import numpy as np

from drivers.arrays import Rows
from drivers.config import DriveSettings
from drivers.errors import PlantError
from drivers.family import Family
from drivers.frame_array import FRAME, NO_FRAMES, received_array, received_frames, sent_frames, timed_array
from drivers.protocol import Frame, Received
from drivers.signals import LEGS
from drivers.transmission import Transmission
from plant_fmu.config import DriveEmulation
from plant_fmu.drives import drive_rules, drives_end, record
from plant_fmu.drives.compiled_pass import live
from plant_fmu.drives.drive import Drives, Reading, Snapshot, at_motor, forgotten_m, moved
from plant_fmu.drives.gateway import Gateway
from plant_fmu.faults.plan import FaultPlan, Schedule, weight
from plant_fmu.plant import Plant, Truth


class Nodes:
    """Six emulated drives and the plant that they move: the drives' side of the bus.

    States. A drive boots with its brake engaged; CONFIG takes it to OFF; then `TRANSITIONS` hold. RUN is
    reached through READY only. CONFIG is valid in BOOT, OFF and FAULT; the drive answers with a status that
    contains its settings. The watchdog runs in READY and RUN, from the last valid command with a new counter.

    Faults. A fault latches until RESET. Its reaction is the configured one in RUN, otherwise the brake, so
    that no fault opens a brake. Damping and holding end in the brake. A brake takes time to open and to
    close; the drive keeps its last force until the brake has closed. An emergency stop brakes and is
    reported, whatever was latched before.

    Mutable state: the plant, six drives, the protocol's state at their end, the time, the schedule of the
    faults and their state. Owner of all of it; `start` resets it.
    """

    def __init__(
        self,
        plant: Plant,
        protocol: Family,
        emulation: DriveEmulation,
        drives: DriveSettings,
        faults: FaultPlan | None = None,
    ) -> None:
        self._plant = plant
        self._protocol = protocol
        self._emulation = emulation
        self._settings = drives
        self._faults = FaultPlan() if faults is None else faults
        self._h_s = plant.internal_step_s
        self._h_ns = self._h_s * 1e9
        self.start(0)

    def start(self, t0_ns: int) -> None:
        """Power up at `t0_ns`: plant at its initial state, drives in BOOT, brakes engaged."""
        self._begin(t0_ns)
        n, transmission = self._record, self._transmission
        self._end, self._moved = drives_end(self._protocol), moved(self._plant)
        often_ns = 1e6 * self._settings.heartbeat_ms, 1e9 * self._protocol.traits.unasked_s
        self._drives.connect(self._end, self._moved, *often_ns)
        if transmission is not None:
            n["geared"], n["full_loss_m_s"] = True, transmission.full_loss_m_s
            n["driving"], n["back_driving"] = transmission.driving, transmission.back_driving
        n["h_ns"], n["quantum_m"] = self._h_ns, self._emulation.encoder_resolution_m
        self._switch_on([True] * LEGS)
        gateway = Gateway(self.schedule, self._protocol, drives_end(self._protocol), t0_ns)
        self._gateway = gateway if self._faults.touches_frames else None
        self._spoiled = Reading()
        self._missed: list[Rows] = []
        self._frames = NO_FRAMES
        self._apply_faults(t0_ns)

    def _begin(self, t0_ns: int) -> None:
        """Reset the plant, the record of the drives and the schedule of the faults."""
        length, rate = self._plant.reset()
        gear = self._settings.transmission
        self._transmission = transmission = None if gear is None else Transmission(gear)
        self._drives = Drives(at_motor(self._settings, transmission), self._emulation, self._h_s)
        self._record = n = self._drives.record
        n["length"], n["rate"] = length, rate
        truth = self._plant.truth()
        n["measured"][2] = np.nan if truth is None else truth.applied_force
        n["t0_ns"] = n["now_ns"] = n["calm_ns"] = t0_ns
        self.schedule = Schedule(self._faults, t0_ns)
        self.waiting = self.schedule.waiting
        """Faults that wait for a mode of the controller."""
        self.bus_off = 0
        """Bit i: a fault has cut bus i."""
        self._edges, self._present = self.schedule.edges_ns(t0_ns + 1), self.schedule.present(t0_ns)
        self._truth: Truth | None = None
        self._truth_k = -1

    def step(self, t_ns: int, received: Sequence[Received]) -> list[tuple[int, Frame]]:
        """`advance` for Python frames; returns pairs (time, ns, at which to queue it; frame to send)."""
        return [*received_frames(self.advance(t_ns, received_array(received)))]

    def advance(self, t_ns: int, received: Rows) -> Rows:
        """Advance to `t_ns`, receiving FRAME records; returns the frames to queue, in time order.

        `received` holds the frames that arrived since the last call, times up to `t_ns`; a frame older than
        the end of the last call counts as arriving then. Feedback is queued at the instant its SYNC arrives.
        Status is queued every heartbeat, one drive after the other, and at changes of state or fault if the
        family does so. A watchdog that ends exactly at `t_ns` waits for the next call: a command of that
        instant is in time. Frames that faults delay or add may have later instants. The result is valid
        until the next call. Raises PlantError if `t_ns` is before the last one or the plant fails.
        """
        self._check_time(t_ns)
        if self._present.hangs:
            self._missed.append(received.copy())
            if self.schedule.present(t_ns).hangs:
                return NO_FRAMES
            received, self._missed = np.concatenate(self._missed, dtype=FRAME), []
        if self._gateway is not None:
            received = received_array(self._gateway.hear(received_frames(received), t_ns))
        out = self.go_on(received, live(self._record, received, t_ns, False))
        return out if self._gateway is None else timed_array(self._gateway.send(received_frames(out)))

    def answer(self, t_ns: int, received: Rows, _awaited: Iterable[int], _deadline_ns: int) -> Rows:
        """`advance`: emulated drives answer a SYNC or poll at once."""
        return self.advance(t_ns, received)

    @property
    def address(self) -> int:
        """Address of the drives' record for compiled calls of `live`; 0: only `advance` is possible."""
        return 0 if self._gateway is not None or self._present.hangs else self._drives.address

    def go_on(self, received: Rows, status: int) -> Rows:
        """Do what `live` returned early for, and finish its call; returns the frames to send as `advance`."""
        self._frames = received
        while status:
            self._decide(status)
            again = status != record.UNSORTED
            status = live(self._record, self._frames, int(self._record["until_ns"]), again)
        return self._drives.out[: self._record["sent"]]

    def _decide(self, status: int) -> None:
        n = self._record
        t_ns = int(n["t_ns"])
        match status:
            case record.PLANT:
                force, brake, wrench = (n[name].copy() for name in ("at_leg", "brake", "wrench"))
                raise self._moved.refused(int(n["refusal"]), force, brake, wrench, int(n["steps"]))
            case record.UNSORTED:
                self._frames = self._frames[np.argsort(self._frames["t_ns"], kind="stable")]
            case record.FULL:
                self._drives.reserve(2 * len(self._drives.out))
            case record.EDGE:
                del self._edges[0]
                self._present = self.schedule.present(t_ns)
                self._apply_faults(t_ns)
            case record.PARSE:
                (frame,) = sent_frames(self._frames[int(n["frame"]) - 1][np.newaxis])
                n["heard"] = len(self._end.hear(frame))
            case record.BEFORE_READING:
                self._set_wrench()
                self._drives.drift(self._present, t_ns)
            case record.AFTER_READING:
                reading = self._drives.reading
                self._spoiled.spoil(self._present, t_ns, reading["length"], reading["rate"])
            case record.ANSWER:
                length, rate, force = (self._drives.reading[name] for name in ("length", "rate", "force"))
                leg = int((~np.isfinite(length + rate + force)).argmax())
                raise PlantError(
                    f"the plant gave no valid measurement: feedback of leg {leg} is not a number: "
                    f"{length[leg]} m, {rate[leg]} m/s, {force[leg]} N"
                )

    def reached(self, mode: str) -> None:
        """Start the faults whose times count from the instant at which the controller reaches `mode`."""
        now_ns = self.now_ns
        if self.schedule.reached(mode, now_ns):
            self._edges = self.schedule.edges_ns(now_ns)
            self._record["calm_ns"] = now_ns
            self._note_edge()
        self.waiting = self.schedule.waiting

    @property
    def now_ns(self) -> int:
        """Time that the drives have reached, ns: end of the last `advance`, or where it failed."""
        return int(self._record["now_ns"])

    @property
    def unasked(self) -> bool:
        """True if a node sends readings by a clock of its own, without a time stamp."""
        return self._protocol.traits.unasked_s > 0.0

    @property
    def next_reading_ns(self) -> int:
        """Time at which the next drive sends an unrequested reading, ns."""
        return int(self._record["reading_ns"])

    @property
    def syncs(self) -> int:
        """Number of SYNC frames or polls received since the start."""
        return int(self._record["syncs"])

    def snapshot(self) -> Snapshot:
        """State of plant and drives now, in copied arrays; `truth` is None for a plant that has failed."""
        truth, n = None, self._record
        with suppress(PlantError):  # the next step reports it
            truth = self._known_truth()
        copied = ("length", "rate", "command", "force", "state", "fault", "brake", "wrench")
        counts = ("syncs", "commands", "repeated", "rejected")
        seen: Any = {name: n[name].copy() for name in copied} | {name: int(n[name]) for name in counts}
        return Snapshot(
            t_ns=self._grid_ns(),
            applied=n["force"].copy() if truth is None else truth.applied_force,
            truth=truth,
            **seen,
        )

    # time

    def _check_time(self, t_ns: int) -> None:
        if t_ns < self.now_ns:
            raise PlantError(f"nodes: time {t_ns} ns is before that of the last call, {self.now_ns} ns")

    def _grid_ns(self) -> int:
        n = self._record
        return int(n["t0_ns"]) + round(int(n["k"]) * self._h_ns)

    def _note_edge(self) -> None:
        self._record["edge_ns"] = self._edges[0] if self._edges else drive_rules.NEVER_NS

    def _set_wrench(self) -> None:
        wrench = self._present.wrench
        truth = self._known_truth() if self._present.masses else None
        if truth is not None:
            wrench = wrench + weight(self._present.masses, truth, self._faults.gravity)
        self._record["wrench"] = wrench

    def _known_truth(self) -> Truth | None:
        k = int(self._record["k"])
        if self._truth_k != k:
            self._truth = self._plant.truth()
            self._truth_k = k
        return self._truth

    # drives

    def _apply_faults(self, t: int) -> None:
        present, n = self._present, self._record
        self._note_edge()
        self.bus_off = present.bus_off
        if present.crashes:
            raise PlantError("the plant crashed: fault plant_crash")
        n["silent"] = sum(1 << leg for leg, silent in enumerate(present.silent) if silent)
        n["not_finite"] = present.not_finite
        before = record.LOOKS_BEFORE * bool(present.masses or present.drifts)
        after = record.LOOKS_AFTER * bool(present.noise or any(present.late_ns))
        n["look"] = before | after | record.FORGES * any(by_m is not None for by_m in present.forged_m)
        self._drives.disturb(present, t)
        if not any(present.late_ns):  # the stored readings are not needed any more
            self._spoiled = Reading()
        self._switch_on(present.reset)
        self._end.restart([k for k in n["number"][np.array(present.reset)].tolist() if k != record.MUTE])
        self._set_wrench()
        drive_rules.actuate(self._drives.seen, False, t)

    def _switch_on(self, which: Sequence[bool]) -> None:
        """Subtract the motor turns that encoders lose when their drives are switched on."""
        n, homing, transmission = self._record, self._settings.homing, self._transmission
        if homing is not None and transmission is not None and any(which):
            n["uncounted"] = np.where(which, forgotten_m(homing, transmission, n["length"]), n["uncounted"])
