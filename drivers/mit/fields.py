"""Fields of MIT framing, numbers of n bits over a range, and a table of the drives that adopted it. No state.

The reference is B. Katz's motor firmware (github.com/bgkatz/motorcontrol at 3586419, math_ops.c and
CAN_com.c): 2^n - 1 steps, truncated. Zero of a symmetric range has no code: it is sent as half a step less.
"""

from math import pi
from typing import NamedTuple

TURN = 2.0 * pi
"""One turn, rad."""
TOP_COMMAND = 0xFFB
"""Highest torque code sent: with all else at the top, FFC to FFF would be special frames or reserved ones."""


class Ranges(NamedTuple):
    """Ends of the symmetric fields for position, velocity and torque; gains are always sent as zero."""

    position: float
    """End of the position field, rad."""
    velocity: float
    """End of the velocity field, rad/s."""
    torque: float
    """End of the torque field, N m."""


P = 12.5
FOUR_PI = 12.566370614359172


class Variant(NamedTuple):
    """One variant of MIT framing: ranges of its models, fault codes and details of its replies."""

    models: dict[str, Ranges]
    """Ranges of each model, with factory settings."""
    faults: dict[int, str]
    """Fault codes, or bits, with their meanings."""
    silence: int | None = None
    """Fault code of the drive's watchdog; None: it cannot be set, or the drive does not report it."""
    reply_bytes: tuple[int, ...] = (8,)
    """Accepted lengths of a reply; an emulated drive sends the last."""
    clamps: bool = True
    """True if values out of range saturate in a reply; else they wrap."""


CUBEMARS_FAULTS = {
    1: "motor over temperature",
    2: "over current",
    3: "over voltage",
    4: "under voltage",
    5: "encoder fault",
    6: "phase current unbalance",
}
DAMIAO_FAULTS = {
    8: "over voltage",
    9: "under voltage",
    10: "over current",
    11: "MOSFET over temperature",
    12: "rotor over temperature",
    13: "lost communication",
    14: "overload",
}
ROBSTRIDE_FAULTS = {
    1: "under voltage",
    2: "over current",
    4: "over temperature",
    8: "magnetic encoder fault",
    16: "stall overload, or Hall encoder",
    32: "not calibrated",
}
VARIANTS = {
    "mini_cheetah": Variant({"mini_cheetah": Ranges(P, 65.0, 18.0)}, {}, reply_bytes=(6, 7), clamps=False),
    "cubemars": Variant(
        {
            "AK80-9": Ranges(P, 50.0, 18.0),
            "AK10-9": Ranges(P, 50.0, 65.0),
            "AK80-6": Ranges(P, 76.0, 12.0),
            "AK80-64": Ranges(P, 8.0, 144.0),
        },
        CUBEMARS_FAULTS,
        reply_bytes=(6, 7, 8),
    ),
    "damiao": Variant(
        {
            "DM4310": Ranges(P, 30.0, 10.0),
            "DM4310_48V": Ranges(P, 50.0, 10.0),
            "DM4340": Ranges(P, 10.0, 28.0),
            "DM6006": Ranges(P, 45.0, 20.0),
            "DM8009": Ranges(P, 45.0, 54.0),
            "DM3507": Ranges(P, 50.0, 5.0),
        },
        DAMIAO_FAULTS,
        silence=13,
    ),
    "robstride": Variant(
        {"rs-02": Ranges(FOUR_PI, 44.0, 17.0), "rs-03": Ranges(FOUR_PI, 50.0, 60.0)}, ROBSTRIDE_FAULTS
    ),
}
"""Variants by `drives.options.variant`."""
