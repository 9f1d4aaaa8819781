"""How large a fault of the matrix is: a sensible size of each kind, or one that is drawn from its range."""

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from drivers.arrays import Array
from hil.app.configuration.configuration import Configuration
from hil.app.configuration.platform import build_platform, pose_arrays
from hil.robot.dynamics import Model
from plant_fmu.config import StewartPlant

Chance = np.random.Generator


class Robot(NamedTuple):
    """What sizes depend on."""

    c: Configuration
    static_N: Array
    """(6,) N, forces of the legs at home, without their signs."""
    weight_N: float
    period_ms: float


class Size(NamedTuple):
    """The size of a kind of fault."""

    usual: Callable[[Robot, int], dict[str, Any]]
    """Return its keys for a leg."""
    drawn: Callable[[Robot, int, Chance], dict[str, Any]]
    """Return them from the range of the kind, with either sign where it has one."""


def robot_of(c: Configuration) -> Robot:
    """Return what the sizes of a configuration depend on."""
    platform = build_platform(c.platform)
    home, still = pose_arrays(c.platform.home), np.zeros(6)
    tau = Model(platform, leg_spin=c.platform.leg_spin).inverse_dynamics(*home, still, still)
    weight = c.platform.platform.mass_kg * float(np.linalg.norm(c.platform.gravity_m_s2))
    return Robot(c, np.abs(tau), weight, 1e3 / c.loop.rate_Hz)


def _between(chance: Chance, low: float, high: float) -> float:
    """Draw a number whose logarithm is uniform: small ones as often as large ones."""
    return float(np.exp(chance.uniform(np.log(low), np.log(high))))


def _within(chance: Chance, low: float, high: float) -> float:
    return float(chance.uniform(low, high))


def _signed(chance: Chance, low: float, high: float) -> float:
    return float(chance.choice((-1.0, 1.0))) * _between(chance, low, high)


def _share(r: Robot, leg: int, of_need: float) -> dict[str, Any]:
    """Return the share of a brake's force that is so much of what the leg needs to stand."""
    assert r.c.plant is not None
    model = r.c.plant.model
    whole = model.brake_force_N if isinstance(model, StewartPlant) else r.c.drives.force_limit_N
    return {"share": min(1.0, of_need * float(r.static_N[leg]) / whole)}


def _most_N(r: Robot, leg: int, of_need: float) -> dict[str, Any]:
    """Return a limit of a drive's force; without a load a share of the rated force."""
    return {"limit_N": of_need * float(r.static_N[leg]) or 0.02 * r.c.drives.force_limit_N}


def _push(r: Robot, chance: Chance) -> dict[str, Any]:
    """Draw a force from any direction."""
    way = chance.standard_normal(3)
    force = way / np.linalg.norm(way) * r.weight_N * _between(chance, 0.02, 0.25)
    return {"force_N": tuple(force.tolist())}


def _payload(r: Robot, of_mass: float, position_m: tuple[float, float, float]) -> dict[str, Any]:
    return {"mass_kg": of_mass * r.c.platform.platform.mass_kg, "position_m": position_m}


def _place(chance: Chance) -> tuple[float, float, float]:
    return _within(chance, -0.2, 0.2), _within(chance, -0.2, 0.2), 0.2


def _probability(low: float, high: float) -> Callable[[Robot, int, Chance], dict[str, Any]]:
    return lambda _r, _leg, chance: {"probability": _within(chance, low, high)}


