"""From the unit cube to values: quasi-Monte Carlo points, and the inverse of each axis' distribution.

Sobol' points are scrambled (Owen 1995), so that none of them is exactly 0 or 1 by construction; they are
balanced where their number is a power of two.
"""

from math import exp, floor, log
from typing import Any

import numpy as np

from drivers.arrays import Array
from hil.study.campaign.settings import Sample, SampledAxis, entries


def draw(sample: Sample) -> list[tuple[Any, ...]]:
    """Return the values of every sample, one an axis in the order of the file."""
    axes = list(sample.axes.values())
    return [
        tuple(value_at(axis, u) for axis, u in zip(axes, point, strict=True))
        for point in _points(sample, len(axes)).tolist()
    ]


def _points(sample: Sample, dimensions: int) -> Array:
    """Return (count, dimensions) points of [0, 1)."""
    from scipy.stats import qmc  # noqa: PLC0415 - most of a second, for who samples

    engines = {"sobol": qmc.Sobol, "latin_hypercube": qmc.LatinHypercube, "halton": qmc.Halton}
    engine = engines[sample.method](dimensions, seed=np.random.default_rng(sample.seed))
    if sample.method != "sobol":
        points: Array = engine.random(sample.count)
        return points
    # whole powers of two: SciPy warns of any other number, whose balance is a little worse
    points = engine.random_base2(max(0, (sample.count - 1).bit_length()))
    return points[: sample.count]


def value_at(axis: SampledAxis, u: float) -> Any:
    """Return the value of an axis at the share `u` of its distribution, [0, 1]."""
    if axis.uniform is not None:
        low, high = axis.uniform
        return min(high, low + u * (high - low))
    if axis.loguniform is not None:
        low, high = axis.loguniform
        return min(high, max(low, exp(log(low) + u * (log(high) - log(low)))))
    if (s := axis.normal) is not None:
        from scipy.stats import truncnorm  # noqa: PLC0415

        a, b = (s.min - s.mean) / s.std, (s.max - s.mean) / s.std
        return min(s.max, max(s.min, s.mean + s.std * float(truncnorm.ppf(u, a, b))))
    if axis.integers is not None:
        first, last = axis.integers
        return min(last, first + floor(u * (last - first + 1)))
    listed = entries(axis)
    return listed[min(len(listed) - 1, floor(u * len(listed)))]


def ends(axis: SampledAxis) -> list[Any]:
    """Return the values at which an axis is tried before a campaign: all listed ones, both ends of others."""
    return entries(axis) or [value_at(axis, 0.0), value_at(axis, 1.0)]
