"""Rules between sections of a configuration that are one comparison each: bounds and exclusions.

A rule sees the sections that are valid by themselves; one that needs another says nothing.
"""

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from math import inf
from pathlib import Path as FilePath
from types import SimpleNamespace
from typing import Any, Literal

import numpy as np

from drivers.sensor_kernels import OLDEST
from drivers.sensors import KINDS
from drivers.transmission import forgotten_length
from hil.app.configuration.plant_step import MOST_STEPS
from hil.app.configuration.yaml_positions import Path
from hil.config.reference import LiveReference
from plant_fmu.config import BenchPlant, StewartPlant

Folder = FilePath | None
"""Folder of the configuration file; None: do not look at other files."""
Finding = tuple[Path, str]
"""A key, and what is wrong with its value."""


class MissingSectionError(Exception):
    """A rule needs a section that is not valid by itself."""


class Sections(SimpleNamespace):
    """The sections of a configuration that are valid by themselves."""

    def __getattr__(self, name: str) -> Any:
        """Raise MissingSectionError."""
        raise MissingSectionError(name)


@dataclass(frozen=True)
class Bound:
    """A value that other keys bound."""

    key: str
    """Dotted; * is each entry of a list, or each key of a section. What is not there is within bounds."""
    relation: Literal["at least", "at most", "less than"]
    bound: Callable[[Sections], float]
    what: str

    def __call__(self, c: Sections, _: Folder) -> Iterator[Finding]:
        """Yield the values beyond their bound."""
        for path, value in _values(c, self.key.split(".")):
            bound = self.bound(c)
            fine = {
                "at least": value >= bound * (1 - 1e-9),
                "at most": value <= bound * (1 + 1e-9),
                "less than": value < bound,
            }
            if not fine[self.relation]:
                yield path, f"{self.what}, allowed: {self.relation} {bound:g}, given: {value:g}"


def _values(at: Any, words: list[str], path: Path = ()) -> Iterator[tuple[Path, float]]:
    """Yield the numbers at a key, with their paths; of a list of two numbers the larger one."""
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


@dataclass(frozen=True)
class Exclusion:
    """A value that other keys rule out."""

    path: Path
    wrong: Callable[[Sections], object]
    sentence: str
    """May name the configuration `c`."""

    def __call__(self, c: Sections, _: Folder) -> Iterator[Finding]:
        """Yield the sentence where the value is ruled out."""
        if self.wrong(c):
            yield self.path, self.sentence.format(c=c)


def _shortest_step_us(c: Sections) -> float:
    return float(1e6 / c.loop.rate_Hz / MOST_STEPS)


def _half_stroke_m(c: Sections) -> float:
    stroke_m = c.platform.length_max_m - c.platform.length_min_m
    return stroke_m / 2 if stroke_m > 0.0 else inf


def _quarter_m(c: Sections) -> float:
    """Return a quarter of the leg length that turns which a drive forgets are."""
    homing, gear = c.drives.homing, c.drives.transmission
    if homing is None or gear is None:
        return inf
    return 0.25 * float(np.min(forgotten_length(gear, homing.forgotten_turns)))


