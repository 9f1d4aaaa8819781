"""Six emulated drives: their record, and faults of drives and encoders. `Nodes` owns them."""

import ctypes
from collections import deque
from functools import cache
from math import exp, inf, nan, pi
from typing import Any, NamedTuple, cast

import numpy as np

from drivers.arrays import Array, Ints
from drivers.compiled.compiler import INTEGER
from drivers.compiled.pointed import FAILED, data_at, of_python
from drivers.config import DriveSettings, HomingSettings
from drivers.frame_array import FRAME
from drivers.signals import INVALID, LEGS, DriveFault, Reaction
from drivers.tick_columns import Record
from drivers.transmission import Transmission
from plant_fmu.config import DriveEmulation
from plant_fmu.drives.codec import MESSAGE, READING, DrivesEnd
from plant_fmu.drives.compiled_pass import due_ns
from plant_fmu.drives.drive_rules import BOOT, BRAKE, NEVER_NS, WORKS, encoder, enter
from plant_fmu.drives.record import NODES, ROOM
from plant_fmu.faults.fault import Present
from plant_fmu.plant import MEASURED, Moved, Plant, Truth

_NO_COUNTER = -1


def at_motor(settings: DriveSettings, transmission: Transmission | None) -> DriveSettings:
    """Drive settings with force_limit_N at the motor: the rated leg force before transmission losses."""
    if transmission is None:
        return settings
    rated_N = settings.force_limit_N / float(transmission.driving.min())
    return settings.model_copy(update={"force_limit_N": rated_N})


class Drives:
    """Six emulated drives, initially just powered up.

    Mutable state: the record, see `record.NODES`; the frames to send; the reading of the current answer; the
    leg lengths at which faults of encoder scale began.
    """

    def __init__(self, settings: DriveSettings, emulation: DriveEmulation, step_s: float) -> None:
        """Power up. step_s: internal step of the plant, s, for which the force lag is discretised exactly."""
        self.record: Record = np.zeros((), NODES)
        self.seen = cast("Any", self.record.view(np.recarray))
        """View of the record for the functions of `kernels` in plain Python: each field is an attribute."""
        self._origins: dict[tuple[int, int], float] = {}
        """Leg lengths, m, by leg and start of the fault, ns."""
        n = self.seen
        n.state, n.reaction, n.acting = BOOT, Reaction.BRAKE, BRAKE
        n.counter, n.stuck, n.frozen, n.most = _NO_COUNTER, WORKS, nan, inf
        n.watchdog_ns = round(settings.watchdog_ms * 1e6)
        n.deadline_ns = n.moved_ns = n.followed_ns = NEVER_NS
        n.number, n.forged = range(LEGS), nan
        n.shut = n.truly_shut = n.share = n.gain = n.scale = n.waits = 1.0
        n.limit_N = settings.force_limit_N
        n.damping, n.stiffness = emulation.damping_N_s_m, emulation.hold_stiffness_N_m
        n.opening_ns, n.closing_ns = 1e6 * emulation.brake_open_ms, 1e6 * emulation.brake_close_ms
        n.brake_after_ns = round(settings.brake_after_ms * 1e6)
        # First-order lag over one step: end value and mean, both 1 without a lag.
        x = 2.0 * pi * emulation.force_bandwidth_Hz * step_s
        n.lags, n.lag_end = x > 0.0, exp(-x)
        n.lag_mean = (1.0 - exp(-x)) / x if x > 0.0 else exp(-x)

    def connect(self, end: DrivesEnd, plant: Moved, heartbeat_ns: float, reading_ns: float) -> None:
        """Start the drives with their codec (protocol's end) and the plant's functions.

        heartbeat_ns, reading_ns: periods of each drive's status and of its unrequested reading; 0: never.
        """
        self._keeps = end, plant
        n = self.record
        self.address = data_at(n)
        self.out = np.zeros(ROOM, FRAME)
        """Frames to send: the first `sent` elements."""
        self._asked, self._senders = np.zeros((), MESSAGE), np.zeros(ROOM, np.int64)
        self.reading = np.zeros((), READING)
        n["move"], n["plant"] = plant.move, plant.context
        n["parse"], n["answer"] = end.parse.address, end.answer.address
        n["report"], n["end"] = end.report.address, data_at(end.record)
        n["messages"], n["asked"] = data_at(end.messages), data_at(self._asked)
        n["reading"], n["senders"] = data_at(self.reading), data_at(self._senders)
        n["out"], n["room"] = data_at(self.out), ROOM
        t0_ns = int(n["t0_ns"])
        n["beat_share"], n["reading_share"] = heartbeat_ns / LEGS, reading_ns / LEGS
        n["beat_ns"] = due_ns(t0_ns, 0, heartbeat_ns / LEGS)
        n["reading_ns"] = due_ns(t0_ns, 1, reading_ns / LEGS)

    def reserve(self, room: int) -> None:
        """Enlarge the array of frames to send to `room` elements; its frames are kept."""
        out = np.zeros(room, FRAME)
        sent = int(self.record["sent"])
        out[:sent] = self.out[:sent]
        self.out = out
        self.record["out"], self.record["room"] = data_at(out), room

    def disturb(self, present: Present, t_ns: int) -> None:
        """Apply the faults present at `t_ns`, when the plant has reached it.

        A frozen encoder keeps its current reading; a scale error counts from the current length. Those of one
        leg multiply, in the order in which they began.
        """
        n = self.seen
        self.drift(present, t_ns)
        scale, shift = np.ones(LEGS), np.zeros(LEGS)
        for leg, factor, own in sorted(present.scales, key=lambda each: each[2].start_ns):
            origin = self._origins.setdefault((leg, own.start_ns), float(n.length[leg]))
            shift[leg] += scale[leg] * (1.0 - factor) * origin
            scale[leg] *= factor
        n.scale, n.shift = scale, shift
        n.lost = 0  # one without signal freezes at its present value
        reads = [encoder(n, leg)[0] for leg in range(LEGS)]
        n.lost = [INVALID if lost else 0 for lost in present.lost]
        n.frozen = np.where(present.frozen, np.where(np.isnan(n.frozen), reads, n.frozen), nan)
        n.gain, n.most = present.gain, present.saturation_N
        n.stuck = [WORKS if stuck is None else stuck for stuck in present.stuck]
        n.forged = [nan if by_m is None else by_m for by_m in present.forged_m]
        n.slow_ns, n.share = present.slow_ns, present.share
        for leg in np.flatnonzero(present.reset).tolist():
            enter(n, leg, BOOT, int(DriveFault.NONE))
            n.configured[leg], n.counter[leg] = False, _NO_COUNTER

    def drift(self, present: Present, t_ns: int) -> None:
        """Set the offsets and drifts of encoders, m, to their values at `t_ns`."""
        n = self.seen
        n.offset, n.drift = present.offset_m, 0.0
        for leg, by_m_s, own in present.drifts:
            n.offset[leg] += by_m_s * (t_ns - own.start_ns) * 1e-9
            n.drift[leg] += by_m_s


