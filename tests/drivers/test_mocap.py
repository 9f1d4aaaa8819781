"""Motion capture by UDP: datagrams of the bridge example at the controller's end, and what it refuses."""

from __future__ import annotations

import runpy
import socket
import struct
import time
from collections.abc import Iterator
from typing import Any, ClassVar

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from drivers.arrays import Rows
from drivers.can.bus import Bus
from drivers.can.udp import BATCH, Udp
from drivers.clock import MONOTONIC
from drivers.config import DATAGRAM_BYTES, POSE_ID, BusSettings
from drivers.errors import BusError, ConfigurationError
from drivers.frame_array import received_array, sent_array
from drivers.protocol import BUS, FD, Frame, Received
from drivers.sensing.layout import TRACKER, Reception, unheard
from drivers.sensing.settings import SensorSettings
from drivers.sensors import SensorProtocol
from hil.contracts.sensor import MS, SensorContract, hear_frames
from tests.loop.bench import changed

BRIDGE = runpy.run_path("docs/examples/mocap_bridge.py")
Pose, datagram = BRIDGE["Pose"], BRIDGE["datagram"]
DEVICE = {"protocol": "mocap", "latency_ms": 2}
QUARTER = (0.0, 0.0, np.sin(np.pi / 4), np.cos(np.pi / 4))
AT_12_S = Pose(12.5, (0.25, -0.5, 1.0), QUARTER, 2e-4)
BYTES = (
    "34120000" "17b75139" "00dd0ee902000000" "000000000000d03f" "000000000000e0bf" "000000000000f03f"
    "00000000" "00000000" "db0fc93f" "0000000000000000000000"
)  # fmt: skip
"""The table of docs/guides/sensors.md by hand: sequence 0x1234, valid, 0.2 mm, 12.5e9 ns, three float64, three
float32; without the CRC."""


def free_port() -> int:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


HERE = f"127.0.0.1:{free_port()}"
TRACKED = {"channel": HERE, "interface": "udp", "options": {"source": "127.0.0.1"}}


def channels(*entries: dict[str, Any]) -> BusSettings:
    return BusSettings.model_validate(
        {"channels": [{"channel": "mocap-test", "legs": [*range(6)]}, *entries]}
    )


class TestMotionCapture(SensorContract):
    """Each datagram goes through the kernel, by loopback."""

    ROLE = "tracker"
    SETTINGS: ClassVar[dict[str, Any]] = {"rate_Hz": 250, "channel": HERE, "device": DEVICE}
    RESOLUTION = 1e-6
    BUS = channels(TRACKED)

    @pytest.fixture(autouse=True)
    def _link(self) -> Iterator[None]:
        self._ends = Udp(settings(), "plant"), Udp(settings(), "controller")
        yield
        for end in self._ends:
            end.close()

    def carried(self, frames: Rows) -> Rows:
        sender, receiver = self._ends
        assert sender.send(frames) == len(frames)
        received = receiver.receive().copy()
        received["t_ns"], received["bus"] = frames["t_ns"], 1
        return received


class TestMotionCaptureWithoutStamps(TestMotionCapture):
    SETTINGS: ClassVar[dict[str, Any]] = TestMotionCapture.SETTINGS | {"device": DEVICE | {"stamps": False}}


def reception(**device: Any) -> Reception:
    tracker = {"rate_Hz": 200, "channel": HERE, "device": DEVICE | device}
    sensors = SensorSettings.model_validate({"tracker": tracker})
    return unheard(SensorProtocol(channels(TRACKED), sensors).tables)


def hear(heard: Reception, data: bytes, tick: int = 20, after_ns: int = 0) -> tuple[int, int]:
    """Samples and refused frames of a tick in which these bytes arrive."""
    frame = Received(tick * MS + after_ns, Frame(POSE_ID, data, FD + BUS))
    hear_frames(heard, received_array([frame]), tick, tick * MS)
    return int(heard.slots["count"][TRACKER]), int(heard.record["rejected"])


def test_bridge_writes_the_documented_bytes():
    sent = datagram(0x51234, AT_12_S)
    assert sent[:-1].hex() == BYTES
    assert BRIDGE["crc8"](b"123456789") == 0x4B, "check value of SAE J1850 CRC-8"
    assert len(sent) == DATAGRAM_BYTES


