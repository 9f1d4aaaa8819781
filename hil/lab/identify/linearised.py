"""Signals of the linearised axes, from a log and its configuration, to identify their responses.

A law that linearises sends tau = A(x) v + b(x), x the measured state, for a demanded acceleration v. So v
follows from the sent forces, limits included, whatever produced v: reference, gains, a switching term.
"""

from fractions import Fraction
from math import gcd, lcm
from typing import NamedTuple

import numpy as np

from drivers.arrays import Array, Flags, Ints, Rows
from drivers.errors import ConfigurationError, IdentificationError, LogError
from drivers.signals import Mode
from drivers.tick_columns import Record, new_record
from hil.app.configuration.configuration import Configuration
from hil.app.configuration.controller_file import controller_of
from hil.app.configuration.platform import build_platform
from hil.config.axis_model import AxisSpace
from hil.config.reference import MultisineReference, ReferenceSettings, SinusoidReference
from hil.control import LAWS
from hil.control.inverse_dynamics import linearising_tau
from hil.control.model import build_model
from hil.lab.identify.estimators.response import AxisSignals
from hil.lab.identify.runs import episode
from hil.mathematics.rotations import relative_rotation
from hil.robot.dynamics import Model
from hil.robot.dynamics_kernels import inverse_dynamics_kernel
from hil.robot.kinematics_kernels import jacobian_kernel
from hil.trajectory.multisine import pick_lines

LEAST_MOTION_m = 1e-4
"""Least motion of the leg that moves most; less is lost in encoder steps and friction."""
APART = 1e-6
"""Largest rounding error between the reference's time and the clock's, as a share of the period."""


class LinearisedLaw(NamedTuple):
    """The linearising part of a configured law, which turns demanded accelerations into leg forces."""

    space: AxisSpace
    model: Model
    takes_wrench_off: bool


def linearised_law(c: Configuration) -> LinearisedLaw:
    """Linearising part of the configured law. Raises ConfigurationError if the law does not linearise."""
    settings = c.controller
    controller = controller_of(settings, c.folder)
    space = settings.axes if controller is None else controller.axes
    if space is None or space == "designed" or settings.believed is None:
        allowed = ", ".join(name for name, law in LAWS.items() if law.axes is not None)
        raise ConfigurationError(
            f"{c.source}: controller.law: {settings.law} demands no acceleration, so there is no linearised "
            f"axis to identify, allowed: {allowed}"
        )
    model = build_model(settings.believed, build_platform(c.platform), c.platform.leg_spin)
    return LinearisedLaw(space, model, settings.compensates_wrench)


def signals_of(rows: Rows, law: LinearisedLaw, rate_Hz: float) -> tuple[AxisSignals, Array]:
    """Signals of the tracked part of a log, and the reference's time (n,) s at each tick; gaps are held.

    Raises LogError: nothing was tracked; IdentificationError: the legs hardly moved.
    """
    rows = rows[rows["mode"] == Mode.TRACKING]
    if not len(rows):
        raise LogError("no tick of this log tracks a reference, so nothing can be identified")
    motion = float(np.ptp(rows["q"], axis=0).max())
    if motion < LEAST_MOTION_m:
        raise IdentificationError(
            f"too little motion: no leg moves by more than {1e3 * motion:.2g} mm, allowed: at least "
            f"{1e3 * LEAST_MOTION_m:g} mm; excite it, or raise --force"
        )
    rows, p, R, good = episode(rows)
    twist, wrench = np.nan_to_num(rows["twist"]), np.ascontiguousarray(rows["wrench"]) * law.takes_wrench_off
    states = [state_of(law.model, *state) for state in zip(p, R, twist, wrench, strict=True)]
    A, b = law_terms(law.space, law.model, states)
    v = np.asarray(np.linalg.solve(A, (rows["tau"] - b)[:, :, None])[:, :, 0], float)
    if law.space == "joint":
        y, r = rows["q"], rows["ddq_d"]
    else:
        y, r = np.hstack([p, [relative_rotation(R[0], each) for each in R]]), rows["dtwist_d"]
    good = good & np.isfinite(v).all(axis=1)
    return AxisSignals(1.0 / rate_Hz, v, y, r, good), rows["reference_time_s"]


