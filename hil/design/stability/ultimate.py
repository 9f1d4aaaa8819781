"""The ultimate bound of a linearised robot: from a load in N and a model's error to mm of each axis.

::

    e'' + Gamma u = -d      (module disturbance), u = controller([e, de]), sampled, held and late
    d' <= d + S |u| + T (S_e |de| + S_v (|u| + d')),   |u| <= g_u d' + u of being late, likewise de

g: peak gains of the sampled loop with the gain gamma; S = max |Gamma - gamma I|; T: how old the forces are;
S_e, S_v: how accelerations change with place and rate under constant forces. The least solution bounds d'
(small gain; C. A. Desoer and M. Vidyasagar, Feedback Systems, 1975). d and Gamma are taken in a tube around
the reference that is enlarged until the bound fits into it, at its corners and worst instants, to first
order: a survey, no enclosure. Derived in docs/theory/stability.md.
"""

from collections.abc import Iterator, Sequence
from itertools import product
from math import ceil
from typing import Any, NamedTuple

import numpy as np

from drivers.arrays import Array
from hil.config.axis_model import AxisSpace
from hil.design.stability.disturbance import Inertia, Linearised, Local, Survey
from hil.design.stability.lateness import Late
from hil.design.stability.sampled_loop import Sampled, of_each
from hil.trajectory.path import PoseSample

ROUNDS = 12
"""Most enlargements of the tube."""
EXACT = 1e-9
"""What Gamma may differ from gamma I by and count as rounding."""
ROUNDING = 1e-9
"""m/s^2 or rad/s^2, what disturbances may differ by and count as equal."""
INSTANTS = 5
"""Of the reference, at which the disturbances are taken that make the tube."""
SPREAD = 20
"""Instants of the reference that are looked at where the disturbance tells none from another."""
UNNOTICED = 0.01
"""Share of the disturbance that changes no shape of the tube."""
_SIGNS = np.array(list(product((-1.0, 1.0), repeat=6)))


class Extra(NamedTuple):
    """What is known by its size alone, beside load and model."""

    d: Array
    """(6,) m/s^2 or rad/s^2, stated: of each axis by itself, any at any time."""
    pushed: Array
    """(6,) m/s^2 or rad/s^2, by what pushes one leg now and then."""
    alpha: float
    """Share of the largest |u| that the robot may add to any axis: the norm of Gamma - I."""
    error: Array
    """(6,) m or rad, what the steps of the readings cost, the last reading included."""
    rate: Array
    """(6,) m/s or rad/s, likewise."""
    effort: Array
    """(6,) m/s^2 or rad/s^2 of u, likewise."""
    drives: Array
    """(6,) m/s^2 or rad/s^2, by the steps of the forces sent and by what is lost on the way to the leg."""
    lost: Array
    """(6, 6), share of |u| of each axis that losses of force may add to another's acceleration, or take."""


class Ultimate(NamedTuple):
    """What holds along a reference, of each axis."""

    gamma: float
    exact: bool
    """Whether Gamma = gamma I at the poses for which the forces are computed."""
    d: Array
    """(6,) m/s^2 or rad/s^2, all that disturbs the axis beside being late."""
    pushed: Array
    """(6,) m/s^2 or rad/s^2, the part of it by pushes of single legs."""
    drives: Array
    """(6,) m/s^2 or rad/s^2, the part of it by steps and losses of the drives, feedback left out."""
    error: Array
    """(6,) m or rad: |e| never exceeds it from a start without error, and from anywhere near in the end."""
    rate: Array
    """(6,) m/s or rad/s, likewise."""
    late: Array
    """(6,) m or rad, the part of it that being late makes along the reference."""
    late_rate: Array
    """(6,) m/s or rad/s, likewise."""
    condition: float
    """Of J, the largest in the tube."""
    read: Array
    """(6,) m/s^2 or rad/s^2, what the steps of the readings make the law ask for."""


class Judged(NamedTuple):
    """The loops that run, and what bounds them."""

    loops: list[Sampled]
    """Of each axis, where the bound is that of."""
    every: list[Sampled]
    """Of each axis at each end of what is stated of the inertia: those that differ."""
    bound: Ultimate | str
    inertia: Inertia = Inertia()
    bounds: tuple[tuple[list[Sampled], Ultimate], ...] = ()
    """Loops and bound at each end of what is stated of the inertia."""
    carried: str = ""
    """With what the bound is the largest, or there is none; nothing where only one thing is carried."""

    @property
    def slowest(self) -> Sampled:
        """Return the loop whose errors die out last, or one that grows fastest."""
        return min(self.every, key=lambda loop: loop.decay_rate)


