"""Judges a simulated run with an injected fault: its reaction, the delay, and the true motion of the legs.

All lengths are the plant's true ones. The error before the reaction counts from the reference while the
brakes are open, else from where the legs stood. The travel after it counts from the lengths at the reaction.
"""

from collections.abc import Iterable, Mapping
from typing import NamedTuple

import numpy as np

from drivers.arrays import Array, Ints
from drivers.signals import Mode
from hil.loop.modes import BRAKED, MOVING
from hil.study.faults.diagnoses import EXPECTED, NAMES_NO_LEG, PLANT_FAILS, bits_of, expects

BRAKE_m = 10e-3
"""Largest motion of a leg of a platform at rest, and largest error in motion because of a brake."""
STANDING_m_s = 0.02
"""Slower legs are at rest and need no stopping distance."""
MOTION_m = 1e-4
"""True motion from which an encoder that jumps or freezes can be detected."""
FOUND_m = 2e-3
"""Largest true motion of the leg until detection, unless it is detected within `found_s`; without detection,
the largest error.
"""
FORGED_m, FORGED_TICKS = 2e-3, 2
"""Largest error until forged or old frames are declared, and largest number of ticks until then."""
REST_m, REST_S, HELD_REST_S = 5e-5, 0.1, 1.0
"""Legs at rest: largest motion within the last seconds of a run, 0.1 s or, held with force, 1 s."""
NOT_OBSERVABLE = "not observable with these sensors"
_GROWS = ("encoder_drift", "encoder_scale")
"""Not observable in motion, with an unbounded error: judged by the motion after the reaction, if any."""
_NOT_OBSERVABLE = (*_GROWS, "encoder_late")
_FOUND = ("encoder_jump", "encoder_freeze")
_AT_REST = "encoder_freeze"
"""Not observable while its leg does not move."""
_FORGED = ("frames_forged_command", "frames_forged_feedback", "frames_old", "bus_second_controller")
_NO_CAUSES: Mapping[str, frozenset[int]] = {}


class Trace(NamedTuple):
    """Record of a simulated run with an injected fault, n ticks."""

    length: Array
    """(n, 6) m, true leg lengths."""
    desired: Array
    """(n, 6) m, leg lengths of the reference."""
    mode: Ints
    """(n,) controller mode, values of Mode."""
    faults: Ints
    """(n,) faults so far, bits of Fault."""
    rate_Hz: float
    begun: int
    """First tick with the fault; if the plant fails in it, the tick after the last."""
    leg: int | None
    """Leg with the fault."""
    success: bool
    failed: str
    """Message of the plant's failure; empty: it did not fail."""
    causes: Mapping[str, frozenset[int]] = _NO_CAUSES
    """Reported faults, ENCODER with its doubt as `ENCODER/JUMP`, each with its legs."""
    lost: frozenset[int] = frozenset()
    """Legs whose encoder was ignored from some tick on, while the run continued."""


class Bounds(NamedTuple):
    """Largest allowed leg motions in m, from a configuration."""

    stopping_m: float
    """Stopping distance with the brakes, as `hil check` prints it."""
    controlled_m: float
    """Stopping distance of a controlled stop along the path."""
    harmless_m: float
    harmless_s: float
    """Tracking error that is no fault: at rest, plus this time multiplied by the reference's speed."""


class Seen(NamedTuple):
    """Measurements on a run with an injected fault: delays in ticks, leg motions in m."""

    declared: int | None
    """Ticks from the fault's beginning to the reaction; None: no reaction."""
    error_m: float
    """Largest error of a leg before the reaction."""
    added_m: float
    """Increase of the error since the fault began."""
    speed_m_s: float
    """Largest speed of a leg's reference from the fault's beginning to the reaction."""
    travel_m: float
    """Largest travel of a leg after the reaction."""
    last_m: float
    """Largest motion of a leg in the last `rest_s`."""
    in_motion: bool
    """True if the platform moved at the reaction."""
    braked: bool
    """True if the platform stood on closed brakes at the reaction."""
    led: bool
    """True if the reaction was a controlled stop."""
    stood: bool
    """True if the platform stood on closed brakes from the fault to the reaction."""
    diagnosed: int | None
    """Ticks from the fault's beginning to an expected diagnosis; None: no such diagnosis."""
    found_m: float
    """True motion of the faulty leg until the diagnosis, or to the end."""
    found_ticks: int
    """Ticks from the leg's first true motion until the diagnosis, or to the end; 0: it did not move."""


