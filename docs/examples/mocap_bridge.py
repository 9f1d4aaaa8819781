"""Bridge from a motion capture server to the tracker of hexapod-hil, one datagram a pose.

    python mocap_bridge.py natnet 239.255.42.99:1511 3 --to 192.168.1.10:5005         # OptiTrack, body 3
    python mocap_bridge.py vicon 192.168.1.30:801 Platform --to 192.168.1.10:5005   # vicon_dssdk
    python mocap_bridge.py qtm 192.168.1.31 Platform --to 192.168.1.10:5005   # qtm-rt

All three turn the maker's units and axes into metres, z upwards, rotation from the body to the room.
`hil identify sensors` finds the pose of the room's frame and of the body on the platform. A sample's stamp is
the time of the server's own clock, which need not agree with any other.

Run it on the controller's machine or next to the server, but not in the controller's process.
"""

import argparse
import asyncio
import math
import socket
import struct
import time
import xml.etree.ElementTree as ET
from collections.abc import Iterator
from typing import Any, NamedTuple

LAYOUT = struct.Struct("<HBxfQ3d3f11x")
"""Sequence, status, residual m, stamp ns, position m, rotation vector rad; then the CRC-8."""
IDENTIFIER = b"\x00\x01"
"""The CRC begins with these two bytes, which are not sent."""


class Pose(NamedTuple):
    """A pose of the body in the room."""

    t_s: float
    """Instant of the sample by the server's clock."""
    position: tuple[float, float, float]
    """m, z upwards."""
    quaternion: tuple[float, float, float, float]
    """x, y, z, w: rotation from the body to the room."""
    residual_m: float = 0.0
    """Mean distance of the markers from the fitted body; 0 if the server does not say."""
    valid: bool = True


def crc8(data: bytes) -> int:
    """CRC-8 SAE J1850: polynomial 0x1D, start and final XOR 0xFF; 0x4B for b"123456789"."""
    crc = 0xFF
    for byte in data:
        crc ^= byte
        for _ in range(8):
            crc = (crc << 1 ^ (0x1D if crc & 0x80 else 0)) & 0xFF
    return crc ^ 0xFF


def rotation_vector(x: float, y: float, z: float, w: float) -> tuple[float, float, float]:
    """Rotation vector, rad, of a quaternion of any length and sign."""
    sine = math.sqrt(x * x + y * y + z * z)
    angle = 2.0 * math.atan2(sine, abs(w))
    k = math.copysign(angle / sine, w) if sine > 0.0 else 0.0
    return k * x, k * y, k * z


def datagram(sequence: int, pose: Pose) -> bytes:
    """The 64 bytes of a sample; sequence counts samples, modulo 65536."""
    values = (*pose.position, *rotation_vector(*pose.quaternion))
    status = 0 if pose.valid and all(map(math.isfinite, values)) else 1
    values = (0.0,) * 6 if status else values
    body = LAYOUT.pack(sequence & 0xFFFF, status, pose.residual_m, round(pose.t_s * 1e9), *values)
    return body + bytes([crc8(IDENTIFIER + body)])


def from_y_up(pose: Pose) -> Pose:
    """Turn a pose with y upwards by 90 degrees about x: the room's axes, and the body's."""
    (x, y, z), (qx, qy, qz, qw) = pose.position, pose.quaternion
    return pose._replace(position=(x, -z, y), quaternion=(qx, -qz, qy, qw))


def natnet_pose(packet: bytes, body: int, *, y_up: bool = True) -> Pose | None:
    """Pose of a rigid body in a NatNet frame, version 4.1 or later: m, x y z w, y upwards by default.

    Sections: marker sets, other markers, rigid bodies, skeletons, assets, markers, force plates, devices.
    """
    if len(packet) < 8 or struct.unpack_from("<H", packet)[0] != 7:  # 7: frame of data
        return None
    found, at = None, 8
    for section in range(8):
        count, size = struct.unpack_from("<iI", packet, at)
        at += 8
        for k in range(count if section == 2 else 0):
            number, *values, error, flags = struct.unpack_from("<i3f4ffh", packet, at + 38 * k)
            if number == body:
                found = Pose(0.0, tuple(values[:3]), tuple(values[3:]), error, bool(flags & 1))
        at += size
    (t_s,) = struct.unpack_from("<d", packet, at + 8)  # after the time code
    if found is None:
        return None
    return from_y_up(found._replace(t_s=t_s)) if y_up else found._replace(t_s=t_s)


