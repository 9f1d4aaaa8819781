"""Six emulated drives in front of a plant: encoder, limits, watchdog, heartbeat, brake.

Time. The plant moves on a grid of its internal step h from `start`. A command, a fault or a
watchdog acts at the grid point nearest to its instant, at most h/2 away. An encoder is latched
between grid points by length + rate dt, |dt| <= h/2: with leg acceleration a it is wrong by at most
a h^2/8 in length and a h/2 in rate (10 m/s^2 and 100 us: 13 nm and 0.5 mm/s). An instant on the grid
is exact. `Plant.step` is called once between two instants that matter, and once per grid
point while a drive controls by itself (damp, hold) or lags.
"""

from collections.abc import Sequence
from contextlib import suppress
from functools import lru_cache
from math import floor
from operator import itemgetter

import numpy as np

from drivers.arrays import Array, Ints
from drivers.config import DriveSettings
from drivers.errors import PlantError, ProtocolError
from drivers.protocol import (
    Alive,
    Answer,
    Configure,
    DeviceCommand,
    DriveProtocol,
    EmergencyStop,
    Frame,
    Received,
    Rejected,
    Status,
    Sync,
    UnwatchedCommand,
)
from drivers.signals import LEGS, DriveFault, Reaction
from drivers.transmission import Transmission
from plant_fmu.config import DriveEmulation
from plant_fmu.drives.drive import Drives, at_motor
from plant_fmu.drives.kernels import BOOT, BRAKE, DAMP, FAULT, HOLD, NEVER_NS, OFF, READY, RUN
from plant_fmu.drives.reading import Reading
from plant_fmu.drives.snapshot import Snapshot
from plant_fmu.drives.timer import Timer
from plant_fmu.drives.turns import Turns
from plant_fmu.faults.fault import Fault
from plant_fmu.faults.gateway import Gateway
from plant_fmu.faults.plan import FaultPlan, Schedule, weight
from plant_fmu.plant import Plant, Truth

_TIME = itemgetter(0)


@lru_cache(maxsize=64)
def _indices(legs: tuple[int, ...]) -> Ints:
    return np.array(legs, np.int64)