def found_s(rate_Hz: float) -> float:
    """Longest true motion, s, until a frozen or jumping encoder must be detected; longer for slow loops."""
    period_s = 1.0 / rate_Hz
    return max(float(np.interp(period_s, (1e-3, 4e-3, 10e-3), (20e-3, 44e-3, 70e-3))), 7.0 * period_s)


def rest_s(t: Trace) -> float:
    """Time, s, at the end of a run in which the platform must stand still."""
    return HELD_REST_S if t.mode[-1] == Mode.HELD else REST_S


def see(kind: str, t: Trace) -> Seen:
    """Measure delays and leg motions of a run from the start of a kind of fault."""
    n, k0 = len(t.mode), max(t.begun - 1, 0)
    declared = _first(t.faults[t.begun :] != 0)
    diagnosed = _first(t.faults[t.begun :] & bits_of(EXPECTED[kind]) != 0)
    end = n - 1 if declared is None else t.begun + declared
    moving, braked = np.isin(t.mode, list(MOVING)), np.isin(t.mode, list(BRAKED))
    error, began, stood = 0.0, 0.0, t.length[k0]
    for k in range(k0, end + 1):
        reference = stood
        if moving[k] or (k == end and moving[k - 1]):  # the tick of the reaction still has its reference
            reference, stood = t.desired[k], t.length[k]
        error = max(error, float(np.abs(t.length[k] - reference).max()))
        began = error if k == k0 else began
    travel = 0.0 if declared is None else float(np.abs(t.length[end:] - t.length[end]).max())
    last = t.length[-1 - min(n - 1, round(rest_s(t) * t.rate_Hz)) :]
    own = slice(None) if t.leg is None else [t.leg]
    until = n - 1 if diagnosed is None else t.begun + diagnosed
    motion = np.abs(t.length[k0 : until + 1, own] - t.length[k0, own]).max(axis=1)
    moved = _first(motion > MOTION_m)
    speed = np.abs(t.length[end] - t.length[end - 1]).max() * t.rate_Hz
    under_way = moving[k0:end] & moving[k0 + 1 : end + 1]
    steps = np.abs(np.diff(t.desired[k0 : end + 1], axis=0))[under_way]
    before = max(end - 1, k0)  # the tick of the reaction has the mode that follows it
    return Seen(
        declared=declared,
        error_m=error,
        added_m=error - began,
        speed_m_s=float(steps.max()) * t.rate_Hz if steps.size else 0.0,
        travel_m=travel,
        last_m=float(np.ptp(last, axis=0).max()),
        in_motion=bool(speed > STANDING_m_s),
        braked=bool(braked[before]),
        led=bool((t.mode[end:] == Mode.STOPPING).any()) and t.mode[before] != Mode.STOPPING,
        stood=bool(braked[k0 : before + 1].all()),
        diagnosed=diagnosed,
        found_m=float(motion.max()),
        found_ticks=0 if moved is None else len(motion) - 1 - moved,
    )


def _first(true: Array) -> int | None:
    found = np.flatnonzero(true)
    return int(found[0]) if found.size else None


def judge(kind: str, t: Trace, s: Seen, bounds: Bounds) -> tuple[bool, str]:
    """(passed, reason): whether a run keeps the bound of its kind of fault, and reports cause and leg."""
    if t.failed:
        if kind in PLANT_FAILS:
            return True, "the plant failed and reported it"
        return False, f"the plant failed, allowed only for {', '.join(PLANT_FAILS)}"
    if t.faults[max(t.begun - 1, 0)]:
        return False, "there was a fault before this one began"
    if s.last_m > REST_m:
        return False, f"the platform moves at the end: {_at_most(f'in {rest_s(t):g} s', s.last_m, REST_m)[1]}"
    if s.declared is None:
        return _without_reaction(kind, t, s, bounds)
    good, text = _bounded(kind, t, s, bounds)
    missing = _missing(kind, t)
    if not missing:
        return good, text
    return False, missing if good else f"{text}; {missing}"


