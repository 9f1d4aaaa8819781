"""Emulated tracker, IMU and wrench sensor beside the drives: they sample the plant's truth.

A sample is taken at its own instant, stamped against the last SYNC before it, and enters the bus its
latency later. Between grid points of the plant the pose is carried on by the twist. The specific force is
the mean over the plant's last internal step, as of a device that integrates.
"""

from collections.abc import Callable, Sequence

import numpy as np

from drivers.arrays import Array, Rows
from drivers.config import DriveSettings, SensorSettings
from drivers.errors import PlantError
from drivers.frame_array import FRAME, received_frames, timed_array
from drivers.protocol import DriveProtocol, Frame
from drivers.sensors import SensorProtocol
from plant_fmu.config import DriveEmulation, SensorEmulation
from plant_fmu.drives.kernels import NEVER_NS
from plant_fmu.drives.nodes import Nodes
from plant_fmu.drives.sensor_kernels import carried, seen_turned
from plant_fmu.faults.plan import FaultPlan
from plant_fmu.plant import Plant, Truth

_LONGEST_STAMP_S = 0.0655
"""A sensor that has heard no SYNC for so long cannot say when it measures, and is silent."""


class SensedNodes(Nodes):
    """Six drives, the plant behind them, and the configured sensors on its platform.

    Mutable state, beside that of `Nodes`: when each sensor measures next and its counter, the last SYNC, the
    last acceleration and the twist before it, frames that wait out their latency, the generator. `start`
    resets all of it.
    """

    def __init__(
        self,
        plant: Plant,
        protocol: DriveProtocol,
        emulation: DriveEmulation,
        drives: DriveSettings,
        faults: FaultPlan | None,
        sensors: SensorProtocol,
        settings: SensorSettings,
        noise: SensorEmulation,
        gravity: Sequence[float],
    ) -> None:
        self._sensors = sensors
        self._noise = noise
        self._gravity = np.array(gravity, float)
        self._period_ns = {kind: 1e9 / getattr(settings, kind).rate_Hz for kind in sensors.kinds}
        self._measure: dict[str, Callable[[Truth], Array]] = {
            "tracker": self._pose,
            "imu": self._inertial,
            "wrench": self._load,
        }
        super().__init__(plant, protocol, emulation, drives, faults)

    def start(self, t0_ns: int) -> None:
        """As `Nodes.start`; every sensor takes its first sample then."""
        super().start(t0_ns)
        self._start_ns = self._until_ns = t0_ns
        self._count = dict.fromkeys(self._sensors.kinds, 0)
        self._due_ns = dict.fromkeys(self._sensors.kinds, t0_ns)
        self._sync: dict[int, tuple[int, int]] = {}
        """By bus: when the last SYNC ended, and its Cycle."""
        self._dtwist = np.zeros(6)
        self._noted_ns = -1
        """When the IMU measures for which the twist is noted."""
        self._before: tuple[int, Array]
        """Grid instant and twist that are noted."""
        self._waiting: list[tuple[int, Frame]] = []
        self._chance = np.random.default_rng((self._noise.seed, self._faults.seed))

    def advance(self, t_ns: int, received: Rows) -> Rows:
        """As `Nodes.advance`, with the frames of the sensors among the drives'."""
        out: list[Rows] = []
        frames = received[np.argsort(received["t_ns"], kind="stable")]
        while (due_ns := min(self._due_ns.values())) <= t_ns:
            heard = frames[frames["t_ns"] <= due_ns]
            frames = frames[len(heard) :]
            due = [kind for kind, at in self._due_ns.items() if at == due_ns]
            out += self._live(due_ns, heard)
            if "imu" in due:
                self._accelerate()
            for kind in due:
                self._sample(kind, due_ns)
                self._count[kind] += 1
                self._due_ns[kind] = self._start_ns + round(self._count[kind] * self._period_ns[kind])
        out += self._live(t_ns, frames)
        sent = [entry for entry in self._waiting if entry[0] <= t_ns]
        if not sent:
            return np.concatenate(out, dtype=FRAME)
        self._waiting = [entry for entry in self._waiting if entry[0] > t_ns]
        both = np.concatenate([*out, timed_array(sent)], dtype=FRAME)
        return both[np.argsort(both["t_ns"], kind="stable")]

    def _live(self, t_ns: int, frames: Rows) -> list[Rows]:
        """Let plant and drives live until `t_ns`, and note the SYNCs they hear.

        On the way the twist is noted one step of the plant before the IMU measures, or as soon as may be.
        """
        t_ns = max(t_ns, self._until_ns)
        for at_ns, frame in received_frames(frames):
            cycle = self._sensors.cycle_of(frame)
            if cycle is not None:
                self._sync[frame.bus] = at_ns, cycle
        out: list[Rows] = []
        due_ns = self._due_ns.get("imu", NEVER_NS)
        before_ns = due_ns - round(self._plant.internal_step_s * 1e9)
        if self._noted_ns != due_ns and before_ns <= t_ns:
            before_ns = max(before_ns, self._until_ns)
            early = frames[frames["t_ns"] <= before_ns]
            frames = frames[len(early) :]
            out.append(super().advance(before_ns, early).copy())
            self._noted_ns, self._before = due_ns, (self._grid_ns(), self._true().twist)
        self._until_ns = t_ns
        return [*out, super().advance(t_ns, frames).copy()]

    def _accelerate(self) -> None:
        """Find the acceleration since the twist was noted."""
        before_ns, before = self._before
        moved_ns = self._grid_ns() - before_ns
        if moved_ns > 0:
            self._dtwist = (self._true().twist - before) / (moved_ns * 1e-9)

    def _sample(self, kind: str, t_ns: int) -> None:
        """Take one sample, and keep its frame until its latency is over."""
        settings = getattr(self._noise, kind)
        values = self._measure[kind](self._moment(t_ns))
        lost = self._chance.random() < 0.01 * settings.lost_percent
        sync = self._sync.get(self._sensors.bus_of(kind))
        if sync is None or lost or self._present.hangs:
            return
        offset_s = (t_ns - sync[0]) * 1e-9
        if offset_s > _LONGEST_STAMP_S:
            return
        frame = self._sensors.encode(kind, values.tolist(), sync[1], offset_s, self._count[kind])
        sent_ns = t_ns + round(settings.latency_ms * 1e6)
        carried = self._schedule.carry(sent_ns, frame, to_drives=False)
        self._waiting += [(at_ns, arriving) for at_ns, arriving, _ in carried]

    def _true(self) -> Truth:
        truth = self._know()
        if truth is None:
            raise PlantError("sensors: the plant does not know its pose, so nothing can measure it")
        return truth

    def _moment(self, t_ns: int) -> Truth:
        """Return the truth at `t_ns`, carried on from the plant's grid point by the twist."""
        truth = self._true()
        p, R = carried(truth.p, truth.R, truth.twist, (t_ns - self._grid_ns()) * 1e-9)
        return truth._replace(p=p, R=R)

    def _pose(self, truth: Truth) -> Array:
        noise, chance = self._noise.tracker, self._chance
        p = truth.p + noise.position_bias_m + noise.position_noise_m * chance.standard_normal(3)
        r = np.deg2rad(noise.rotation_bias_deg + noise.orientation_noise_deg * chance.standard_normal(3))
        return np.concatenate((p, seen_turned(r, truth.R)))

    def _inertial(self, truth: Truth) -> Array:
        s, f = self._noise.imu, self._dtwist[:3] - self._gravity
        return self._turned(
            truth,
            (truth.twist[3:], s.angular_rate_bias_rad_s, s.angular_rate_noise_rad_s),
            (f, s.specific_force_bias_m_s2, s.specific_force_noise_m_s2),
        )

    def _load(self, truth: Truth) -> Array:
        s, wrench = self._noise.wrench, self._record["wrench"]
        return self._turned(
            truth,
            (wrench[:3], s.force_bias_N, s.force_noise_N),
            (wrench[3:], s.moment_bias_N_m, s.moment_noise_N_m),
        )

    def _turned(self, truth: Truth, *vectors: tuple[Array, tuple[float, float, float], float]) -> Array:
        """Return (vector in the base frame, bias, noise) as they are measured in the platform frame."""
        normal = self._chance.standard_normal
        return np.concatenate([truth.R.T @ x + bias + noise * normal(3) for x, bias, noise in vectors])
