"""Sizes of the faults that `hil faults` injects: the usual size of each kind, or one drawn from a range."""

from collections.abc import Callable
from math import isfinite
from typing import Any, NamedTuple

import numpy as np

from drivers.arrays import Array
from drivers.sensors import KINDS
from hil.app.configuration.configuration import Configuration
from hil.app.configuration.platform import build_platform, pose_arrays
from hil.robot.dynamics import Model
from plant_fmu.config import StewartPlant

Chance = np.random.Generator


class Robot(NamedTuple):
    """Properties of the robot on which the sizes of injected faults depend."""

    c: Configuration
    static_N: Array
    """(6,) N, magnitudes of the leg forces at rest at home."""
    weight_N: float
    period_ms: float

    @property
    def rated_N(self) -> float:
        """Rated force of a drive, N."""
        return self.c.drives.force_limit_N


def robot_of(c: Configuration) -> Robot:
    """Properties of a configuration's robot on which the sizes of injected faults depend."""
    platform = build_platform(c.platform)
    home, still = pose_arrays(c.platform.home), np.zeros(6)
    tau = Model(platform, leg_spin=c.platform.leg_spin).inverse_dynamics(*home, still, still)
    weight = c.platform.platform.mass_kg * float(np.linalg.norm(c.platform.gravity_m_s2))
    return Robot(c, np.abs(tau), weight, 1e3 / c.loop.rate_Hz)


def sensor_of(c: Configuration, leg: int) -> tuple[str, float]:
    """Name of the first configured sensor, that of a leg if each has one, and its standard deviation, SI."""
    of_leg = {"lengths": f"length_{leg}", "forces": f"force_{leg}"}
    role = next(role for role in (*of_leg, *KINDS) if getattr(c.sensors, role) is not None)
    std = getattr(c.sensors, role).std[0]
    return of_leg.get(role, role), std if isfinite(std) else 1.0


def _log(chance: Chance, low: float, high: float) -> float:
    """Draw a number in [low, high] whose logarithm is uniformly distributed."""
    return float(np.exp(chance.uniform(np.log(low), np.log(high))))


def _signed(chance: Chance, low: float, high: float) -> float:
    return float(chance.choice((-1.0, 1.0))) * _log(chance, low, high)


def _whole(chance: Chance, low: float, high: float) -> int:
    return int(chance.integers(int(low), int(high)))


def _of_brake(r: Robot, leg: int, of_need: float) -> float:
    """Share, at most 1, of a brake's force that is `of_need` times the leg force at rest at home."""
    assert r.c.plant is not None
    model = r.c.plant.model
    whole = model.brake_force_N if isinstance(model, StewartPlant) else r.rated_N
    return min(1.0, of_need * float(r.static_N[leg]) / whole)


class Size(NamedTuple):
    """Size of a kind of fault with one key: usual value, range, and conversion to the key's unit."""

    key: str
    usual: float | None
    """None: default of the kind."""
    draw: Callable[[Chance, float, float], float]
    low: float
    high: float
    of: Callable[[Robot, int, float], float] = lambda _r, _leg, x: x
    """Robot, leg, number -> value of the key."""


_PERIODS: Callable[[Robot, int, float], float] = lambda r, _leg, x: r.period_ms * x  # noqa: E731
_RATED: Callable[[Robot, int, float], float] = lambda r, _leg, x: r.rated_N * x  # noqa: E731
_OF_STD: Callable[[Robot, int, float], float] = lambda r, leg, x: sensor_of(r.c, leg)[1] * x  # noqa: E731
SIZES: dict[str, Size] = {
    "encoder_jump": Size("by_m", 5e-3, _signed, 1e-3, 0.5),
    "encoder_drift": Size("by_m_s", 5e-3, _signed, 5e-4, 0.02),
    "encoder_noise": Size("sigma_m", 1e-4, _log, 1e-6, 1e-3),
    "encoder_late": Size("by_ms", 1.0, Chance.uniform, 0.2, 2.0, _PERIODS),
    "encoder_scale": Size("factor", 0.01, _signed, 1e-2, 0.05, lambda _r, _leg, x: 1.0 + x),
    "drive_gain": Size("factor", 0.5, Chance.uniform, 0.0, 2.0),
    # without a load a share of the rated force
    "drive_saturation": Size(
        "limit_N", 0.5, _log, 0.1, 1.0, lambda r, leg, x: x * float(r.static_N[leg]) or 0.02 * r.rated_N
    ),
    "brake_slow": Size("by_ms", 200.0, _log, 10.0, 500.0),
    "brake_slipping": Size("share", 0.5, Chance.uniform, 0.0, 1.0, _of_brake),
    "frames_loss": Size("probability", 0.3, Chance.uniform, 0.01, 1.0),
    "frames_duplicate": Size("probability", None, Chance.uniform, 0.1, 1.0),
    "frames_delay": Size("by_ms", 2.0, _log, 0.2, 5.0, _PERIODS),
    "frames_reorder": Size("probability", 0.5, Chance.uniform, 0.05, 1.0),
    "frames_corrupt": Size("probability", 0.3, Chance.uniform, 0.01, 1.0),
    "frames_old": Size("back", None, _whole, 1, 20),
    "frames_forged_command": Size("force_N", 0.1, _signed, 0.01, 0.2, _RATED),
    "frames_forged_feedback": Size("by_m", 5e-3, _signed, 1e-3, 0.5),
    "bus_second_controller": Size("force_N", None, _signed, 0.01, 0.2, _RATED),
    "sensor_late": Size("by_ms", 5.0, _log, 0.5, 20.0, _PERIODS),
    "sensor_offset": Size("by", 50.0, _signed, 5.0, 100.0, _OF_STD),
    "sensor_drift": Size("by", 50.0, _signed, 5.0, 100.0, _OF_STD),
    "sensor_outlier": Size("by", 100.0, _signed, 20.0, 1000.0, _OF_STD),
}
"""Kinds with one number; loads and a second controller have more."""


def size_of(kind: str, r: Robot, leg: int, chance: Chance | None) -> dict[str, Any]:
    """Keys of an injected fault's size; values drawn with `chance` have four digits, exact in its text."""
    found: dict[str, Any] = {"rate_Hz": r.c.loop.rate_Hz} if kind == "bus_second_controller" else {}
    if kind == "wrench_step":  # along gravity, or in any direction
        force = 0.25 * r.c.platform.platform.mass_kg * np.array(r.c.platform.gravity_m_s2)
        if chance is not None:
            way = chance.standard_normal(3)
            force = way / np.linalg.norm(way) * r.weight_N * _log(chance, 0.02, 0.25)
        found["force_N"] = tuple(force.tolist())
    elif kind == "payload_step":
        of_mass, x, y = 0.2, 0.2, 0.0
        if chance is not None:
            of_mass = _log(chance, 0.02, 0.2)
            x, y = chance.uniform(-0.2, 0.2, 2).tolist()
        found = {"mass_kg": of_mass * r.c.platform.platform.mass_kg, "position_m": (x, y, 0.2)}
    elif kind in SIZES:
        size = SIZES[kind]
        number = size.usual if chance is None else size.draw(chance, size.low, size.high)
        found |= {} if number is None else {size.key: size.of(r, leg, number)}
    return found if chance is None else {key: _rounded(value) for key, value in found.items()}


def _rounded(value: Any) -> Any:
    if isinstance(value, tuple):
        return tuple(map(_rounded, value))
    return float(f"{value:.4g}") if isinstance(value, float) else value
