"""The ultimate bound of a linearised robot: from a load in N and a model error to mm of each axis.

::

    e'' + Gamma u = -d      (module disturbance), u = controller([e, de]), sampled, held and delayed
    d' <= d + S |u| + T (S_e |de| + S_v (|u| + d')),   |u| <= g_u d' + u caused by delay, |de| similarly

g: peak gains of the sampled loop with the gain gamma; S = max |Gamma - gamma I|; T: age of the forces;
S_e, S_v: change of accelerations with position and rate under constant forces. The least solution bounds d'
(small gain; C. A. Desoer and M. Vidyasagar, Feedback Systems, 1975). d and Gamma are taken in a tube around
the reference, which is enlarged until it contains the bound. They are evaluated at its corners and worst
instants, to first order: a survey, not an enclosure. Derived in docs/theory/stability.md.
"""

from collections.abc import Iterator, Sequence
from itertools import product
from math import ceil
from typing import Any, NamedTuple

import numpy as np

from drivers.arrays import Array
from hil.config.axis_model import AxisSpace
from hil.design.stability.delay_effect import DelayEffect
from hil.design.stability.disturbance import Inertia, Linearised, Local, Survey
from hil.design.stability.sampled_loop import Sampled, of_each
from hil.trajectory.path import PoseSample

ROUNDS = 12
"""Largest number of enlargements of the tube of states around the reference."""
EXACT = 1e-9
"""Largest difference of Gamma from gamma I that counts as rounding."""
ROUNDING = 1e-9
"""m/s^2 or rad/s^2, largest difference of disturbances that count as equal."""
INSTANTS = 5
"""Number of instants of the reference whose disturbances shape the tube."""
SPREAD = 20
"""Number of instants of the reference that are evaluated where the disturbance is constant."""
UNNOTICED = 0.01
"""Share of the disturbance by which parts may differ without changing the shape of the tube."""
_SIGNS = np.array(list(product((-1.0, 1.0), repeat=6)))


class Aged(NamedTuple):
    """Effect of feedback up to h old, extrapolated at its last rate: its rate is wrong by up to h |ddq|."""

    fixed: Array
    """(6,) m/s or rad/s, rate error from the acceleration of the reference."""
    per_acceleration: Array
    """(6, 6) s, rate error per acceleration of the error."""
    gains: Array
    """(3, 6), peak gains to e, de and u from this rate error together with its length error."""


class Extra(NamedTuple):
    """Disturbances of which only bounds are known, in addition to load and model error."""

    d: Array
    """(6,) m/s^2 or rad/s^2, as stated in the request: independent for each axis, at any time."""
    pushed: Array
    """(6,) m/s^2 or rad/s^2, from pushes on single legs."""
    alpha: float
    """Share of the largest |u| that the robot may add to any axis: the norm of Gamma - I."""
    error: Array
    """(6,) m or rad, error of each axis from the resolution of the measurements, the last one included."""
    rate: Array
    """(6,) m/s or rad/s, error of the rate of each axis from the resolution of the measurements."""
    effort: Array
    """(6,) m/s^2 or rad/s^2, change of u from the resolution of the measurements."""
    drives: Array
    """(6,) m/s^2 or rad/s^2, from the resolution of the force commands and from transmission losses."""
    lost: Array
    """(6, 6), share of |u| of each axis by which transmission losses may change another axis'
    acceleration."""
    aged: Aged | None = None


class Ultimate(NamedTuple):
    """Ultimate bound of each axis along a reference, and its parts."""

    gamma: float
    exact: bool
    """True if Gamma = gamma I at the poses for which the forces are computed."""
    d: Array
    """(6,) m/s^2 or rad/s^2, all disturbances of the axis except delay."""
    pushed: Array
    """(6,) m/s^2 or rad/s^2, the part of `d` from pushes on single legs."""
    drives: Array
    """(6,) m/s^2 or rad/s^2, the part of `d` from resolution and losses of the drives, without feedback."""
    error: Array
    """(6,) m or rad, bound on |e|: at all times from a start without error, finally from any start nearby."""
    rate: Array
    """(6,) m/s or rad/s, bound on |de|."""
    late: Array
    """(6,) m or rad, the part of `error` from delay along the reference."""
    late_rate: Array
    """(6,) m/s or rad/s, the part of `rate` from delay."""
    condition: float
    """Largest condition number of J in the tube."""
    read: Array
    """(6,) m/s^2 or rad/s^2, change of u from the resolution of the measurements."""
    aged: Array
    """(6,) m or rad, part of `error` from old feedback."""


class Judged(NamedTuple):
    """Sampled loops of the axes, and their ultimate bound, or why no bound holds, as text."""

    loops: list[Sampled]
    """Loop of each axis to which the bound applies."""
    every: list[Sampled]
    """Loops of all axes at both ends of the stated inertia range, without repetitions."""
    bound: Ultimate | str
    inertia: Inertia = Inertia()
    bounds: tuple[tuple[list[Sampled], Ultimate], ...] = ()
    """Loops and bound at both ends of the stated inertia range."""
    carried: str = ""
    """Payload with the largest bound, or without a bound; empty with a single payload."""

    @property
    def slowest(self) -> Sampled:
        """Loop with the slowest decay, or the fastest growth, of all loops in `every`."""
        return min(self.every, key=lambda loop: loop.decay_rate)


