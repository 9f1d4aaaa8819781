"""Cases of `hil faults`: each kind of fault at each moment of a run."""

from collections.abc import Iterator, Sequence
from fnmatch import fnmatchcase
from typing import Any, NamedTuple
from zlib import crc32

import numpy as np

from drivers.errors import ConfigurationError
from drivers.sensors import KINDS
from drivers.signals import LEGS
from hil.app.configuration.configuration import Configuration
from hil.app.configuration.fault_rules import without_effect
from hil.app.configuration.fault_words import show_fault
from hil.app.configuration.platform import build_platform
from hil.app.reachability import span_s
from hil.config.reference import HoldReference, LiveReference
from hil.robot.kinematics import jacobian
from hil.study.faults.sizes import Robot, robot_of, sensor_of, size_of
from hil.trajectory.build import build_trajectory
from plant_fmu.config import BenchPlant
from plant_fmu.faults import FAULTS
from plant_fmu.faults.fault import Fault, Moment
from plant_fmu.faults.kinds import PROCESS

MATRIX: tuple[Moment, ...] = ("LOADING", "APPROACH", "TRACKING", "HOLD", "PARKING", "UNLOADING")
"""Moments at which each fault is injected."""
LEG = 2
"""Default leg of a fault that affects one leg."""
SEARCHED_S = 3.0
"""Length, s, of the part of the reference that is searched for its fastest instant."""
AFTER_S = 0.8
"""Time, s, from a fault that causes no reaction to the stop of the run."""
_BENCH = ("drive_", "frames_")
"""Prefixes of the kinds for six legs without a platform."""


class Case(NamedTuple):
    """One simulated run of `hil faults`, with one injected fault."""

    configuration: Configuration
    fault: Fault
    moment: Moment
    track_s: float
    """Time along the reference at which the run is stopped."""

    @property
    def name(self) -> str:
        """Name of the case, `KIND/MOMENT`, which the patterns of --only match."""
        return f"{self.fault.kind}/{self.moment}"

    @property
    def given(self) -> str:
        """Leg and size of the injected fault as text; empty for a kind without both."""
        plain = self.fault.model_copy(update={"mode": None, "at_s": 0.0})
        return show_fault(plain).partition(" ")[2]


def cases(
    c: Configuration, only: Sequence[str] = (), legs: Sequence[int] = (), seed: int | None = None
) -> list[Case]:
    """Cases of `hil faults` for a configuration; with `only`, those that match one of its patterns.

    legs : legs for the kinds that affect one leg, a case for each; default LEG. seed : draws leg (of `legs`,
    by default of all six), size and sign of each case; None: usual sizes. Raises ConfigurationError: a
    pattern without a match, a leg that does not exist, or a reference that waits for set-points.
    """
    if isinstance(c.reference, LiveReference):
        raise ConfigurationError(
            f"{c.source}: reference: type live waits for set-points, but the matrix needs a fixed path; "
            "allowed: any other type"
        )
    for leg in legs:
        if not 0 <= leg < LEGS:
            raise ConfigurationError(f"--legs: unknown leg {leg}, allowed: 0 to {LEGS - 1}")
    robot, fastest_s, held = robot_of(c), _fastest_s(c), _held(c)
    offsets = {
        "LOADING": 0.5 * c.engage.force_ramp_s,
        "APPROACH": 0.25 * c.engage.blend_s,
        "TRACKING": fastest_s,
        "UNLOADING": 0.25 * c.engage.force_ramp_s,
    }  # in the midst of a brake test or a move
    found = []
    for name, kind in FAULTS.items():
        if issubclass(kind, PROCESS) or not _fits(c, name):
            continue
        for moment in MATRIX:
            for size in _sizes(robot, name, moment, legs, seed):
                fault = kind(kind=name, mode=moment, at_s=offsets.get(moment, 0.0), **size)
                if moment == "HOLD":
                    found.append(Case(held, fault, moment, AFTER_S))
                    continue
                track_s = fastest_s + (AFTER_S if moment == "TRACKING" else 0.0)
                found.append(Case(c, fault, moment, track_s))
    return _chosen(found, only)


def _sizes(
    r: Robot, name: str, moment: Moment, legs: Sequence[int], seed: int | None
) -> Iterator[dict[str, Any]]:
    """Yield leg and size of a kind of fault, once per leg of `legs`; with a seed, one random draw."""
    fields = FAULTS[name].model_fields
    chance = None if seed is None else np.random.default_rng((seed, crc32(f"{name}/{moment}".encode())))
    whose = legs if legs and "leg" in fields else (LEG,)
    for leg in whose if chance is None else [int(chance.choice(legs or range(LEGS)))]:
        size = ({"leg": leg} if "leg" in fields else {}) | size_of(name, r, leg, chance)
        if "sensor" in fields:
            size["sensor"] = sensor_of(r.c, leg)[0]
        if chance is not None and "seed" in fields:
            size["seed"] = int(chance.integers(1 << 31))
        yield size


def _chosen(found: list[Case], only: Sequence[str]) -> list[Case]:
    for pattern in only:
        if not any(_matches(case, pattern) for case in found):
            kinds = dict.fromkeys(str(case.fault.kind) for case in found)
            raise ConfigurationError(
                f"--only {pattern}: matches no case; allowed: patterns of KIND or KIND/MOMENT, the kinds are "
                f"{', '.join(kinds)}, the moments {', '.join(MATRIX)}"
            )
    return [case for case in found if not only or any(_matches(case, pattern) for pattern in only)]


def _matches(case: Case, pattern: str) -> bool:
    return fnmatchcase(case.name if "/" in pattern else str(case.fault.kind), pattern)


def _fits(c: Configuration, name: str) -> bool:
    assert c.plant is not None
    if isinstance(c.plant.model, BenchPlant) and not name.startswith(_BENCH):
        return False
    if name.startswith("sensor_") and not any(getattr(c.sensors, role) for role in KINDS):
        return False
    return not without_effect(c.plant, name)


def _held(c: Configuration) -> Configuration:
    """Configuration whose reference rests at home until the run is stopped.

    The reference has an end, because some laws need one. Learned feed-forward belongs to another reference
    and is removed.
    """
    hold = HoldReference(type="hold", duration_s=AFTER_S + c.engage.stop_s)
    return c.model_copy(update={"reference": hold, "feedforward": None})


def _fastest_s(c: Configuration) -> float:
    """Time, s, of the fastest leg motion within the first SEARCHED_S of the reference."""
    trajectory, platform = (
        build_trajectory(c.reference, c.platform.home, c.folder),
        build_platform(c.platform),
    )
    times = np.arange(0.0, min(SEARCHED_S, span_s(trajectory) or SEARCHED_S), 0.02)
    samples = [trajectory.sample(t) for t in times.tolist()]
    speeds = [float(np.abs(jacobian(platform, s.p, s.R) @ s.twist).max()) for s in samples]
    return float(times[int(np.argmax(speeds))])
