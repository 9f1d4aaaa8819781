"""The fields of MIT framing: numbers of n bits over a range. Pure.

The reference is B. Katz's motor firmware (github.com/bgkatz/motorcontrol at 3586419, math_ops.c and
CAN_com.c): 2^n - 1 steps, truncated. Zero of a symmetric range is no code: it is sent as half a step less.
"""

from math import pi
from typing import NamedTuple

from drivers.codes import code, value
from drivers.compiled.compiler import helper

TURN = 2.0 * pi
"""rad."""
TOP_COMMAND = 0xFFB
"""Highest torque code sent: with all else at the top, FFC to FFF are the special frames and their kin."""


class Ranges(NamedTuple):
    """Ends of the fields; position, velocity and torque are symmetric, the gains begin at zero."""

    position: float
    """rad."""
    velocity: float
    """rad/s."""
    kp: float
    """N m/rad."""
    kd: float
    """N m s/rad."""
    torque: float
    """N m."""


def pack_command(position: float, velocity: float, kp: float, kd: float, torque: float, r: Ranges) -> bytes:
    """Return the eight bytes of a command: 16, 12, 12, 12 and 12 bits, most significant first."""
    number = code(position, -r.position, r.position, 16)
    for x, low, high in (
        (velocity, -r.velocity, r.velocity),
        (kp, 0.0, r.kp),
        (kd, 0.0, r.kd),
        (torque, -r.torque, r.torque),
    ):
        number = number << 12 | code(x, low, high, 12)
    return number.to_bytes(8, "big")


@helper
def unpack_motion(data: bytes, r: Ranges) -> tuple[int, float, float, float]:
    """Return the code of the position, rad, rad/s and N m of five bytes of a reply."""
    p = data[0] << 8 | data[1]
    v, t = data[2] << 4 | data[3] >> 4, (data[3] & 0xF) << 8 | data[4]
    return (
        p,
        value(p, -r.position, r.position, 16),
        value(v, -r.velocity, r.velocity, 12),
        value(t, -r.torque, r.torque, 12),
    )


@helper
def scaled(x: float, end: float, bits: int, clamps: bool) -> int:
    """Return the code of a number in a symmetric field, as a drive packs it."""
    at = min(max(x, -end), end) if clamps else x
    return int((at + end) * ((1 << bits) - 1) / (2.0 * end))


@helper
def device_motion(
    position: float, velocity: float, torque: float, r: Ranges, clamps: bool
) -> tuple[int, int, int, int, int]:
    """Return the five bytes of a reply as a drive packs them.

    Without clamping, as Katz's firmware: a position past its range wraps, the velocity loses its high bits,
    and the torque carries into the velocity's low ones.
    """
    p = scaled(position, r.position, 16, clamps)
    v = scaled(velocity, r.velocity, 12, clamps)
    t = scaled(torque, r.torque, 12, clamps)
    return p >> 8 & 0xFF, p & 0xFF, v >> 4 & 0xFF, ((v & 0xF) << 4) + (t >> 8) & 0xFF, t & 0xFF