def repeating(reference: ReferenceSettings, rate_Hz: float) -> tuple[int, Ints] | None:
    """Ticks per period, and harmonic numbers, of a periodic reference; None for any other reference.

    Lines above 0.45 of the rate are ignored. A sinusoid that lasts less than a quarter of its period is a
    drift, not a line.
    """
    if isinstance(reference, MultisineReference):
        taken: set[int] = set()
        for n, axis in enumerate(reference.axes):
            taken.update(pick_lines(axis, reference.period_s, taken, f"reference.axes[{n}]"))
        length, harmonics = reference.period_s * rate_Hz, sorted(taken)
    elif isinstance(reference, SinusoidReference):
        frequencies = {c.frequency_Hz for c in reference.components}
        seen = sorted(f for f in frequencies if f * reference.duration_s > 0.25)
        exact = [Fraction(f).limit_denominator(1000) for f in seen]
        if not seen or any(abs(float(e) - f) > 1e-9 for e, f in zip(exact, seen, strict=True)):
            return None
        base = Fraction(gcd(*(e.numerator for e in exact)), lcm(*(e.denominator for e in exact)))
        length, harmonics = rate_Hz / float(base), [int(e / base) for e in exact]
        if length / rate_Hz > reference.duration_s:
            return None
    else:
        return None
    if abs(length - round(length)) > 1e-6:
        return None
    return round(length), np.array([h for h in harmonics if h < 0.45 * round(length)], np.int64)


def settled(
    signals: AxisSignals, t: Array, reference: SinusoidReference | MultisineReference, length: int
) -> Flags:
    """Mask (n,) of the ticks in the last whole periods, of `length` ticks, between the reference's ramps.

    A tick does not count if the reference's time t (n,) s advanced by another time than the clock: at less
    than full speed all lines have lower frequencies than expected.
    """
    T, ticks = signals.period_s, np.flatnonzero(signals.good)
    late = np.diff(t[ticks] - ticks * T, prepend=t[ticks[:1]] - ticks[:1] * T)
    good = np.zeros(len(t), bool)
    good[ticks[np.abs(late) < APART * T]] = True
    end = t[np.isfinite(t)].max(initial=0.0)
    if isinstance(reference, MultisineReference):
        duration = 2.0 * reference.ramp_s + reference.periods * reference.period_s
    else:
        duration = reference.duration_s
    last = min(duration - reference.ramp_s, end) - 1e-9
    inside = np.flatnonzero((t >= reference.ramp_s - 1e-9) & (t < last))
    mask = np.zeros(len(t), bool)
    mask[inside[len(inside) % length :]] = True
    return good & mask


def law_terms(space: AxisSpace, model: Model, states: list[Record]) -> tuple[Array, Array]:
    """A (n, 6, 6) and b (n, 6) N of tau = A v + b in each state, by the law's own kernel.

    v of space joint: of the legs, m/s^2; pose: of x, y, z and the rotations about them, m/s^2 and rad/s^2.
    """

    def tau(v: Array) -> Array:
        if space == "joint":
            return np.array([linearising_tau(model, state, v) for state in states])
        c, code = model.constants, model.code
        of = [(state["p"], state["R"], state["twist"], v, state["wrench"]) for state in states]
        return np.array([inverse_dynamics_kernel(c, code, *each) for each in of])

    b = tau(np.zeros(6))
    return np.stack([tau(axis) - b for axis in np.eye(6)], axis=2), b


def state_of(model: Model, p: Array, R: Array, twist: Array, wrench: Array) -> Record:
    """A tick record with the state that a law's kernels read: p (3,), R (3, 3), twist and wrench (6,)."""
    tick = new_record()
    tick["p"], tick["R"], tick["twist"], tick["wrench"] = p, R, twist, wrench
    tick["J"] = jacobian_kernel(model.platform.base_joints, model.platform.platform_joints, p, R)
    return tick
