"""Emulated tracker, IMU and wrench sensor in addition to the drives: they sample the plant's true state.

A sample is taken at its own instant, stamped relative to the last SYNC before it, and enters the bus after
its latency. Between time steps of the plant the pose is extrapolated with the twist. The specific force is
the mean over the plant's last internal step, as of a device that integrates.
"""

from collections.abc import Sequence

import numpy as np

from drivers.arrays import Rows
from drivers.compiled.pointed import FAILED, data_at
from drivers.config import DriveSettings
from drivers.errors import PlantError, ProtocolError
from drivers.family import Family
from drivers.frame_array import FRAME, sent_frames, timed_array
from drivers.sensor_kernels import IMU, TRACKER
from drivers.sensors import KINDS, SensorProtocol
from drivers.tick_columns import Record
from plant_fmu.config import DriveEmulation, SensorEmulation
from plant_fmu.drives.drive_rules import NEVER_NS
from plant_fmu.drives.nodes import Nodes
from plant_fmu.drives.sensor_kernels import SENSED, SILENT, listen, measure
from plant_fmu.faults.plan import FaultPlan
from plant_fmu.plant import Plant, Truth


class SensedNodes(Nodes):
    """Six drives, the plant behind them, and the configured sensors on its platform.

    Mutable state, in addition to that of `Nodes`: next sample time and counter of each sensor, a record of
    SENSED, frames that wait for their latency, the generator of random numbers. `start` resets all of it.
    """

    def __init__(
        self,
        plant: Plant,
        protocol: Family,
        emulation: DriveEmulation,
        drives: DriveSettings,
        faults: FaultPlan | None,
        sensors: SensorProtocol,
        noise: SensorEmulation,
        gravity: Sequence[float],
    ) -> None:
        self._sensors, self._noise, self._gravity = sensors, noise, gravity
        self._period_ns = {KINDS.index(kind): 1e9 / rate for kind, rate in sensors.rates_Hz.items()}
        super().__init__(plant, protocol, emulation, drives, faults)

    def start(self, t0_ns: int) -> None:
        """Power up as `Nodes.start`; every sensor takes its first sample at `t0_ns`."""
        super().start(t0_ns)
        self._start_ns = self._sense_ns = t0_ns
        self._count, self._due_ns = dict.fromkeys(self._period_ns, 0), dict.fromkeys(self._period_ns, t0_ns)
        self._note_ns = NEVER_NS
        """When to store the velocity: one step of the plant before the IMU measures."""
        self._sensed: Record = np.zeros((), SENSED)
        n, drives = self._sensed, self._record
        tracker, imu, wrench = each = self._noise.tracker, self._noise.imu, self._noise.wrench
        n["sensors"], n["wrench"] = data_at(self._sensors.tables), data_at(drives["wrench"])
        n["sync_id"] = self._sensors.sync_id
        n["before_ns"], n["heard_ns"], n["gravity"] = t0_ns, -NEVER_NS, self._gravity
        n["start_ns"], n["drift"] = t0_ns, tracker.position_drift_m_s
        n["stamped_s"][TRACKER] = tracker.stamp_error_ms * 1e-3
        n["late_ns"] = [round(sensor.latency_ms * 1e6) for sensor in each]
        first, second = n["bias"][:, :3], n["bias"][:, 3:]
        first[:] = tracker.position_bias_m, imu.angular_rate_bias_rad_s, wrench.force_bias_N
        second[:] = tracker.rotation_bias_deg, imu.specific_force_bias_m_s2, wrench.moment_bias_N_m
        first, second = n["noise"][:, :3].T, n["noise"][:, 3:].T
        first[:] = tracker.position_noise_m, imu.angular_rate_noise_rad_s, wrench.force_noise_N
        second[:] = tracker.orientation_noise_deg, imu.specific_force_noise_m_s2, wrench.moment_noise_N_m
        self._waiting: list[tuple[int, Rows]] = []
        """Frames to send, each with the instant at which it enters the bus."""
        self._send_ns = NEVER_NS
        self._chance = np.random.default_rng((self._noise.seed, self._faults.seed))

    @property
    def address(self) -> int:
        """Always 0, so that only `advance` is used: it adds the sensors' frames."""
        return 0

    def advance(self, t_ns: int, received: Rows) -> Rows:
        """Advance as `Nodes.advance`; the sensors' frames are merged into those of the drives.

        The drives advance from sample to sample, as faults change the true state between samples.
        """
        out: list[Rows] = []
        frames = received[np.argsort(received["t_ns"], kind="stable")]
        ends = False
        while not ends:
            ends = self._sense_ns > t_ns
            at_ns = t_ns if ends else self._sense_ns
            early = frames["t_ns"] <= at_ns
            heard, frames = frames[early], frames[~early]
            for k in range(len(heard)):  # sensors receive them unchanged by faults
                listen(self._sensed, data_at(heard[k:]))
            out.append(super().advance(at_ns, heard).copy())
            if not ends:
                self._sense(at_ns)
        if t_ns < self._send_ns:
            return np.concatenate(out, dtype=FRAME)
        out += [frame for at_ns, frame in self._waiting if at_ns <= t_ns]
        self._waiting = [entry for entry in self._waiting if entry[0] > t_ns]
        self._send_ns = min((at_ns for at_ns, _ in self._waiting), default=NEVER_NS)
        both = np.concatenate(out, dtype=FRAME)
        return both[np.argsort(both["t_ns"], kind="stable")]

    def _sense(self, t_ns: int) -> None:
        truth, grid_ns = self._known_truth(), self._grid_ns()
        if truth is None:
            raise PlantError(
                "sensors: the plant reports no platform pose for them to measure; remove sensors"
            )
        for kind, due_ns in self._due_ns.items():
            if due_ns == t_ns:
                self._sample(kind, t_ns, truth, grid_ns)
                self._count[kind] += 1
                self._due_ns[kind] = self._start_ns + round(self._count[kind] * self._period_ns[kind])
                if kind == IMU:
                    self._note_ns = max(self._due_ns[kind] - round(self._h_ns), t_ns)
        if self._note_ns <= t_ns:
            self._sensed["before_ns"], self._sensed["before"] = grid_ns, truth.twist[:3]
            self._note_ns = NEVER_NS
        self._sense_ns = min(self._note_ns, *self._due_ns.values())

    def _sample(self, kind: int, t_ns: int, truth: Truth, grid_ns: int) -> None:
        n, frame = self._sensed, np.zeros(1, FRAME)
        self._chance.standard_normal(out=n["drawn"])
        status = measure(n, kind, self._count[kind], t_ns, grid_ns, *truth[:3], frame.reshape(()))
        lost = self._chance.random() < 0.01 * getattr(self._noise, KINDS[kind]).lost_percent
        if lost or self._present.hangs or status == SILENT:
            return
        if status == FAILED:
            raise ProtocolError(f"sample of {KINDS[kind]} is not a number: {n['values'].tolist()}")
        sent = [(int(frame["t_ns"][0]), frame)]
        if self._gateway is not None:
            carried = self.schedule.carry(sent[0][0], sent_frames(frame)[0], to_drives=False)
            sent = [(at_ns, timed_array([(at_ns, arriving)])) for at_ns, arriving, _ in carried]
        self._waiting += sent
        self._send_ns = min((at_ns for at_ns, _ in self._waiting), default=NEVER_NS)
