"""Loops of the compared laws at home, and gains with which all of them cross over at one frequency."""

from collections.abc import Mapping
from math import inf, sqrt
from typing import NamedTuple

import numpy as np

from drivers.errors import ConfigurationError
from hil.app.configuration.configuration import Configuration
from hil.app.stability.command import loop_at_home
from hil.control import ControllerSettings
from hil.study.compare.laws import changed

CLOSE = 1e-4
"""Largest relative difference between crossovers that count as equal."""
STEPS, SLOWER = 40, 1.5
"""Most steps of the search; factor by which gains are lowered until a loop is stable."""


class Loop(NamedTuple):
    """Loop of a law at home, for small errors: observer, delay and drive lag included."""

    crossover_rad_s: float | None
    """Of the fastest axis; None: unknown or unstable."""
    delay_margin_ms: float | None
    """Additional delay at which the loop becomes unstable; None: unlimited, unknown or unstable."""


def loop_of(c: Configuration, settings: ControllerSettings) -> Loop:
    """Loop of a law in a configuration."""
    return Loop(*loop_at_home(changed(c, {"controller": settings})))


def scaled(settings: ControllerSettings, factor: float) -> ControllerSettings:
    """Law with its gains scaled so that its bandwidth changes by a factor."""
    given = {key: (getattr(settings, key), power) for key, power in settings.knob.items()}
    return settings.model_copy(
        update={
            key: (np.asarray(value) * factor**power).tolist()
            for key, (value, power) in given.items()
            if value is not None
        }
    )


def gains(settings: ControllerSettings) -> dict[str, float | list[float] | str]:
    """Gains of a law; of a law with fixed gains all its plain keys."""
    keys = [*settings.knob, "damping_ratio"] if settings.knob else type(settings).model_fields
    values = {key: getattr(settings, key, None) for key in keys if key != "law"}
    return {key: value for key, value in values.items() if isinstance(value, float | int | str | list)}


def equal_crossover(
    c: Configuration, laws: Mapping[str, ControllerSettings]
) -> tuple[float, dict[str, ControllerSettings], dict[str, str]]:
    """Common crossover, rad/s, laws with their gains scaled to it, and remarks on laws that miss it.

    The first law with fixed gains determines the crossover, else the first law. Raises ConfigurationError if
    that law's loop has none.
    """
    first = next((name for name, law in laws.items() if not law.knob), next(iter(laws)))
    target = loop_of(c, laws[first]).crossover_rad_s
    if not target:
        raise ConfigurationError(
            f"--equal-crossover: law {first} determines the crossover, but its loop has none at home "
            "(unstable, switching, or not known): leave it out with --laws"
        )
    found, remarks = dict(laws), {}
    for name, law in laws.items():
        if name == first:
            continue
        if not law.knob:
            remarks[name] = "fixed gains, own crossover"
        elif (other := _with_crossover(c, law, target)) is None:
            remarks[name] = f"no stable loop at {target:.0f} rad/s, gains unchanged"
        else:
            found[name] = other
    return target, found, remarks


def _with_crossover(c: Configuration, law: ControllerSettings, target: float) -> ControllerSettings | None:
    """Law scaled to a crossover, rad/s; None if its loop has none there.

    Secant steps in the logarithm of the factor, within a bracket; an unstable loop is too fast.
    """
    low, high, factor = 0.0, inf, 1.0
    for _ in range(STEPS):
        other = scaled(law, factor)
        w = loop_of(c, other).crossover_rad_s
        if w is not None and abs(w / target - 1.0) < CLOSE:
            return other
        low, high = (factor, high) if w is not None and w < target else (low, factor)
        factor *= target / w if w else 0.0
        if not low < factor < high:
            factor = sqrt(low * high) if low else high / SLOWER
    return None