class Nodes:
    """Six drives and the plant behind them.

    A drive boots with its brake engaged, CONFIG takes it to OFF, then `TRANSITIONS` hold. RUN is
    reached through READY only. CONFIG counts in BOOT, OFF and FAULT, and is answered by a status that says
    what holds. The watchdog runs in READY and RUN, from the last valid command with a new counter. A fault
    latches until RESET; its reaction is the configured one if it strikes in RUN, otherwise the brake, so that
    no fault opens a brake. Damping and holding end in the brake. A brake takes its time to open and to close,
    and a drive keeps its last force until its own has closed. An emergency stop brakes and is reported,
    whatever was latched before.

    Mutable state: the plant, six drives, the protocol's memory at their end, the time, the schedule of the
    faults and what they remember. Owner of all of it; `start` resets it.
    """

    def __init__(
        self,
        plant: Plant,
        protocol: DriveProtocol,
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
        self._brake_after_ns = round(drives.brake_after_ms * 1e6)
        self.start(0)

    def start(self, t0_ns: int) -> None:
        """Power up at `t0_ns`: plant at its initial state, drives in BOOT, brakes engaged."""
        self._t0_ns = self._now_ns = t0_ns
        self._k = 0
        self._length, self._rate = self._plant.reset()
        gear = self._settings.transmission
        self._transmission = None if gear is None else Transmission.of(gear)
        self._drives = Drives(at_motor(self._settings, self._transmission), self._emulation, self._h_s)
        self._turns = Turns(self._settings.homing, self._transmission, self._length)
        self._memory = self._protocol.power_up()
        self._heartbeats = Timer(1e6 * self._settings.heartbeat_ms, t0_ns)
        self.readings = Timer(1e9 * self._protocol.unasked_s, t0_ns, 1)
        self._calm_ns = t0_ns
        """No watchdog, brake, edge or heartbeat is due before this instant."""
        self._schedule = Schedule(self._faults, t0_ns)
        gateway = Gateway(self._schedule, self._protocol, t0_ns)
        self._gateway = gateway if self._faults.touches_frames else None
        self._reading = Reading()
        self._missed: list[Received] = []
        self._edges, self._present = self._schedule.edges_ns(t0_ns + 1), self._schedule.present(t0_ns)
        self._truth: Truth | None = None
        self._truth_k = -1
        self.syncs = 0
        """SYNC frames or polls heard since the start."""
        self._commands = self._repeated = self._rejected = 0
        self._disturb(t0_ns)

    def step(self, t_ns: int, received: Sequence[Received]) -> list[tuple[int, Frame]]:
        """Live until `t_ns`, hearing `received`, and return (instant queued, frame) in time order.

        `received` holds what arrived since the last step, times up to `t_ns`; a frame older than the
        last step's end counts as arriving then. Feedback is queued at the instant its SYNC arrives,
        status every heartbeat, one drive after the other, and where drives do so when state or fault change.
        A watchdog that ends at `t_ns` exactly waits for the next step: a command of that instant is in time.
        Frames that faults delay or add may be for an instant to come. Raises PlantError if `t_ns` lies before
        the last step's or the plant fails.
        """
        if t_ns < self._now_ns:
            raise PlantError(f"nodes: time runs backwards, {t_ns} ns after {self._now_ns} ns")
        out: list[tuple[int, Frame]] = []
        if self._present.hangs:
            self._missed += received
            if not self._schedule.present(t_ns).hangs:
                received, self._missed = self._missed, []
            else:
                return out
        if self._gateway is not None:
            received = self._gateway.hear(received, t_ns)
        frames = received if len(received) < 2 else sorted(received, key=_TIME)
        for t_frame_ns, frame in frames:
            t = min(max(t_frame_ns, self._now_ns), t_ns)
            self._pass_time(t, out)
            self._receive(t, frame, out)
        self._pass_time(t_ns, out)
        self._advance(t_ns)
        return out if self._gateway is None else self._gateway.send(out)

    def reached(self, mode: str) -> None:
        """Let the time of the faults count that wait for a mode of the controller: it has been reached."""
        if self._schedule.reached(mode, self._now_ns):
            self._edges = self._schedule.edges_ns(self._now_ns)
            self._calm_ns = self._now_ns

    @property
    def bus_off(self) -> int:
        """Bit i: a fault has cut bus i."""
        return self._present.bus_off

    @property
    def now_ns(self) -> int:
        """The end of the last step; of one that failed, how far it came."""
        return self._now_ns

    def starts_ns(self, fault: Fault) -> int:
        """Return when a fault begins; `NEVER_NS` where it will not, as things stand."""
        return self._schedule.starts_ns(fault)

    @property
    def waiting(self) -> tuple[Fault, ...]:
        """Faults whose mode the controller has not reached."""
        return self._schedule.waiting

    @property
    def begun(self) -> tuple[Fault, ...]:
        """Faults that have begun."""
        return self._schedule.begun(self._now_ns)

    def snapshot(self) -> Snapshot:
        """Return the plant's end as it is now; arrays are copies. A plant that has failed tells no truth."""
        truth = None
        with suppress(PlantError):  # the next step says so
            truth = self._know()
        return Snapshot(
            t_ns=self._grid_ns(),
            length=np.array(self._length),
            rate=np.array(self._rate),
            command=self._drives.command.copy(),
            force=self._drives.force.copy(),
            applied=self._drives.force.copy() if truth is None else truth.applied_force,
            state=self._drives.state.copy(),
            fault=self._drives.fault.copy(),
            brake=self._drives.brake.copy(),
            wrench=self._wrench.copy(),
            truth=truth,
            syncs=self.syncs,
            commands=self._commands,
            repeated=self._repeated,
            rejected=self._rejected,
        )

    # time

    def _grid_ns(self) -> int:
        return self._t0_ns + round(self._k * self._h_ns)

    def _pass_time(self, t: int, out: list[tuple[int, Frame]]) -> None:
        """Let watchdogs (before t), brakes, plan edges and heartbeats (up to t) happen, in order."""
        while t >= self._calm_ns:
            deadlines = self._drives.deadline_ns.tolist()
            watchdog = min(deadlines)
            edge = self._edges[0] if self._edges else NEVER_NS
            moved = self._drives.next_move_ns()
            other = min(edge, beat := self._heartbeats.next_ns, self.readings.next_ns, moved)
            if watchdog < t and watchdog <= other:
                self._now_ns = max(self._now_ns, watchdog)
                for leg in range(LEGS):
                    if deadlines[leg] <= watchdog:
                        self._fail(leg, DriveFault.WATCHDOG, watchdog, out)
            elif other > t:
                self._calm_ns = min(max(watchdog, t + 1), other)
            elif moved == other:
                self._advance(moved)
                self._actuate(moved)
            elif edge == other:
                del self._edges[0]
                self._advance(edge)
                self._now_ns = max(self._now_ns, edge)
                self._present = self._schedule.present(edge)
                self._disturb(edge)
            elif beat == other:
                self._send_status(self._heartbeats.speak(), beat, out, due=True)
            else:
                self._latch(Sync(0, (self.readings.speak(),)), other, out)
        self._now_ns = t

    def _advance(self, t: int) -> None:
        """Bring the plant to the grid point nearest to t."""
        n = floor((t - self._t0_ns) / self._h_ns + 0.5) - self._k
        if n <= 0:
            return
        if self._drives.lags or self._controls:
            for _ in range(n):
                self._actuate(self._grid_ns(), lag=self._drives.lags)
                self._move(1)
        else:
            self._move(n)

    def _move(self, n: int) -> None:
        force, brake = self._at_leg(self._drives.force), self._drives.brake
        self._length, self._rate = self._plant.step(force, brake, self._wrench, n * self._h_s)
        if self._present.not_finite:
            self._length = np.full(LEGS, np.nan)
        self._k += n

    def _at_leg(self, force: Array) -> Array:
        """Return what the losses between motors and legs leave of forces (6,) N."""
        return force if self._transmission is None else self._transmission.delivered(force, self._rate)

    def _weigh(self) -> None:
        """Set the wrench on the platform; a mass weighs where it is by now."""
        self._wrench = self._present.wrench
        truth = self._know() if self._present.masses else None
        if truth is not None:
            self._wrench = self._wrench + weight(self._present.masses, truth, self._faults.gravity)

    def _know(self) -> Truth | None:
        """Return the plant's truth, asked for once per instant."""
        if self._truth_k != self._k:
            self._truth = self._plant.truth()
            self._truth_k = self._k
        return self._truth

    # drives

    def _disturb(self, t: int) -> None:
        if self._present.crashes:
            raise PlantError("the plant crashed: fault plant_crash")
        self._drives.disturb(self._present, self._length, self._rate, t)
        self._reading.begin(self._present)
        self._turns.switch_on(self._present.reset, self._length)
        self._memory = self._protocol.restarted(self._memory, np.flatnonzero(self._present.reset).tolist())
        self._weigh()
        self._actuate(t)

    def _actuate(self, t: int, *, lag: bool = False) -> None:
        """Set force and brake of the plant from the drives' states; with `lag` over the next grid step."""
        self._controls = self._drives.actuate(self._length, self._rate, lag, t)

    def _fail(self, leg: int, fault: DriveFault, t: int, out: list[tuple[int, Frame]]) -> None:
        """Latch a fault; the first one stays, but for an emergency stop."""
        drives = self._drives
        self._advance(t)
        brakes = fault is DriveFault.ESTOP or drives.state[leg] != RUN or self._present.lost[leg]
        if drives.state[leg] != FAULT:
            drives.acting[leg] = BRAKE if brakes else drives.reaction[leg]
            drives.held_m[leg] = drives.encoders(self._length, self._rate)[0][leg]
            drives.enter(leg, FAULT, fault)
            if drives.acting[leg] in (DAMP, HOLD):
                drives.deadline_ns[leg] = t + self._brake_after_ns
            self._send_status(leg, t, out)
        elif brakes:
            drives.acting[leg] = BRAKE
            drives.deadline_ns[leg] = NEVER_NS
            if fault is DriveFault.ESTOP and drives.fault[leg] != fault:
                drives.fault[leg] = fault
                self._send_status(leg, t, out)
        self._actuate(t)
        self._calm_ns = min(self._calm_ns, drives.next_move_ns())

    # frames

    def _receive(self, t: int, frame: Frame, out: list[tuple[int, Frame]]) -> None:
        self._memory, messages = self._protocol.parse(self._memory, frame)
        for message in messages:
            match message:
                case Sync():
                    self.syncs += 1
                    self._latch(message, t, out)
                case DeviceCommand():
                    self._obey(message, t, out)
                case Alive(legs=legs):
                    self._drives.heard(_indices(legs), t)
                case Configure():
                    self._configure(message, t, out)
                case EmergencyStop(legs=legs):
                    for leg in legs:
                        self._fail(leg, DriveFault.ESTOP, t, out)
                case Answer():
                    self._send(message.leg, t, (message.frame,), out)
                case Rejected():
                    self._rejected += 1

    def _latch(self, sync: Sync, t: int, out: list[tuple[int, Frame]]) -> None:
        self._advance(t)
        dt = (t - self._grid_ns()) * 1e-9
        present = self._present
        if present.masses:
            self._weigh()
        if present.drifts:
            self._drives.drift(present, t)
        force = self._plant.applied_force()
        if force is None:
            force = self._at_leg(self._drives.force)
        quantum, fault = self._emulation.encoder_resolution_m, self._drives.fault
        length, rate, state = self._drives.encoders(self._length, self._rate, dt, quantum)
        if present.noise or any(present.late_ns):
            self._reading.spoil(present, t, length, rate)
        length, read = self._turns.counted(length), (rate, force, state, fault)
        try:
            self._memory, frames = self._protocol.answer(self._memory, sync, length, *read)
        except ProtocolError as error:
            raise PlantError(f"the plant gave what is no measurement: {error}") from error
        out += [(t, frame) for leg, frame in frames if not present.silent[leg]]
        for leg, by_m in enumerate(present.forged_m):
            if by_m is not None:
                _, other = self._protocol.answer(self._memory, sync, length + by_m, *read)
                out += [(t, frame) for k, frame in other if k == leg]

    def _obey(self, command: DeviceCommand, t: int, out: list[tuple[int, Frame]]) -> None:
        self._advance(t)
        legs, mode, force, counter = command
        obey = self._drives.obey_unwatched if isinstance(command, UnwatchedCommand) else self._drives.obey
        length, rate = self._length, self._rate
        fresh, controls, entered, earliest = obey(length, rate, _indices(legs), force, mode, counter, t)
        if entered:
            for leg in legs:
                if entered >> leg & 1:
                    self._send_status(leg, t, out)
        if fresh:
            self._calm_ns = min(self._calm_ns, earliest)
            self._commands += 1
            self._controls = controls
        else:
            self._repeated += 1

    def _configure(self, configure: Configure, t: int, out: list[tuple[int, Frame]]) -> None:
        drives, leg = self._drives, configure.leg
        if drives.state[leg] in (READY, RUN):
            self._rejected += 1
            return
        drives.watchdog_ns[leg] = round(configure.watchdog_s * 1e9)
        drives.reaction[leg] = configure.reaction
        drives.configured[leg] = True
        if drives.state[leg] == BOOT:
            drives.enter(leg, OFF, DriveFault.NONE)
        self._send_status(leg, t, out)

    def _send_status(self, leg: int, t: int, out: list[tuple[int, Frame]], *, due: bool = False) -> None:
        drives = self._drives
        set_up = Configure(leg, int(drives.watchdog_ns[leg]) * 1e-9, Reaction(int(drives.reaction[leg])))
        holds = set_up if drives.configured[leg] else None
        status = Status(leg, int(drives.state[leg]), int(drives.fault[leg]), holds, due)
        self._memory, frames = self._protocol.report(self._memory, status)
        self._send(leg, t, frames, out)

    def _send(self, leg: int, t: int, frames: Sequence[Frame], out: list[tuple[int, Frame]]) -> None:
        """Queue frames of one drive, as far as it is not silent."""
        if not self._present.silent[leg]:
            out += [(t, frame) for frame in frames]