def _bounded(kind: str, t: Trace, s: Seen, bounds: Bounds) -> tuple[bool, str]:
    """(passed, text): whether the legs moved no further than allowed before and after the reaction."""
    if kind.startswith("brake_"):
        good, text = _at_most("error", s.error_m, BRAKE_m)
        if not good:
            return good, text
        travel_m = bounds.stopping_m if s.in_motion and not s.braked else BRAKE_m
        return _at_most("moved", s.travel_m, travel_m)
    stopping_m = max(bounds.stopping_m, bounds.controlled_m) if s.led else bounds.stopping_m
    travel_m = BRAKE_m if s.braked else stopping_m
    stopped, text = _at_most("travelled", s.travel_m, travel_m)
    if not stopped:
        return stopped, text
    if kind in _GROWS:
        return True, f"{NOT_OBSERVABLE} in motion: remaining error {_mm(s.error_m)}; travelled {text}"
    if kind in _FOUND:
        late_s, allowed_s = s.found_ticks / t.rate_Hz, found_s(t.rate_Hz)
        good = s.found_m <= FOUND_m or late_s <= allowed_s + 1e-9
        what = f"detected after {_mm(s.found_m)} of true motion and {1e3 * late_s:.0f} ms"
        return good, what if good else f"{what}, allowed: {_mm(FOUND_m)} or {1e3 * allowed_s:.0f} ms"
    if kind in _FORGED:
        diagnosed = s.declared if s.diagnosed is None else s.diagnosed
        if diagnosed is None or diagnosed > FORGED_TICKS:
            return False, f"reported after {diagnosed} ticks, allowed: {FORGED_TICKS}"
        return _at_most("error until reported", s.added_m, FORGED_m)
    return _at_most("moved", s.error_m, BRAKE_m if s.stood else bounds.stopping_m)


def _missing(kind: str, t: Trace) -> str:
    """Sentence on the cause or leg that the run failed to report; empty if it reported both."""
    expected = EXPECTED[kind]
    right = {cause for cause in t.causes if expects(expected, cause)}
    if not right:
        return f"the cause is missing: reported {_listed(t.causes)}, expected {_listed(expected) or 'none'}"
    telling = right - NAMES_NO_LEG
    if t.leg is None or not telling or any(t.leg in t.causes[cause] for cause in telling):
        return ""
    legs = sorted(set().union(*(t.causes[cause] for cause in telling)))
    named = f"leg {', '.join(map(str, legs))}" if legs else "no leg"
    return f"the leg is missing: {_listed(telling)} reports {named}, expected leg {t.leg}"


def _without_reaction(kind: str, t: Trace, s: Seen, bounds: Bounds) -> tuple[bool, str]:
    """(passed, text) for a run in which the controller did not react to the fault."""
    if not t.success:
        return False, "ended without a reaction, but not parked"
    if kind in _NOT_OBSERVABLE:
        return True, f"{NOT_OBSERVABLE}: remaining error {_mm(s.error_m)}"
    if t.leg in t.lost:
        good, text = _at_most("error", s.error_m, FOUND_m)
        return good, f"continues without the encoder of leg {t.leg}, {text}"
    if kind in _FOUND:
        if s.found_ticks == 0 and kind == _AT_REST:
            return True, f"{NOT_OBSERVABLE}: the leg did not move"
        good, text = _at_most("error", s.error_m, FOUND_m)
        if kind == _AT_REST:
            return good, f"harmless, {text}" if good else f"not detected: {text}"
        return False, f"not detected: error {_mm(s.error_m)}"
    if kind in _FORGED:
        return False, f"not reported, {_mm(s.error_m)} of error"
    follows_m = bounds.harmless_m + bounds.harmless_s * s.speed_m_s
    allowed = BRAKE_m if s.stood or kind.startswith("brake_") else follows_m
    good, text = _at_most("error", s.error_m, allowed)
    return good, "harmless" if good else f"no reaction: {text}"


def _listed(causes: Iterable[str]) -> str:
    return ", ".join(sorted(causes))


def _at_most(what: str, value_m: float, allowed_m: float) -> tuple[bool, str]:
    if value_m <= allowed_m:
        return True, f"within {_mm(allowed_m)}"
    return False, f"{what} {_mm(value_m)}, allowed: {_mm(allowed_m)}"


def _mm(value_m: float) -> str:
    value_mm = 1e3 * value_m
    return f"{value_mm:.2f} mm" if value_mm < 10.0 else f"{value_mm:.0f} mm"