def test_pose_of_a_datagram_becomes_a_sample():
    heard = reception()
    assert hear(heard, datagram(1, AT_12_S)) == (1, 0)
    sample = heard.samples[TRACKER, 0]
    np.testing.assert_allclose(sample["values"], [0.25, -0.5, 1.0, 0.0, 0.0, np.pi / 2], atol=1e-7)
    assert sample["offset_s"] == pytest.approx(-2e-3, abs=1e-9), "the stated latency before its arrival"


NAN = bytes.fromhex(BYTES[:32] + struct.pack("<d", np.nan).hex() + BYTES[48:])
REFUSED = {
    "empty": b"",
    "short": datagram(1, AT_12_S)[:-1],
    "wrong CRC": datagram(1, AT_12_S)[:-1] + b"\x00",
    "a wrong bit": bytes([3]) + datagram(1, AT_12_S)[1:],
    "residual too large": datagram(1, AT_12_S._replace(residual_m=2e-3)),
    "residual is not a number": datagram(1, AT_12_S._replace(residual_m=np.nan)),
    "position is not a number": NAN + bytes([BRIDGE["crc8"](b"\x00\x01" + NAN)]),
}


@pytest.mark.parametrize("what", REFUSED)
def test_malformed_datagram_is_counted_and_changes_nothing(what):
    heard = reception()
    assert hear(heard, REFUSED[what]) == (0, 1)
    assert hear(heard, datagram(1, AT_12_S)) == (1, 0)


@pytest.mark.parametrize("pose", [AT_12_S._replace(valid=False), AT_12_S._replace(position=(np.nan,) * 3)])
def test_pose_of_a_body_that_is_not_seen_is_no_sample_and_no_error(pose):
    assert hear(reception(), datagram(1, pose)) == (0, 0)


def test_repeated_datagram_is_skipped_and_a_gap_is_counted_as_lost():
    heard = reception()
    for number, samples, lost in ((65535, 1, 0), (65535, 0, 0), (0, 1, 0), (3, 1, 2)):
        assert hear(heard, datagram(number, AT_12_S)) == (samples, 0)
        assert int(heard.record["lost"]) == lost


def instants(heard: Reception, count: int, *, jump_at: int = -1) -> np.ndarray[Any, Any]:
    """Errors, s, of the instants of samples that need 2 ms and up to 5 ms more, by a clock that drifts 50 ppm."""
    chance, found = np.random.default_rng(3), []
    for k in range(count):
        true_ns = (100 + 5 * k) * MS
        stamp_s = 1.7e9 + 1.00005e-9 * true_ns - (3600.0 if 0 <= jump_at <= k else 0.0)
        arrives_ns = true_ns + 2 * MS + int(chance.exponential(1e6) + chance.uniform(0, 4e6))
        tick, after_ns = divmod(arrives_ns, MS)
        samples, _ = hear(heard, datagram(k, AT_12_S._replace(t_s=stamp_s)), tick, after_ns)
        sample = heard.samples[TRACKER, 0]
        found.append(1e-3 * sample["tick"] + sample["offset_s"] - 1e-9 * true_ns if samples else np.nan)
    return np.array(found)


def test_stamps_take_the_jitter_of_the_network_off_the_instants():
    stamped, arrived = instants(reception(), 2000), instants(reception(stamps=False), 2000)
    assert np.abs(stamped[200:]).max() < 0.5e-3, "the fastest datagrams are that much apart"
    assert np.ptp(stamped[200:]) < 0.1 * np.ptp(arrived[200:])


def test_clock_of_the_sender_may_be_set_back_during_a_run():
    errors = instants(reception(), 2000, jump_at=1000)
    assert np.flatnonzero(np.isnan(errors)).tolist() == [1000], "an hour too late"
    assert np.abs(errors[1001:]).max() < 8e-3
    assert np.abs(errors[1400:]).max() < 0.5e-3, "2 s later"


def settings(channel: str = HERE, **options: Any) -> BusSettings:
    own = {"channel": channel, "options": options or TRACKED["options"]}
    return channels(TRACKED | own).buses[1]