BOUNDS = (
    Bound(
        "drives.watchdog_ms",
        "at least",
        lambda c: 3e3 / c.loop.rate_Hz,
        "shorter than three periods of loop.rate_Hz",
    ),
    Bound(
        "limits.force_N",
        "at most",
        lambda c: c.drives.force_limit_N,
        "above the drives' rated force, drives.force_limit_N",
    ),
    Bound(
        "loop.feedback_window_us", "less than", lambda c: 1e6 / c.loop.rate_Hz, "not shorter than the period"
    ),
    Bound(
        "sensors.*.rate_Hz",
        "at most",
        lambda c: c.loop.rate_Hz,
        "more than one sample a tick of loop.rate_Hz",
    ),
    Bound(
        "sensors.tracker.latency_max_ms",
        "at most",
        lambda c: 1e3 * (OLDEST - 1) / c.loop.rate_Hz,
        f"older than a stamp can tell, {OLDEST - 1} ticks of loop.rate_Hz",
    ),
    Bound(
        "platform.length_min_m",
        "less than",
        lambda c: c.platform.length_max_m,
        "not below platform.length_max_m",
    ),
    Bound(
        "limits.stroke_margin_m",
        "less than",
        _half_stroke_m,
        "leaves no stroke between the soft ends",
    ),
    Bound(
        "plant.drives.brake_open_ms",
        "at most",
        lambda c: 1e3 * c.engage.brake_release_s,
        "longer than the controller waits for its brakes, engage.brake_release_s",
    ),
    Bound(
        "plant.drives.brake_close_ms",
        "at most",
        lambda c: 1e3 * c.engage.closing_s,
        "longer than the controller waits for its brakes, engage.brake_close_s, by default brake_release_s",
    ),
    Bound(
        "limits.standstill_m",
        "at least",
        lambda c: 0.0 if c.plant is None else 4 * c.plant.drives.encoder_resolution_m,
        "too near to the resolution of the encoders, 4 x plant.drives.encoder_resolution_m",
    ),
    Bound(
        "reference.components.*.frequency_Hz",
        "at most",
        lambda c: c.loop.rate_Hz / 2,
        "above half the rate, where legs follow another frequency (Shannon, 1949)",
    ),
    Bound("reference.axes.*.band_Hz", "at most", lambda c: c.loop.rate_Hz / 2, "above half the rate"),
    Bound("drives.homing.limit_m", "less than", _quarter_m, "a quarter of what forgotten_turns are, or more"),
    Bound("plant.model.step_us", "at least", _shortest_step_us, f"more than {MOST_STEPS} steps in each tick"),
    Bound(
        "plant.model.internal_step_us",
        "at least",
        _shortest_step_us,
        f"more than {MOST_STEPS} steps in each tick",
    ),
)

EXCLUSIONS = (
    Exclusion(
        ("estimation", "fusion", "may_lose_legs"),
        lambda c: (
            c.estimation.fusion.may_lose_legs and (c.estimation.pose != "fused" or c.sensors.tracker is None)
        ),
        "without the pose from outside five legs do not hold the platform's pose, allowed: none, or "
        "estimation.pose fused with sensors.tracker, given: {c.estimation.fusion.may_lose_legs}",
    ),
    Exclusion(
        ("estimation", "pose"),
        lambda c: c.estimation.pose == "fused" and c.bus.layout == "classic",
        "the filter needs the drives' forces, and the feedback of bus.layout classic carries none, allowed "
        "with it: legs, given: fused",
    ),
    Exclusion(
        ("estimation", "wrench", "source"),
        lambda c: c.estimation.wrench.source == "sensor" and c.sensors.wrench is None,
        "there is no sensors.wrench, allowed without it: none, observer, given: sensor",
    ),
    Exclusion(
        ("controller", "delay_compensation"),
        lambda c: isinstance(c.reference, LiveReference) and c.controller.lookahead is not None,
        "looks ahead along the reference, and where set-points will send a live one is not known, "
        "allowed with reference.type live: leave it out",
    ),
    Exclusion(
        ("feedforward",),
        lambda c: isinstance(c.reference, LiveReference) and c.feedforward is not None,
        "where set-points will send a live reference is not known, allowed with it: leave it out",
    ),
    Exclusion(
        ("plant", "model", "type"),
        lambda c: (
            c.plant is not None
            and not isinstance(c.plant.model, StewartPlant)
            and any(getattr(c.sensors, kind) is not None for kind in KINDS)
        ),
        "knows no pose that section sensors could measure, allowed with sensors: stewart, given: "
        "{c.plant.model.type}",
    ),
    Exclusion(
        ("plant", "drives", "force_bandwidth_Hz"),
        lambda c: (
            c.plant is not None
            and isinstance(c.plant.model, StewartPlant)
            and c.plant.drives.force_bandwidth_Hz > 0
        ),
        "the lag would act twice, allowed: 0 for plant type stewart (the FMU has its own), given: "
        "{c.plant.drives.force_bandwidth_Hz:g}",
    ),
    Exclusion(
        ("plant", "model", "rest_length_m"),
        lambda c: (
            c.plant is not None
            and isinstance(c.plant.model, BenchPlant)
            and not c.platform.length_min_m < c.plant.model.rest_length_m < c.platform.length_max_m
        ),
        "outside the stroke, allowed: between {c.platform.length_min_m:g} and {c.platform.length_max_m:g} "
        "(platform), given: {c.plant.model.rest_length_m:g}",
    ),
    Exclusion(
        ("drives", "homing"),
        lambda c: c.drives.homing is not None and c.drives.transmission is None,
        "drives.protocol {c.drives.protocol} speaks of leg lengths, and forgets none; leave it out",
    ),
)