def ultimate(
    linearised: Linearised,
    path: Sequence[PoseSample],
    found_along: Local,
    loops: Sequence[Sampled],
    late: Late,
    extra: Extra,
    *,
    condition: float,
) -> Ultimate | str:
    """Return the bound along a path sampled in `path`; or why there is none.

    found_along: the robot at each of its samples. loops: of each axis, with the gain of their survey.
    condition: of J, what the tube may not exceed.
    """
    reference = Survey.of(found_along)
    samples = [path[k] for k in _worst(found_along.d)]
    every = max(1, len(path) // INSTANTS)
    extremes = found_along.extremes[::every].reshape(-1, 6)
    largest = np.abs(extremes).max(axis=0)
    hull = np.divide(extremes, largest, out=np.zeros_like(extremes), where=largest > ROUNDING)
    gains = np.column_stack(of_each(loops, lambda loop: loop.peak_gains()[:3]))
    found = _bound(reference, gains, late, extra)
    equal = bool(np.ptp(gains, axis=1).max() == 0.0) and not extra.d.any()
    if not isinstance(found, str):  # the tube is wider than the bound by more than what does not count
        equal = equal and not (extra.drives > UNNOTICED * found.d.max()).any()
    for _ in range(ROUNDS):
        if isinstance(found, str) or not found.d.max() > ROUNDING:
            return found
        shape = hull if equal else _SIGNS
        before = found
        errors, rates = 1.02 * before.error * shape, 1.02 * before.rate * shape
        tube = linearised.around(samples, errors, rates, late.stale_s)
        more = Survey.of(tube, reference.gamma)
        pairs: Iterator[tuple[Any, Any]] = zip(reference, more, strict=True)
        survey = Survey(*(np.maximum(a, b) for a, b in pairs))
        if survey.condition > condition:
            return (
                f"the bound, {in_words(before.error, linearised.axes)}, reaches poses where the condition of "
                f"J is {survey.condition:.3g}, allowed: {condition:g}"
            )
        found = _bound(survey, gains, late, extra)
        if not isinstance(found, str) and (found.error <= 1.02 * before.error).all():
            return found
    return "the disturbance grows with the error as fast as the law answers it"


def _worst(d: Array) -> list[int]:
    """Return the instants at which d (n, 6) of an axis is largest; where none differs, some all along."""
    chosen: set[int] = set()
    for of_axis in d.T:
        if not of_axis.max() - of_axis.min() > ROUNDING:
            chosen.update(range(0, len(d), max(1, len(d) // SPREAD)))
        else:  # of equal ones the last
            chosen.add(int(np.flatnonzero(~(of_axis < of_axis.max() - ROUNDING))[-1]))
    return sorted(chosen)


def _bound(s: Survey, gains: Array, late: Late, extra: Extra) -> Ultimate | str:
    if s.gamma <= 0.0:
        return "the believed inertia is so wrong that forces push the wrong way"
    g_e, g_de, g_u = gains
    T = late.stale_s
    by_u, by_rate = s.spread + T * s.by_rate + extra.lost, T * s.by_error
    d = beside = s.d + extra.d + extra.pushed + extra.drives
    factor = by_u * g_u + by_rate * g_de + T * s.by_rate
    size = float(np.abs(np.linalg.eigvals(factor)).max()) + extra.alpha * float(g_u.max())
    if size >= 1.0:
        return _too_much(size, lossy=bool(extra.lost.any()))
    for _ in range(1000):
        u, rate = late.effort + extra.effort + g_u * d, late.rate + extra.rate + g_de * d
        more = beside + by_u @ u + by_rate @ rate + T * s.by_rate @ d + extra.alpha * u.max()
        grown, d = float(np.max(more - d)), more
        if grown <= 1e-9 * float(d.max()):
            break
    else:
        return _too_much(size, lossy=bool(extra.lost.any()))
    error, rate = late.error + g_e * d + extra.error, late.rate + extra.rate + g_de * d
    exact = bool(s.spread.max() <= EXACT)
    return Ultimate(
        s.gamma, exact, d, extra.pushed, extra.drives, error, rate, late.error, late.rate, s.condition,
        extra.effort,
    )  # fmt: skip


def in_words(error: Array, axes: AxisSpace) -> str:
    """Return the largest of errors (6,) of the axes, m and rad."""
    if axes == "joint":
        return f"{1e3 * error.max():.3g} mm of leg length"
    return f"{1e3 * error[:3].max():.3g} mm and {np.degrees(error[3:].max()):.3g} deg"


def _too_much(size: float, *, lossy: bool) -> str:
    losses = ", with what a transmission loses where a leg turns round" if lossy else ""
    less = "a transmission that loses less, " if lossy else ""
    shown = f"{ceil(1e3 * size) / 1e3:g}" if size >= 1.0 else "almost 1"
    return (
        "no bound: forces computed with another inertia, or for a pose of some time ago, miss by more than "
        f"the gains bear{losses}: small gain {shown}, allowed below 1; {less}a better model, lower gains or "
        "less delay"
    )