@pytest.fixture
def link() -> Iterator[Udp]:
    made = Udp(settings(), "controller")
    yield made
    made.close()


def send(*datagrams: bytes, source: str = "127.0.0.1", to: str = "127.0.0.1") -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender:
        sender.bind((source, 0))
        for each in datagrams:
            sender.sendto(each, (to, int(HERE.partition(":")[2])))


def test_datagram_is_received_unchanged_with_the_time_of_its_arrival(link):
    sent = datagram(7, AT_12_S)
    for _ in range(50):
        before = MONOTONIC.now()
        send(sent)
        after = MONOTONIC.now()
        time.sleep(0.02)
        (frame,) = link.receive()
        assert frame["data"].tobytes() == sent
        if frame["t_ns"] < after + 5 * MS:
            break  # Linux begins to stamp a moment after the first socket enables it
    assert before - 100_000 < frame["t_ns"] < after + 5 * MS, "of the kernel, not of the look 20 ms later"


@pytest.mark.parametrize(
    ("data", "source"),
    [
        (b"x" * 63, "127.0.0.1"),
        (b"x" * 65, "127.0.0.1"),
        (b"", "127.0.0.1"),
        (datagram(7, AT_12_S), "127.0.0.2"),
    ],
    ids=["short", "long", "empty", "another sender"],
)
def test_datagram_of_another_length_or_sender_becomes_a_frame_without_data(link, data, source):
    send(data, source=source)
    (frame,) = link.receive()
    assert (int(frame["length"]), int(frame["id"]), int(frame["flags"])) == (0, POSE_ID, FD)


def test_link_is_bound_to_its_configured_address_alone(link):
    send(datagram(1, AT_12_S), to="127.0.0.2")
    assert len(link.receive()) == 0


def test_flood_takes_a_look_no_longer_than_a_batch(link):
    send(*[b"flood"] * 500)
    assert len(link.receive()) == BATCH


@pytest.mark.parametrize(
    ("channel", "options"),
    [
        ("0.0.0.0:5005", {"source": "10.0.0.1"}),
        ("127.0.0.1", {"source": "10.0.0.1"}),
        ("127.0.0.1:70000", {"source": "10.0.0.1"}),
        ("127.0.0.1:5005", {"source": "0.0.0.0"}),
        ("127.0.0.1:0", {"source": "127.0.0.1"}),
        ("127.0.0.1:5005", {"spin_us": 5}),
        ("127.0.0.1:5005", {"source": "127.0.0.1", "spin_us": 5}),
        ("203.0.113.5:5005", {"source": "10.0.0.1"}),
    ],
)
def test_address_that_is_none_or_not_of_this_machine_is_refused(channel, options):
    with pytest.raises(BusError, match="udp"):
        Udp(settings(channel, **options), "controller")


def test_plant_and_controller_exchange_poses_over_loopback_beside_localcan():
    bus = channels(TRACKED)
    with Bus.open(bus, "controller") as controller, Bus.open(bus, "plant") as plant:
        sent = datagram(9, AT_12_S)
        assert plant.send(sent_array([Frame(POSE_ID, sent, FD + BUS)])) == 0
        (frame,) = controller.drain(controller.clock.now() + 100 * MS, {POSE_ID})
        assert (frame["data"].tobytes(), int(frame["bus"])) == (sent, 1)
        assert abs(int(frame["t_ns"]) - controller.clock.now()) < 50 * MS, "one clock"


def test_other_sensors_and_legs_on_udp_and_motion_capture_on_can_are_refused():
    with pytest.raises(ConfigurationError, match=r"sensors.imu.channel.*mocap"):
        SensorProtocol(channels(TRACKED), SensorSettings.model_validate({"imu": {"channel": HERE}}))
    with pytest.raises(ConfigurationError, match=r"sensors.tracker.channel.*mocap on interface localcan"):
        SensorProtocol(channels(TRACKED), SensorSettings.model_validate({"tracker": {"device": DEVICE}}))
    with pytest.raises(ConfigurationError, match="interface udp"):
        changed("desktop", bus={"interface": "udp", "channel": HERE, "options": TRACKED["options"]})