SIZES: dict[str, Size] = {
    "encoder_jump": Size(
        lambda _r, _leg: {"by_m": 5e-3}, lambda _r, _leg, chance: {"by_m": _signed(chance, 1e-3, 0.5)}
    ),
    "encoder_drift": Size(
        lambda _r, _leg: {"by_m_s": 5e-3}, lambda _r, _leg, chance: {"by_m_s": _signed(chance, 5e-4, 0.02)}
    ),
    "encoder_noise": Size(
        lambda _r, _leg: {"sigma_m": 1e-4}, lambda _r, _leg, chance: {"sigma_m": _between(chance, 1e-6, 1e-3)}
    ),
    "encoder_late": Size(
        lambda r, _leg: {"by_ms": r.period_ms},
        lambda r, _leg, chance: {"by_ms": r.period_ms * _within(chance, 0.2, 2.0)},
    ),
    "encoder_scale": Size(
        lambda _r, _leg: {"factor": 1.01},
        lambda _r, _leg, chance: {"factor": 1.0 + _signed(chance, 1e-2, 0.05)},
    ),
    "drive_gain": Size(
        lambda _r, _leg: {"factor": 0.5}, lambda _r, _leg, chance: {"factor": _within(chance, 0.0, 2.0)}
    ),
    "drive_saturation": Size(
        lambda r, leg: _most_N(r, leg, 0.5),
        lambda r, leg, chance: _most_N(r, leg, _between(chance, 0.1, 1.0)),
    ),
    "brake_slow": Size(
        lambda _r, _leg: {"by_ms": 200.0}, lambda _r, _leg, chance: {"by_ms": _between(chance, 10.0, 500.0)}
    ),
    "brake_slipping": Size(
        lambda r, leg: _share(r, leg, 0.5), lambda r, leg, chance: _share(r, leg, _within(chance, 0.0, 1.0))
    ),
    "frames_loss": Size(lambda _r, _leg: {"probability": 0.3}, _probability(0.01, 1.0)),
    "frames_duplicate": Size(lambda _r, _leg: {}, _probability(0.1, 1.0)),
    "frames_delay": Size(
        lambda r, _leg: {"by_ms": 2.0 * r.period_ms},
        lambda r, _leg, chance: {"by_ms": r.period_ms * _between(chance, 0.2, 5.0)},
    ),
    "frames_reorder": Size(lambda _r, _leg: {"probability": 0.5}, _probability(0.05, 1.0)),
    "frames_corrupt": Size(lambda _r, _leg: {"probability": 0.3}, _probability(0.01, 1.0)),
    "frames_old": Size(lambda _r, _leg: {}, lambda _r, _leg, chance: {"back": int(chance.integers(1, 20))}),
    "frames_forged_command": Size(
        lambda r, _leg: {"force_N": 0.1 * r.c.drives.force_limit_N},
        lambda r, _leg, chance: {"force_N": r.c.drives.force_limit_N * _signed(chance, 0.01, 0.2)},
    ),
    "frames_forged_feedback": Size(
        lambda _r, _leg: {"by_m": 5e-3}, lambda _r, _leg, chance: {"by_m": _signed(chance, 1e-3, 0.5)}
    ),
    "bus_second_controller": Size(
        lambda r, _leg: {"rate_Hz": r.c.loop.rate_Hz},
        lambda r, _leg, chance: {
            "rate_Hz": r.c.loop.rate_Hz,
            "force_N": r.c.drives.force_limit_N * _signed(chance, 0.01, 0.2),
        },
    ),
    "wrench_step": Size(
        lambda r, _leg: {"force_N": (0.0, 0.0, -0.25 * r.weight_N)}, lambda r, _leg, chance: _push(r, chance)
    ),
    "payload_step": Size(
        lambda r, _leg: _payload(r, 0.2, (0.2, 0.0, 0.2)),
        lambda r, _leg, chance: _payload(r, _between(chance, 0.02, 0.2), _place(chance)),
    ),
}
"""Of the kinds that have a size and not only a default."""


def draw(kind: str, r: Robot, leg: int, chance: Chance) -> dict[str, Any]:
    """Return keys of a kind drawn from its range, to four digits: its words give them whole."""
    drawn = SIZES[kind].drawn(r, leg, chance) if kind in SIZES else {}
    return {key: _rounded(value) for key, value in drawn.items()}


def _rounded(value: Any) -> Any:
    if isinstance(value, tuple):
        return tuple(map(_rounded, value))
    return float(f"{value:.4g}") if isinstance(value, float) else value