def vicon_pose(translation: Any, rotation: Any, t_s: float) -> Pose:
    """Pose from GetSegmentGlobalTranslation and ...RotationQuaternion: (values, occluded), mm, x y z w."""
    (position, hidden), (quaternion, hidden_too) = translation, rotation
    metres = tuple(1e-3 * each for each in position)
    return Pose(t_s, metres, tuple(quaternion), valid=not (hidden or hidden_too))


def qtm_pose(position: Any, matrix: Any, residual_mm: float, t_us: int) -> Pose:
    """Pose of a 6DOF body of QTM: mm, nine elements column by column, NaN while the body is not seen."""
    if any(map(math.isnan, (*position, *matrix))):
        return Pose(1e-6 * t_us, (0.0,) * 3, (0.0, 0.0, 0.0, 1.0), valid=False)
    a, b, c, d, e, f, g, h, i = matrix
    w = 0.5 * math.sqrt(max(0.0, 1.0 + a + e + i))
    x, y, z = (0.5 * math.sqrt(max(0.0, 1.0 + s)) for s in (a - e - i, e - a - i, i - a - e))
    if w >= max(x, y, z):
        q = ((f - h) / (4 * w), (g - c) / (4 * w), (b - d) / (4 * w), w)
    elif x >= max(y, z):
        q = (x, (b + d) / (4 * x), (c + g) / (4 * x), (f - h) / (4 * x))
    elif y >= z:
        q = ((b + d) / (4 * y), y, (f + h) / (4 * y), (g - c) / (4 * y))
    else:
        q = ((c + g) / (4 * z), (f + h) / (4 * z), z, (b - d) / (4 * z))
    metres = tuple(1e-3 * each for each in position)
    return Pose(1e-6 * t_us, metres, q, 1e-3 * residual_mm)


def from_natnet(address: str, body: str, interface: str = "0.0.0.0") -> Iterator[Pose]:
    """Poses that Motive streams by multicast."""
    group, _, port = address.partition(":")
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as receiver:
        receiver.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        receiver.bind((group, int(port or 1511)))
        member = socket.inet_aton(group) + socket.inet_aton(interface)
        receiver.setsockopt(socket.IPPROTO_IP, socket.IP_ADD_MEMBERSHIP, member)
        while True:
            pose = natnet_pose(receiver.recv(65536), int(body))
            if pose is not None:
                yield pose


def from_vicon(address: str, body: str) -> Iterator[Pose]:
    """Poses of the root segment of a subject, by Vicon's DataStream SDK."""
    from vicon_dssdk import ViconDataStream

    client = ViconDataStream.Client()
    client.Connect(address)
    client.EnableSegmentData()
    client.SetStreamMode(ViconDataStream.Client.StreamMode.EServerPush)
    mapping = ViconDataStream.Client.AxisMapping
    client.SetAxisMapping(mapping.EForward, mapping.ELeft, mapping.EUp)
    while True:
        client.GetFrame()
        t_s, segment = time.monotonic() - client.GetLatencyTotal(), client.GetSubjectRootSegmentName(body)
        translation = client.GetSegmentGlobalTranslation(body, segment)
        yield vicon_pose(translation, client.GetSegmentGlobalRotationQuaternion(body, segment), t_s)


async def from_qtm(address: str, body: str, send: Any) -> None:
    """Send each pose of a 6DOF body that QTM streams."""
    import qtm_rt

    connection = await qtm_rt.connect(address)
    names = ET.fromstring(await connection.get_parameters(parameters=["6d"])).findall("*/Body/Name")
    index = [(each.text or "").strip() for each in names].index(body)

    def on_packet(packet: Any) -> None:
        position, rotation, residual = packet.get_6d_residual()[1][index]
        send(qtm_pose(position, rotation.matrix, residual.residual, packet.timestamp))

    await connection.stream_frames(components=["6dres"], on_packet=on_packet)
    await asyncio.Event().wait()


def main() -> None:
    """Read poses from a server, and send each at once."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("server", choices=["natnet", "vicon", "qtm"])
    parser.add_argument("address")
    parser.add_argument("body")
    parser.add_argument("--to", required=True, help="address:port in bus.channels")
    given = parser.parse_args()
    host, _, port = given.to.partition(":")
    sender, sequence = socket.socket(socket.AF_INET, socket.SOCK_DGRAM), 0

    def send(pose: Pose) -> None:
        nonlocal sequence
        sender.sendto(datagram(sequence, pose), (host, int(port)))
        sequence += 1

    if given.server == "qtm":
        asyncio.run(from_qtm(given.address, given.body, send))
    for pose in (from_natnet if given.server == "natnet" else from_vicon)(given.address, given.body):
        send(pose)


if __name__ == "__main__":
    main()
