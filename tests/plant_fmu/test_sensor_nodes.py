"""Emulated sensors on a platform whose motion is known in closed form."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from drivers.config import BusSettings, DriveSettings
from drivers.errors import PlantError
from drivers.frame_array import received_array
from drivers.legs.protocol import LegsProtocol
from drivers.protocol import ERROR, EXTENDED, REMOTE, Frame, Received
from drivers.sensing.settings import ImuSettings, SensorSettings, TrackerSettings, WrenchSensorSettings
from drivers.sensors import SensorProtocol
from hil.contracts.sensor import Mover as Moved
from plant_fmu.config import DriveEmulation, ImuEmulation, SensorEmulation, TrackerEmulation, WrenchEmulation
from plant_fmu.drives.sensor_nodes import SensedNodes
from plant_fmu.faults.kinds import FramesCorrupt, FramesLoss, WrenchStep
from plant_fmu.faults.plan import FaultPlan
from plant_fmu.plant import Truth
from tests.drivers.legs_frames import opening
from tests.sensor_samples import Readings, decode

MS, US = 1_000_000, 1_000
G = (0.0, 0.0, -9.81)
AXIS = np.array([0.0, 0.6, 0.8])
WRENCH = (100.0, -50.0, 20.0, 5.0, 0.0, -3.0)
EXACT = SensorEmulation(
    tracker=TrackerEmulation(latency_ms=5.0, position_noise_m=0.0, orientation_noise_deg=0.0),
    imu=ImuEmulation(angular_rate_noise_rad_s=0.0, specific_force_noise_m_s2=0.0),
)
ALL = SensorSettings(tracker=TrackerSettings(), imu=ImuSettings(), wrench=WrenchSensorSettings())
DRIVES = LegsProtocol("fd", (1, 2, 3, 4, 5, 6))


def position(t):
    return np.array([0.3 * t + 2.0 * t * t, 0.1 * np.sin(5 * t), 1.0])


def velocity(t):
    return np.array([0.3 + 4.0 * t, 0.5 * np.cos(5 * t), 0.0])


def acceleration(t):
    return np.array([4.0, -2.5 * np.sin(5 * t), 0.0])


def rotation(t):
    return Rotation.from_rotvec(AXIS * (0.2 + 0.7 * t)).as_matrix()


class Mover(Moved):
    """A platform with a given motion, independent of its inputs."""

    blind = False

    def step(self, force, brake, wrench, dt_s):
        super().step(force, brake, wrench, dt_s)
        return np.ones(6), np.zeros(6)

    def truth(self):
        t = self.t_s
        twist = np.concatenate((velocity(t), 0.7 * AXIS))
        return None if self.blind else Truth(position(t), rotation(t), twist, np.zeros(6))


def run(noise, settings=ALL, ticks=200, faults=None, sync_after_us=65, plant=None):
    """Valid samples by kind, (receive time s, sample time s, values), and the number of rejected frames."""
    protocol = SensorProtocol(BusSettings(), settings)
    args = (plant or Mover(), DRIVES, DriveEmulation(), DriveSettings(), faults)
    nodes = SensedNodes(protocol, noise, G, *args)
    nodes.start(7 * MS)
    found: dict[str, list[tuple[float, float, np.ndarray]]] = {"tracker": [], "imu": [], "wrench": []}
    readings = Readings()
    rejected = 0
    waiting: list[tuple[int, Frame]] = []
    for tick in range(ticks):
        synced = 7 * MS + tick * MS + sync_after_us * US
        queued = nodes.step(synced, [Received(synced, opening(DRIVES, tick)[0])])
        assert [t for t, _ in queued] == sorted(t for t, _ in queued)
        waiting = sorted(waiting + queued, key=lambda each: each[0])
        out = [each for each in waiting if each[0] <= synced]
        waiting = waiting[len(out) :]
        readings = decode(protocol, received_array([Received(t, frame) for t, frame in out]), tick, readings)
        rejected += readings.rejected
        for kind, samples in found.items():
            for sample in getattr(readings, kind):
                at = sample.tick * 1e-3 + sync_after_us * 1e-6 + sample.offset_s
                samples.append((tick * 1e-3, at, np.array(sample.values)))
    return found, rejected


def test_pose_tracker_sends_the_true_pose_at_its_time_stamp_5_ms_later():
    found, rejected = run(EXACT)
    assert rejected == 0
    assert len(found["tracker"]) == pytest.approx(200 / 5, abs=2)
    for heard, at, values in found["tracker"]:
        assert heard - at == pytest.approx(5e-3, abs=1.1e-3)
        assert values[:3] == pytest.approx(position(at), abs=1.1e-6), "the stamp has 1 us, the platform 1 m/s"
        assert values[3:] == pytest.approx(AXIS * (0.2 + 0.7 * at), abs=1e-6)


def test_an_imu_measures_rate_and_specific_force_in_the_platform_frame():
    found, _ = run(EXACT)
    assert len(found["imu"]) == pytest.approx(100, abs=2)
    for _, at, values in found["imu"][5:]:
        R = rotation(at)
        assert values[:3] == pytest.approx(0.7 * R.T @ AXIS, abs=1.1e-4)
        assert values[3:] == pytest.approx(R.T @ np.subtract(acceleration(at), G), abs=2.5e-3)


def test_a_wrench_sensor_measures_the_load_in_the_platform_frame():
    found, _ = run(
        EXACT, faults=FaultPlan([WrenchStep(at_s=0.05, force_N=WRENCH[:3], moment_N_m=WRENCH[3:])])
    )
    before = [values for _, at, values in found["wrench"] if at < 0.0495]
    after = [(at, values) for _, at, values in found["wrench"] if at > 0.0505]
    assert len(before) > 40
    assert len(after) > 140
    assert np.abs(before).max() == 0.0
    for at, values in after:
        R = rotation(at)
        assert values[:3] == pytest.approx(R.T @ WRENCH[:3], abs=2e-2)
        assert values[3:] == pytest.approx(R.T @ WRENCH[3:], abs=2e-3)


def test_noise_and_bias_of_simulated_sensors_have_the_configured_size():
    bias = SensorEmulation(
        tracker=TrackerEmulation(position_bias_m=(0.01, -0.02, 0.03), rotation_bias_deg=(1.0, -0.5, 2.0)),
        imu=ImuEmulation(angular_rate_bias_rad_s=(0.1, 0.2, -0.3), specific_force_bias_m_s2=(0.4, 0.5, -0.2)),
        wrench=WrenchEmulation(
            force_noise_N=10.0,
            moment_noise_N_m=1.0,
            force_bias_N=(10.0, -20.0, 30.0),
            moment_bias_N_m=(7.0, 30.0, -9.0),
        ),
    )
    fast = SensorSettings(
        tracker=TrackerSettings(rate_Hz=1000), imu=ImuSettings(rate_Hz=1000), wrench=WrenchSensorSettings()
    )
    found, _ = run(bias, fast, ticks=2000)
    tracker = [
        np.concatenate((v[:3] - position(at), (Rotation.from_rotvec(v[3:]) * Rotation.from_matrix(rotation(at)).inv()).as_rotvec()))
        for _, at, v in found["tracker"]
    ]  # fmt: skip
    imu = [
        v - np.concatenate((0.7 * rotation(at).T @ AXIS, rotation(at).T @ np.subtract(acceleration(at), G)))
        for _, at, v in found["imu"][5:]
    ]
    wrench = [v for _, _, v in found["wrench"]]
    degree = np.deg2rad(1)
    for samples, mean, std in (
        (tracker, [0.01, -0.02, 0.03, degree, -0.5 * degree, 2 * degree], [1e-3] * 3 + [0.1 * degree] * 3),
        (imu, [0.1, 0.2, -0.3, 0.4, 0.5, -0.2], [2e-3] * 3 + [0.05] * 3),
        (wrench, [10.0, -20.0, 30.0, 7.0, 30.0, -9.0], [10.0] * 3 + [1.0] * 3),
    ):
        assert np.abs((np.mean(samples, axis=0) - mean) / std).max() < 5 / np.sqrt(2000)
        assert np.std(samples, axis=0) == pytest.approx(std, rel=0.1)


def test_injected_frame_faults_affect_sensor_frames_too():
    lost, _ = run(EXACT, faults=FaultPlan([FramesLoss(identifier=0x407)]))
    assert lost["tracker"] == []
    assert lost["imu"]
    corrupted, rejected = run(EXACT, faults=FaultPlan([FramesCorrupt(identifier=0x407)]))
    assert corrupted["tracker"] == []
    assert rejected > 35


@pytest.mark.parametrize(
    ("frame", "stamps"),
    [
        (Frame(0x080, b"\xa7\xc3"), True),
        *((Frame(0x080, b"\xa7\xc3", flag), False) for flag in (EXTENDED, REMOTE, ERROR)),
        (Frame(0x080, b"\xa7\xc2"), False),
        (Frame(0x080, b"\xa7"), False),
        (Frame(0x110, b"\xa7\xc3"), False),
    ],
)
def test_only_an_intact_sync_is_used_for_sensor_time_stamps(frame, stamps):
    nodes = sensed(Mover(), SensorSettings(imu=ImuSettings()))
    nodes.start(0)
    sent = nodes.step(1 * MS, [Received(1 * MS, frame)]) + nodes.step(20 * MS, [])
    cycles = {each.data[14] for _, each in sent if each.id == 0x488}
    assert cycles == ({0xA7} if stamps else set())


@pytest.mark.parametrize("bus", [0, 1])
def test_sensor_time_stamps_are_relative_to_the_sync_on_the_bus_of_the_sensor(bus):
    legs = [{"channel": "a", "legs": [0, 1, 2]}, {"channel": "b", "legs": [3, 4, 5]}]
    settings = SensorSettings(imu=ImuSettings(channel="b"))
    protocol = SensorProtocol(BusSettings.model_validate({"channels": legs}), settings)
    drives = LegsProtocol("fd", (1, 2, 3, 4, 5, 6), 60_000.0, ((0, 1, 2), (3, 4, 5)))
    nodes = SensedNodes(protocol, EXACT, G, Mover(), drives, DriveEmulation(), DriveSettings())
    nodes.start(0)
    nodes.step(1 * MS, [Received(1 * MS, opening(drives, 0)[bus])])
    sensed = [frame.bus for _, frame in nodes.step(20 * MS, []) if frame.id == 0x488]
    assert sensed == [1] * len(sensed)
    assert bool(sensed) == (bus == 1), "a sensor receives the SYNC of its own bus alone"


def test_sensors_on_a_plant_without_a_pose_are_refused():
    plant = Mover()
    plant.blind = True
    with pytest.raises(PlantError, match="does not know its pose"):
        run(EXACT, plant=plant)


def sensed(plant: Mover, settings: SensorSettings = ALL, noise: SensorEmulation = EXACT) -> SensedNodes:
    protocol = SensorProtocol(BusSettings(), settings)
    args = (plant, DRIVES, DriveEmulation(), DriveSettings(), None)
    return SensedNodes(protocol, noise, G, *args)


@pytest.mark.parametrize("t0_ns", [0, 1, 3 * MS])
def test_first_imu_sample_after_a_start_contains_gravity_alone(t0_ns):
    settings = SensorSettings(imu=ImuSettings())
    nodes, protocol = sensed(Mover(), settings), SensorProtocol(BusSettings(), settings)
    for _ in range(2):
        nodes.start(t0_ns)
        sent = nodes.step(t0_ns, [Received(t0_ns, opening(DRIVES, 0)[0])])
        sent += nodes.step(t0_ns + MS, [])
        readings = decode(protocol, received_array([Received(*each) for each in sent]), 0, Readings())
        (first,) = readings.imu
        assert first.values[3:] == pytest.approx(rotation(0.0).T @ [0.0, 0.0, 9.81], abs=2.5e-3)
        nodes.step(t0_ns + 50 * MS, [])
