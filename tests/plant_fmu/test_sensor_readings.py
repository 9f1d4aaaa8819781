"""What emulated sensors read at an instant, figure by figure: truth, bias, noise as it is drawn, and loss."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from drivers.config import BusSettings, ImuSettings, SensorSettings
from drivers.frame_array import received_array
from drivers.protocol import Received
from drivers.sensors import SensorProtocol
from plant_fmu.config import ImuEmulation, SensorEmulation, TrackerEmulation, WrenchEmulation
from plant_fmu.drives.sensor_nodes import SensedNodes
from plant_fmu.plant import Truth
from tests.drivers.legs_frames import opening
from tests.plant_fmu.test_sensor_nodes import ALL, DRIVES, MS, Mover, sensed
from tests.sensed import Readings, decode

NOISY = SensorEmulation(
    tracker=TrackerEmulation(
        position_noise_m=0.5,
        orientation_noise_deg=3.0,
        position_bias_m=(0.1, 0.2, 0.3),
        rotation_bias_deg=(10.0, -20.0, 5.0),
    ),
    imu=ImuEmulation(
        angular_rate_noise_rad_s=0.25,
        specific_force_noise_m_s2=2.0,
        angular_rate_bias_rad_s=(0.01, 0.02, 0.03),
        specific_force_bias_m_s2=(0.4, 0.5, 0.6),
    ),
    wrench=WrenchEmulation(
        force_noise_N=4.0,
        moment_noise_N_m=8.0,
        force_bias_N=(1.0, 2.0, 3.0),
        moment_bias_N_m=(7.0, 8.0, 9.0),
    ),
)
TURNED = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
"""x of the platform is y of the base."""
TRUTH = Truth(np.array([1.0, 2.0, 3.0]), TURNED, np.array([9.0, 9.0, 9.0, 0.5, 0.7, 0.9]), np.zeros(6))
DRAWN = np.array([1.0, -2.0, 3.0])


class Still(Mover):
    """A platform whose truth does not change."""

    def truth(self):
        return TRUTH


def draw(nodes: SensedNodes, chance: float = 0.5) -> None:
    """Let the nodes draw these numbers alone."""

    def normal(out: np.ndarray) -> None:
        out[:] = np.tile(DRAWN, 2)

    nodes._chance = cast("Any", SimpleNamespace(random=lambda: chance, standard_normal=normal))


def first_samples() -> tuple[np.ndarray, ...]:
    """Return what tracker, IMU and wrench sensor measure first, SI."""
    nodes = sensed(Still(), noise=NOISY)
    nodes.start(0)
    draw(nodes)
    nodes._sensed["acceleration"] = 1.0, 2.0, 3.0
    nodes._record["wrench"] = np.array([10.0, 20.0, 30.0, 40.0, 50.0, 60.0])
    sent = nodes.step(0, [Received(0, opening(DRIVES, 0)[0])]) + nodes.step(9 * MS, [])
    frames = received_array([Received(*each) for each in sent])
    found = decode(SensorProtocol(BusSettings(), ALL), frames, 0, Readings())
    return tuple(np.array(samples[0].values) for samples in found[:3])


def test_a_pose_is_off_by_its_bias_and_by_its_noise_as_it_is_drawn():
    found, _, _ = first_samples()
    np.testing.assert_allclose(
        found[:3], [1.0 + 0.1 + 0.5, 2.0 + 0.2 - 1.0, 3.0 + 0.3 + 1.5], rtol=0.0, atol=1e-7
    )
    off = Rotation.from_rotvec(np.deg2rad([10.0 + 3.0, -20.0 - 6.0, 5.0 + 9.0]))
    expected = off * Rotation.from_matrix(TURNED)
    np.testing.assert_allclose(Rotation.from_rotvec(found[3:]).as_matrix(), expected.as_matrix(), atol=4e-9)


def test_rates_forces_and_moments_are_off_by_bias_and_noise_in_the_platform_frame():
    _, inertial, load = first_samples()
    rate = [0.7 + 0.01 + 0.25, -0.5 + 0.02 - 0.5, 0.9 + 0.03 + 0.75]
    force = [2.0 + 0.4 + 2.0, -1.0 + 0.5 - 4.0, 3.0 + 9.81 + 0.6 + 6.0]
    np.testing.assert_allclose(inertial[:3], rate, rtol=0.0, atol=1.01e-4)
    np.testing.assert_allclose(inertial[3:], force, rtol=0.0, atol=1.01e-3)
    loads = [20.0 + 1.0 + 4.0, -10.0 + 2.0 - 8.0, 30.0 + 3.0 + 12.0]
    moment = [50.0 + 7.0 + 8.0, -40.0 + 8.0 - 16.0, 60.0 + 9.0 + 24.0]
    np.testing.assert_allclose(load, [*loads, *moment], rtol=0.0, atol=0.501e-3)


@pytest.mark.parametrize(("chance", "kept"), [(0.2499, 0), (0.25, 1), (0.75, 1)])
def test_a_sample_is_lost_where_its_draw_is_below_its_share(chance, kept):
    lossy = SensorEmulation(imu=ImuEmulation(lost_percent=25.0))
    nodes = sensed(Mover(), SensorSettings(imu=ImuSettings()), lossy)
    nodes.start(0)
    draw(nodes, chance)
    sent = nodes.step(0, [Received(0, opening(DRIVES, 0)[0])]) + nodes.step(1 * MS, [])
    assert sum(frame.id == 0x488 for _, frame in sent) == kept


def test_an_imu_that_measures_more_often_than_its_plant_steps_measures_all_the_same():
    class Coarse(Mover):
        internal_step_s = 1e-3

    nodes = sensed(Coarse(), SensorSettings(imu=ImuSettings(rate_Hz=2000)))
    nodes.start(0)
    sent = nodes.step(0, [Received(0, opening(DRIVES, 0)[0])])
    for t_ms in range(1, 11):
        sent += nodes.step(t_ms * MS, [])
    assert [t for t, frame in sent if frame.id == 0x488] == [k * MS // 2 + 200_000 for k in range(20)]
