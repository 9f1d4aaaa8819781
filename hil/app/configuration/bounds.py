"""Rules between sections of a configuration that are one comparison each: bounds and exclusions.

A rule sees the sections that are valid by themselves. A rule that needs another section is skipped.
"""

from collections.abc import Callable, Iterable, Iterator
from contextlib import suppress
from math import ceil, inf
from pathlib import Path as FilePath
from types import SimpleNamespace
from typing import Any

import numpy as np

from drivers.sensing.kernels import OLDEST
from drivers.sensors import KINDS
from drivers.transmission import forgotten_length
from hil.app.configuration.yaml_positions import Path
from hil.config.reference import LiveReference
from hil.config.running import LoopSettings
from plant_fmu.config import BenchPlant, FmuPlant, PlantSettings, StewartPlant

MOST_STEPS = 10_000
"""Most plant steps in one tick; a simulation with more is too slow."""
Folder = FilePath | None
"""Folder of the configuration file; None: do not read other files."""
Finding = tuple[Path, str]
"""A key, and the problem of its value."""


def step_key(plant: PlantSettings) -> str:
    """Key of the plant's integration step in section `plant.model`, by type of the plant."""
    return "step_us" if isinstance(plant.model, FmuPlant) else "internal_step_us"


def fitted(plant: PlantSettings, loop: LoopSettings) -> PlantSettings:
    """Plant section whose step divides the loop's period; unchanged if the file sets the step."""
    key = step_key(plant)
    if key in plant.model.model_fields_set:
        return plant
    longest_us, period_us = getattr(plant.model, key), 1e6 / loop.rate_Hz
    step_us = period_us / ceil(period_us / longest_us - 1e-9)
    if abs(step_us - longest_us) <= 1e-9 * longest_us:
        return plant
    model = plant.model.model_copy(update={key: step_us})
    return plant.model_copy(update={"model": model})


class MissingSectionError(Exception):
    """A rule needs a section of the configuration that is not valid by itself."""


class Sections(SimpleNamespace):
    """The sections of a configuration that are valid by themselves."""

    def __getattr__(self, name: str) -> Any:
        """Raise MissingSectionError for a section that is not valid by itself."""
        raise MissingSectionError(name)


def bounds(c: Sections, _: Folder) -> Iterator[Finding]:
    """Yield (key, problem) for each value beyond a bound that other keys set."""
    for relation, table in (("at least", AT_LEAST), ("at most", AT_MOST), ("less than", LESS_THAN)):
        for key, (bound_of, what) in table.items():
            with suppress(MissingSectionError):
                for path, value in _values(c, key.split(".")):
                    bound = bound_of(c)
                    fine = {
                        "at least": value >= bound * (1 - 1e-9),
                        "at most": value <= bound * (1 + 1e-9),
                        "less than": value < bound,
                    }
                    if not fine[relation]:
                        yield path, f"{what}, allowed: {relation} {bound:g}, given: {value:g}"


def _values(at: Any, words: list[str], path: Path = ()) -> Iterator[tuple[Path, float]]:
    """Numbers at a key, with their paths; `*` stands for all entries; of a pair of numbers the larger one."""
    if at is None:
        return
    if not words:
        yield path, max(at) if isinstance(at, tuple) else at
        return
    word, *rest = words
    each: Iterable[tuple[str | int, Any]] = [(word, getattr(at, word, None))]
    if word == "*":
        each = enumerate(at) if isinstance(at, list) else at
    for key, value in each:
        yield from _values(value, rest, (*path, key))


def exclusions(c: Sections, _: Folder) -> Iterator[Finding]:
    """Yield (key, problem) for each value that other keys exclude."""
    for key, (wrong, sentence) in EXCLUSIONS.items():
        with suppress(MissingSectionError):
            if wrong(c):
                yield tuple(key.split(".")), sentence.format(c=c)


def _shortest_step_us(c: Sections) -> float:
    return float(1e6 / c.loop.rate_Hz / MOST_STEPS)


def _half_stroke_m(c: Sections) -> float:
    stroke_m = c.platform.length_max_m - c.platform.length_min_m
    return stroke_m / 2 if stroke_m > 0.0 else inf


def _quarter_m(c: Sections) -> float:
    """A quarter of the leg length, m, that belongs to `forgotten_turns` of the drives; inf without homing."""
    homing, gear = c.drives.homing, c.drives.transmission
    if homing is None or gear is None:
        return inf
    return 0.25 * float(np.min(forgotten_length(gear, homing.forgotten_turns)))