def ultimate(
    linearised: Linearised,
    path: Sequence[PoseSample],
    found_along: Local,
    loops: Sequence[Sampled],
    late: DelayEffect,
    extra: Extra,
    *,
    condition: float,
) -> Ultimate | str:
    """Ultimate bound along the path sampled in `path`, or why no bound holds, as text.

    found_along: the robot at each sample. loops: of each axis, with the gain of their survey.
    condition: largest allowed condition number of J in the tube.
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
                f"the bound, {in_words(before.error, linearised.axes)}, contains poses where the condition "
                f"number of J is {survey.condition:.3g}, allowed: {condition:g}"
            )
        found = _bound(survey, gains, late, extra)
        if not isinstance(found, str) and (found.error <= 1.02 * before.error).all():
            return found
    return "the disturbance grows with the error as fast as the law reduces the error"


def _worst(d: Array) -> list[int]:
    """Indices of instants at which d (n, 6) of an axis is largest; for a constant d, some along the path."""
    chosen = (
        set(range(0, len(d), max(1, len(d) // SPREAD))) if (np.ptp(d, axis=0) <= ROUNDING).any() else set()
    )
    for of_axis in d.T[np.ptp(d, axis=0) > ROUNDING]:  # of equal ones the last
        chosen.add(int(np.flatnonzero(of_axis >= of_axis.max() - ROUNDING)[-1]))
    return sorted(chosen)


def _bound(s: Survey, gains: Array, late: DelayEffect, extra: Extra) -> Ultimate | str:
    if s.gamma <= 0.0:
        return "the inertia of the model is so wrong that forces act in the wrong direction"
    T = late.stale_s
    by_u, by_rate = s.spread + T * s.by_rate + extra.lost, T * s.by_error
    d = fixed = s.d + extra.d + extra.pushed + extra.drives
    # e, de and u: their values without d, and their gains (6, 6) from d
    ends = np.array([late.error + extra.error, late.rate + extra.rate, late.effort + extra.effort])
    by_d, by_itself = np.array([np.diag(each) for each in gains]), T * s.by_rate
    if extra.aged is not None:
        share, g = extra.aged.per_acceleration, extra.aged.gains
        size = float(np.abs(np.linalg.eigvals(s.gamma * share * g[2])).max())
        if size >= 1.0:
            return _too_much(size, extra)
        share = np.linalg.solve(np.eye(6) - s.gamma * share * g[2], share)  # by the error's own acceleration
        read = extra.aged.fixed + share @ (s.gamma * (ends[2] + g[2] * extra.aged.fixed))
        read_by_d = share @ (s.gamma * by_d[2] + np.eye(6))
        ends, by_d = ends + g * read, by_d + g[:, :, None] * read_by_d
        fixed, by_itself = fixed + s.by_rate @ read, by_itself + s.by_rate @ read_by_d
    factor = by_u @ by_d[2] + by_rate @ by_d[1] + by_itself
    size = float(np.abs(np.linalg.eigvals(factor)).max()) + extra.alpha * float(by_d[2].sum(axis=1).max())
    if size >= 1.0:
        return _too_much(size, extra)
    for _ in range(1000):
        error, rate, u = ends + by_d @ d
        more = fixed + by_u @ u + by_rate @ rate + by_itself @ d + extra.alpha * u.max()
        if np.max(more - d) <= 1e-9 * more.max():
            break
        d = more
    else:
        return _too_much(size, extra)
    return Ultimate(
        s.gamma, bool(s.spread.max() <= EXACT), d, extra.pushed, extra.drives, error, rate, late.error,
        late.rate, s.condition, extra.effort, error - (late.error + extra.error + gains[0] * d),
    )  # fmt: skip


def in_words(error: Array, axes: AxisSpace) -> str:
    """Largest error of the axes (6,) m, rad as text, in mm of leg length or in mm and deg."""
    if axes == "joint":
        return f"{1e3 * error.max():.3g} mm of leg length"
    return f"{1e3 * error[:3].max():.3g} mm and {np.degrees(error[3:].max()):.3g} deg"


def _too_much(size: float, extra: Extra) -> str:
    lossy = "a transmission with lower losses, " if extra.lost.any() else ""
    fresh = "limits.stale_warn_ticks 1, " if extra.aged is not None else ""
    shown = f"{ceil(1e3 * size) / 1e3:g}" if size >= 1.0 else "almost 1"
    return (
        "no bound: the force errors of a wrong inertia and of delay exceed what the gains tolerate: small "
        f"gain {shown}, allowed below 1; needed: {lossy}{fresh}a better model, lower "
        "gains or less delay"
    )
