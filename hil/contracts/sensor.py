"""Contract of every sensor family: its messages, read by the controller's end and written by the emulated one.

A test class inherits `SensorContract` and sets the attributes. It proves that both ends agree, and that they
keep time; that the bytes are those of the device is shown by recorded frames alone.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import pytest

from drivers.arrays import Array, Rows
from drivers.compiled.pointed import Callee, data_at
from drivers.config import BusSettings, DriveSettings
from drivers.frame_array import FRAME, joined, received_array
from drivers.legs.protocol import LegsProtocol
from drivers.protocol import BUS, ERROR, EXTENDED, REMOTE, DriveSetup, Frame, Received
from drivers.sensing.layout import SYNCED, Reception, unheard
from drivers.sensing.settings import SensorSettings
from drivers.sensors import SensorProtocol
from drivers.signals import Reaction
from drivers.tick_columns import new_record
from hil.estimation.external_wrench import ExternalWrench, hear_sensors
from plant_fmu.config import DriveEmulation, SensorEmulation
from plant_fmu.drives.sensor_nodes import SensedNodes
from plant_fmu.plant import Plant, Truth

MS = 1_000_000
RATE_Hz = 1000.0
_SETUP = DriveSetup(0.05, Reaction.BRAKE, RATE_Hz)
_NO_WRENCH = ExternalWrench(None, None, 1.0 / RATE_Hz)


def hear_frames(heard: Reception, frames: Rows, number: int, t_ns: int) -> None:
    """Read the samples among the frames of a tick that begins, and latches, at `t_ns`."""
    tick, R, frames = new_record(), np.eye(3), np.ascontiguousarray(frames)
    tick["tick"], tick["t_ns"] = number, t_ns
    given = data_at(frames), len(frames), data_at(R), tick
    hear_sensors(_NO_WRENCH.look.context, heard.record, *given)


class Mover(Plant):
    """A platform that moves at a constant rate of all coordinates, with 10 N more on each leg."""

    internal_step_s = 1e-4

    def reset(self) -> tuple[Array, Array]:
        self.n = 0
        return np.ones(6), np.full(6, 0.2)

    def step(self, force: Array, brake: Array, wrench: Array, dt_s: float) -> tuple[Array, Array]:
        self.n += round(dt_s / self.internal_step_s)
        return np.full(6, 1.0 + 0.2 * self.t_s), np.full(6, 0.2)

    @property
    def t_s(self) -> float:
        return self.n * self.internal_step_s

    def truth(self) -> Truth:
        a = 0.5 * self.t_s
        R = np.array([[1.0, 0.0, 0.0], [0.0, np.cos(a), -np.sin(a)], [0.0, np.sin(a), np.cos(a)]])
        p = np.array([0.3 * self.t_s, 0.0, 1.0])
        return Truth(p, R, np.array([0.3, 0.0, 0.0, 0.5, 0.0, 0.0]), 10.0 * np.arange(1.0, 7.0))

    def close(self) -> None:
        pass


def expected(role: str, t_s: float) -> Array:
    """True values (6,) of a slot at an instant; for legs that of the first one."""
    a = 0.5 * t_s
    g = 9.81 * np.array([0.0, np.sin(a), np.cos(a)])
    found = {
        "tracker": [0.3 * t_s, 0.0, 1.0, a, 0.0, 0.0],
        "imu": [0.5, 0.0, 0.0, *g],
        "wrench": [0.0] * 6,
        "inclination": [a, 0.0],
        "lengths": [1.0 + 0.2 * t_s],
        "forces": [10.0],
    }[role]
    return np.array(found, float)


class SensorContract:
    """Contract suite: inherit it and set the attributes below."""

    ROLE: str
    """Key of section `sensors`."""
    SETTINGS: ClassVar[dict[str, Any]]
    """The role's settings: its device, with latency_ms 2 if that is a key of it."""
    RESOLUTION: float
    """Largest error of a value by the steps of its field."""
    FOLDER = Path()
    """Folder at which the paths of the device start."""
    BUS = BusSettings()
    """Section `bus`, with the channel of the sensor."""

    @pytest.fixture
    def protocol(self) -> SensorProtocol:
        sensors = SensorSettings.model_validate({self.ROLE: self.SETTINGS})
        return SensorProtocol(self.BUS, sensors, self.FOLDER)

    def carried(self, frames: Rows) -> Rows:
        """Frames of the emulated device as the controller's end of a link receives them, at the same times."""
        return frames

    def run(self, protocol: SensorProtocol, ticks: int = 300, *, starts: bool = True, **errors: Any) -> Any:
        """Samples (tick, instant s, values) of the first slot, frames by tick, and refused frames."""
        silent = {
            "tracker": {"position_noise_m": 0, "orientation_noise_deg": 0},
            "imu": {"angular_rate_noise_rad_s": 0, "specific_force_noise_m_s2": 0},
            "inclination": {"noise_deg": 0}, "lengths": {"noise_m": 0}, "forces": {"noise_N": 0},
        }  # fmt: skip
        own = silent.get(self.ROLE, {}) | self.latency(protocol) | errors
        noise = SensorEmulation.model_validate({self.ROLE: own})
        drives = LegsProtocol("fd", (1, 2, 3, 4, 5, 6))
        given = Mover(), drives, DriveEmulation(), DriveSettings(), None
        nodes = SensedNodes(protocol, noise, (0.0, 0.0, -9.81), *given)
        end = drives.controller_end(_SETUP)
        opening = protocol.opening(Callee(end.opening, end.opener, end), drives, RATE_Hz)
        heard, late = unheard(protocol.tables), np.zeros(0, FRAME)
        slot = next(iter(protocol.sensors))
        samples, frames, rejected = [], [], 0
        nodes.start(0)
        for tick in range(ticks):
            t_ns = tick * MS
            sent = protocol.begin(opening, tick, np.zeros(64, FRAME)).copy()
            if starts:
                sent = np.concatenate((sent, protocol.set_up(tick, RATE_Hz, heard)))
            sent["t_ns"] = t_ns
            replies = joined([nodes.advance(t_ns, sent), nodes.advance(t_ns + MS - 1, sent[:0])])
            ours = np.isin(replies["id"], protocol.tables.rows["id"])
            got, late = _split(joined([late, self.carried(replies[ours])]), t_ns + MS)
            hear_frames(heard, got, tick, t_ns)
            rejected += int(heard.record["rejected"])
            frames.append(got)
            for k in range(int(heard.slots["count"][slot])):
                sample = heard.samples[slot, k]
                at_s = 1e-3 * int(sample["tick"]) + float(sample["offset_s"])
                samples.append((tick, at_s, sample["values"].copy()))
        return samples, frames, rejected

    def latency(self, protocol: SensorProtocol) -> dict[str, Any]:
        """Latency of the emulated device: that which the family states."""
        device = next(iter(protocol.sensors.values())).device
        return {"latency_ms": 0.3 if device.timing == SYNCED else 1e3 * device.latency_s or 2.0}

    def test_samples_have_the_true_values_of_their_instants(self, protocol):
        samples, _, rejected = self.run(protocol)
        settled = [(at_s, values) for tick, at_s, values in samples if tick > 50]
        rate_Hz = next(iter(protocol.sensors.values())).rate_Hz
        assert len(settled) == pytest.approx(0.25 * rate_Hz, abs=3)
        assert rejected == 0
        for at_s, values in settled:
            true = expected(self.ROLE, at_s)
            known = ~np.isnan(values[: len(true)])
            np.testing.assert_allclose(values[: len(true)][known], true[known], rtol=0, atol=self.RESOLUTION)

    def test_no_tick_has_more_frames_than_the_bus_budget_counts(self, protocol):
        _, frames, _ = self.run(protocol)
        counted = [(frame.id, len(frame.data)) for frame in protocol.cyclic_frames(RATE_Hz) if frame.data]
        for ours in frames:
            found = [*zip(ours["id"].tolist(), ours["length"].tolist(), strict=True)]
            assert all(found.count(each) <= counted.count(each) for each in found), found

    def test_a_device_sends_no_sample_before_it_is_started(self, protocol):
        samples, _, _ = self.run(protocol, starts=False)
        assert bool(samples) == (not next(iter(protocol.sensors.values())).device.start)

    def test_lost_samples_leave_gaps_and_a_seed_repeats_the_run(self, protocol):
        samples, _, _ = self.run(protocol)
        fewer, _, _ = self.run(protocol, lost_percent=30)
        assert 0.5 * len(samples) < len(fewer) < 0.9 * len(samples)
        again, _, _ = self.run(protocol, lost_percent=30)
        assert [each[:2] for each in again] == [each[:2] for each in fewer], "the same seed, the same run"

    def test_frames_of_any_length_and_content_are_survived(self, protocol):
        chance, heard = np.random.default_rng(1), unheard(protocol.tables)
        table = protocol.tables.rows
        ours = list(zip(table["id"].tolist(), (table["flags"] + BUS * table["bus"]).tolist(), strict=True))
        for tick in range(200):
            broken = [
                Received(tick * MS + k, Frame(identifier, chance.bytes(int(chance.integers(0, 65))), flags))
                for k, (identifier, flags) in enumerate(ours)
            ]
            hear_frames(heard, received_array(broken), tick, tick * MS)
        assert int(heard.record["rejected"]) >= 0
        last = heard.slots["last"][next(iter(protocol.sensors))]
        assert not np.isinf(last).any()

    @pytest.mark.parametrize("flag", [EXTENDED, REMOTE, ERROR])
    def test_frames_with_another_flag_or_bus_are_ignored(self, protocol, flag):
        _, frames, _ = self.run(protocol, 100)
        ours = joined(frames)
        heard = unheard(protocol.tables)
        for change in ("flags", "bus"):
            other = ours.copy()
            other[change] ^= flag if change == "flags" else 1
            hear_frames(heard, other[:100], 100, 0)
            assert (heard.slots["count"].sum(), int(heard.record["rejected"])) == (0, 0)


def _split(frames: Rows, until_ns: int) -> tuple[Rows, Rows]:
    frames = frames[np.argsort(frames["t_ns"], kind="stable")]
    early = frames["t_ns"] < until_ns
    return frames[early], frames[~early]