def forgotten_m(settings: HomingSettings, transmission: Transmission, length: Array) -> Array:
    """Length (6,) m that each encoder loses count of at power-up, at leg lengths (6,) m.

    After power-up each encoder starts within half of `forgotten_turns` motor turns of zero.
    """
    whole = np.round(transmission.turns(length) / settings.forgotten_turns) * settings.forgotten_turns
    return transmission.m_per_turn * whole


class Reading:
    """Adds delay and noise to the readings of six encoders, before the feedback.

    Mutable state: the readings since the first encoder delay began.
    """

    def __init__(self) -> None:
        self._read: deque[tuple[int, Array, Array]] = deque()

    def spoil(self, present: Present, t_ns: int, length: Array, rate: Array) -> None:
        """Add delay and noise to lengths (6,) m and rates (6,) m/s that were read at `t_ns`. Changes both."""
        longest = max(present.late_ns)
        if longest:
            self._read.append((t_ns, length.copy(), rate.copy()))
            while len(self._read) > 1 and self._read[1][0] <= t_ns - longest:
                self._read.popleft()
            for leg, late_ns in enumerate(present.late_ns):
                if late_ns:  # extrapolated from the reading before
                    before = [read for read in self._read if read[0] <= t_ns - late_ns]
                    at_ns, l, dl = before[-1] if before else self._read[0]
                    dt = max(0, t_ns - late_ns - at_ns) * 1e-9
                    length[leg], rate[leg] = l[leg] + dl[leg] * dt, dl[leg]
        for leg, sigma_m, own in present.noise:
            length[leg] += sigma_m * own.generator.standard_normal()


class Snapshot(NamedTuple):
    """State of plant and drives at one instant, for the plant's log."""

    t_ns: int
    """Time of length and rate, ns: a time step of the plant."""
    length: Array
    """True leg lengths (6,) m."""
    rate: Array
    """True leg rates (6,) m/s."""
    command: Array
    """Forces (6,) N of the last valid command, > 0 extends."""
    force: Array
    """(6,) N, force of the drives on the plant."""
    applied: Array
    """(6,) N, force that the plant reports as applied; `force` if it reports none."""
    state: Ints
    """DriveState of each drive, (6,)."""
    fault: Ints
    """DriveFault of each drive, (6,)."""
    brake: Array
    """Brakes (6,): 1 engaged, 0 released."""
    wrench: Array
    """Wrench (6,) N, N m on the platform at its origin, base frame."""
    truth: Truth | None
    syncs: int
    """SYNC frames or polls received since the start."""
    commands: int
    """Valid command frames with a new counter."""
    repeated: int
    """Valid command frames with a counter that was received before: they have no effect."""
    rejected: int
    """Frames that were invalid, or belonged to another SYNC than the present one."""


def moved(plant: Plant) -> Moved:
    """Address of a plant's function: a compiled one, or a wrapper of its Python methods."""
    compiled = getattr(plant, "moved", None)
    return _python_function(plant) if compiled is None else compiled()


@cache
def _reals(address: int, count: int) -> Array:
    memory: Any = (ctypes.c_double * count).from_address(address)
    return np.frombuffer(memory, np.float64)


def _python_function(plant: Plant) -> Moved:
    errors: list[BaseException] = []

    def move(_context: int, force: int, brake: int, wrench: int, steps: int, measured: int) -> int:
        try:
            given = [_reals(at, LEGS).copy() for at in (force, brake, wrench)]
            found = plant.step(given[0], given[1], given[2], steps * plant.internal_step_s)
            truth = plant.truth()
            into = _reals(measured, MEASURED).reshape(3, LEGS)
            into[0], into[1], into[2] = *found, nan if truth is None else truth.applied_force
        except BaseException as error:  # noqa: BLE001 - it is raised again behind the pass
            errors.append(error)
            return FAILED
        return 0

    address, keeps = of_python(move, *[INTEGER] * 6)
    return Moved(address, 0, lambda *_: errors.pop(), keeps)
