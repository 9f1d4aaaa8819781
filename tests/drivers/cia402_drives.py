"""CiA 402 drives of the tests: a screw of 20 mm, 2^17 counts a turn, 9 N m of rated torque."""

from typing import Any

from drivers.cia402 import kernels
from drivers.cia402.protocol import Cia402Protocol
from drivers.cia402.set_up import Slope
from drivers.config import TransmissionSettings
from drivers.transmission import Transmission

NODES = (1, 2, 3, 4, 5, 6)
COUNTS = 131072
SCREW_m = 0.02
RATED_Nm = 9.0
STEP_m = SCREW_m / COUNTS
PERMILLE_N = 2 * 3.141592653589793 * 1e-3 * RATED_Nm / SCREW_m


def settings(**changes) -> TransmissionSettings:
    return TransmissionSettings(**{
        "lead_m": SCREW_m,
        "counts_per_turn": COUNTS,
        "sign": [1, -1, 1, -1, 1, 1],
        "offset_m": [0.75, 0.75, 0.75, 0.75, 0.75, 0.5],
        **changes,
    })  # fmt: skip


def drives(node_ids=NODES, *, velocity=True, rated_Nm=RATED_Nm, **changes) -> Cia402Protocol:
    transmission = Transmission.of(settings(**changes))
    return Cia402Protocol(
        node_ids, transmission, rated_Nm, force_limit_N=10_000.0, heartbeat_ms=24.0, velocity=velocity
    )


def difference(length: float, t_ns: int, before: Slope, rate: float, period_s: float) -> tuple[float, Slope]:
    """Return the rate at the end of a step and what the next one needs, see `kernels.difference`."""
    has_length = before.length is not None
    given: Any = before
    found, after = kernels.difference(length, t_ns, given, has_length, rate, period_s)
    return found, Slope(*after)