@pytest.mark.parametrize("wrong", [{"options": {"source": "camera.local"}}, {"channel": "127.0.0.1:70000"}])
def test_wrong_address_of_motion_capture_is_refused_before_a_run(wrong):
    entry = TRACKED | wrong
    tracker = {"channel": entry["channel"], "device": {"protocol": "mocap"}}
    legs = {"channel": "desktop0", "legs": [*range(6)]}
    with pytest.raises(ConfigurationError, match="ADDRESS:PORT"):
        changed("desktop", bus={"channels": [legs, entry]}, sensors={"tracker": tracker})


# what the servers send

TURNS = [Rotation.random(random_state=seed) for seed in range(30)]
UP = Rotation.from_rotvec([np.pi / 2, 0, 0])
"""From axes with y upwards to axes with z upwards."""


def natnet(body: int, position: Any, quaternion: Any, error: float, valid: int, t_s: float) -> bytes:
    """Frame of NatNet 4.1 with sections before and behind the rigid bodies; each has a count and a size."""
    first = struct.pack("<i3f4ffh", 99, *[9.0] * 8, 1)
    bodies = first + struct.pack("<i3f4ffh", body, *position, *quaternion, error, valid)
    markers = b"all\x00" + struct.pack("<i3f", 1, 1, 2, 3)
    sections = [
        (1, markers),
        (2, bytes(24)),
        (2, bodies),
        (0, b""),
        (0, b""),
        (1, bytes(26)),
        (0, b""),
        (0, b""),
    ]
    body_of = b"".join(struct.pack("<iI", count, len(data)) + data for count, data in sections)
    payload = struct.pack("<i", 1234) + body_of + struct.pack("<iid3QiihI", 0, 0, t_s, 1, 2, 3, 0, 0, 0, 0)
    return struct.pack("<HH", 7, len(payload)) + payload


def assert_same(pose: Any, t_s: float, position: Any, turn: Rotation) -> None:
    assert pose.t_s == pytest.approx(t_s)
    np.testing.assert_allclose(pose.position, position, atol=1e-6)
    assert (Rotation.from_quat(pose.quaternion) * turn.inv()).magnitude() < 1e-6
    vector = Rotation.from_rotvec(BRIDGE["rotation_vector"](*pose.quaternion))
    assert (vector * turn.inv()).magnitude() < 1e-6


@pytest.mark.parametrize("turn", TURNS)
def test_natnet_frame_with_y_upwards_becomes_a_pose_with_z_upwards(turn):
    packet = natnet(3, (1.0, 2.0, 3.0), turn.as_quat(), 4e-4, 1, 8.25)
    pose = BRIDGE["natnet_pose"](packet, 3)
    assert_same(pose, 8.25, (1.0, -3.0, 2.0), UP * turn * UP.inv())
    assert (pose.residual_m, pose.valid) == (pytest.approx(4e-4), True)
    assert_same(BRIDGE["natnet_pose"](packet, 3, y_up=False), 8.25, (1.0, 2.0, 3.0), turn)
    assert not BRIDGE["natnet_pose"](natnet(3, (1, 2, 3), turn.as_quat(), 0.0, 0, 1.0), 3).valid
    assert BRIDGE["natnet_pose"](packet, 4) is None


@pytest.mark.parametrize("turn", TURNS)
def test_vicon_and_qtm_poses_in_millimetres_become_metres(turn):
    vicon = BRIDGE["vicon_pose"](((1e3, 2e3, 3e3), False), (tuple(turn.as_quat()), False), 4.0)
    assert_same(vicon, 4.0, (1.0, 2.0, 3.0), turn)
    assert not BRIDGE["vicon_pose"](((0, 0, 0), True), ((0, 0, 0, 1), True), 4.0).valid
    columns = turn.as_matrix().T.ravel()
    assert_same(BRIDGE["qtm_pose"]((1e3, 2e3, 3e3), columns, 0.3, 4_000_000), 4.0, (1.0, 2.0, 3.0), turn)
    unseen = BRIDGE["qtm_pose"]((np.nan,) * 3, (np.nan,) * 9, np.nan, 1)
    assert hear(reception(), datagram(1, unseen)) == (0, 0)