_STEPS = f"more than {MOST_STEPS} steps in each tick"
Bounds = dict[str, tuple[Callable[[Sections], float], str]]
"""Dotted key -> bound, and problem beyond it. * is each entry of a list, or each key of a section."""
AT_LEAST: Bounds = {
    "drives.watchdog_ms": (lambda c: 3e3 / c.loop.rate_Hz, "shorter than three periods of loop.rate_Hz"),
    "limits.standstill_m": (
        lambda c: 0.0 if c.plant is None else 4 * c.plant.drives.encoder_resolution_m,
        "too close to the resolution of the encoders, 4 x plant.drives.encoder_resolution_m",
    ),
    "sensors.tracker.latency_max_ms": (
        lambda c: getattr(c.sensors.tracker.device, "latency_ms", 0.0),
        "shorter than the latency of the device, sensors.tracker.device.latency_ms",
    ),
    "plant.model.step_us": (_shortest_step_us, _STEPS),
    "plant.model.internal_step_us": (_shortest_step_us, _STEPS),
}
AT_MOST: Bounds = {
    "limits.force_N": (
        lambda c: c.drives.force_limit_N,
        "above the drives' rated force, drives.force_limit_N",
    ),
    **{
        f"sensors.{role}.rate_Hz": (lambda c: c.loop.rate_Hz, "more than one sample a tick of loop.rate_Hz")
        for role in ("tracker", "imu", "wrench")
    },
    "sensors.tracker.latency_max_ms": (
        lambda c: 1e3 * (OLDEST - 1) / c.loop.rate_Hz,
        f"older than a time stamp can express, {OLDEST - 1} ticks of loop.rate_Hz",
    ),
    "plant.drives.brake_open_ms": (
        lambda c: 1e3 * c.engage.brake_release_s,
        "longer than the controller waits for its brakes, engage.brake_release_s",
    ),
    "plant.drives.brake_close_ms": (
        lambda c: 1e3 * c.engage.closing_s,
        "longer than the controller waits for its brakes, engage.brake_close_s, by default brake_release_s",
    ),
    "reference.components.*.frequency_Hz": (
        lambda c: c.loop.rate_Hz / 2,
        "above half the rate, where sampling changes the frequency (Shannon, 1949)",
    ),
    "reference.axes.*.band_Hz": (lambda c: c.loop.rate_Hz / 2, "above half the rate"),
}
LESS_THAN: Bounds = {
    "loop.feedback_window_us": (lambda c: 1e6 / c.loop.rate_Hz, "not shorter than the period"),
    "platform.length_min_m": (lambda c: c.platform.length_max_m, "not below platform.length_max_m"),
    "limits.stroke_margin_m": (_half_stroke_m, "leaves no stroke between the soft ends"),
    "drives.homing.limit_m": (
        _quarter_m,
        "not below a quarter of the length of drives.homing.forgotten_turns",
    ),
}

EXCLUSIONS: dict[str, tuple[Callable[[Sections], object], str]] = {
    "estimation.fusion.may_lose_legs": (
        lambda c: (
            c.estimation.fusion.may_lose_legs and (c.estimation.pose != "fused" or c.sensors.tracker is None)
        ),
        (
            "five legs alone do not determine the pose, allowed: none, or estimation.pose fused with "
            "sensors.tracker, given: {c.estimation.fusion.may_lose_legs}"
        ),
    ),
    "estimation.pose": (
        lambda c: (c.estimation.pose, c.drives.protocol, c.bus.layout) == ("fused", "legs", "classic"),
        "fused needs the drives' forces, which layout classic of protocol legs lacks, allowed there: legs",
    ),
    "sensors.imu": (
        lambda c: (
            c.estimation.pose == "fused"
            and c.sensors.imu is not None
            and len(getattr(c.sensors.imu.device, "signals", range(6))) < 6
        ),
        "estimation.pose fused needs angular rate and specific force, allowed with fewer signals: legs",
    ),
    "estimation.wrench.source": (
        lambda c: c.estimation.wrench.source == "sensor" and c.sensors.wrench is None,
        "no sensors.wrench is configured, allowed without it: none, observer, given: sensor",
    ),
    "estimation.wrench.forces": (
        lambda c: (
            c.estimation.wrench.forces == "sensors"
            and (c.sensors.forces is None or c.estimation.wrench.source != "observer")
        ),
        "sensors needs sensors.forces and estimation.wrench.source observer, allowed without them: sent",
    ),
    "controller.delay_compensation": (
        lambda c: isinstance(c.reference, LiveReference) and c.controller.lookahead is not None,
        "looks ahead along a path, but a live reference has no path: leave it out",
    ),
    "feedforward": (
        lambda c: isinstance(c.reference, LiveReference) and c.feedforward is not None,
        "was learned on a path, but a live reference has no path: leave it out",
    ),
    "plant.model.type": (
        lambda c: (
            c.plant is not None
            and not isinstance(c.plant.model, StewartPlant)
            and any(
                getattr(c.sensors, kind) is not None for kind in KINDS if kind not in ("lengths", "forces")
            )
        ),
        "has no pose to measure, allowed with section sensors: stewart, given: {c.plant.model.type}",
    ),
    "plant.drives.force_bandwidth_Hz": (
        lambda c: (
            c.plant is not None
            and isinstance(c.plant.model, StewartPlant)
            and c.plant.drives.force_bandwidth_Hz > 0
        ),
        "plant type stewart includes this lag, allowed: 0, given: {c.plant.drives.force_bandwidth_Hz:g}",
    ),
    "plant.model.rest_length_m": (
        lambda c: (
            c.plant is not None
            and isinstance(c.plant.model, BenchPlant)
            and not c.platform.length_min_m < c.plant.model.rest_length_m < c.platform.length_max_m
        ),
        (
            "outside the stroke, allowed: {c.platform.length_min_m:g} to {c.platform.length_max_m:g} m, "
            "given: {c.plant.model.rest_length_m:g}"
        ),
    ),
    "plant.drives.fmu": (
        lambda c: (
            c.plant is not None
            and c.plant.drives.fmu is not None
            and (bool(c.bus.channels) or any(getattr(c.sensors, kind) is not None for kind in KINDS))
        ),
        "CAN FMUs as drives: allowed: one bus, no section sensors; leave out bus.channels and sensors",
    ),
    "drives.homing": (
        lambda c: c.drives.homing is not None and c.drives.transmission is None,
        "drives.protocol {c.drives.protocol} reports leg lengths and needs no homing; leave it out",
    ),
}
"""Key -> condition under which other keys exclude its value, and message with fields of the configuration
`c`."""
