"""What a run with a fault shows: which reaction, when, how far the legs truly moved, and is that good.

All lengths are the plant's true ones. The error before a reaction counts from the reference while the brakes
are open, else from where the legs stood; the travel after it from where they were then.
"""

from collections.abc import Iterable, Mapping
from typing import NamedTuple

import numpy as np

from drivers.arrays import Array, Ints
from drivers.signals import Mode
from hil.loop.modes import BRAKED, MOVING
from hil.study.faults.expected import EXPECTED, NAMES_NO_LEG, PLANT_FAILS, bits_of, expects

BRAKE_m = 10e-3
"""No leg of a platform at rest moves by more, and none in motion errs by more because of a brake."""
STANDING_m_s = 0.02
"""Legs that are slower are at rest: there is no way on which to stop."""
MOTION_m = 1e-4
"""From the first true motion above this an encoder that jumps or freezes can be found."""
FOUND_m = 2e-3
"""It is found by then, after so much true motion of its leg, or within `found_s`; or it leaves no larger
error."""
FORGED_m, FORGED_TICKS = 2e-3, 2
"""Error until forged or old frames are declared, and how long that takes."""
REST_m, REST_S, HELD_REST_S = 5e-5, 0.1, 1.0
"""Legs that move no more than this in the last so many seconds are at rest; longer where force holds."""
NOT_OBSERVABLE = "not observable with these sensors"
_GROWS = ("encoder_drift", "encoder_scale")
"""Not observable in motion, and without a bound of what is left: judged by what follows where it shows."""
_NOT_OBSERVABLE = (*_GROWS, "encoder_late")
_FOUND = ("encoder_jump", "encoder_freeze")
_AT_REST = "encoder_freeze"
"""Not observable while its leg does not move."""
_FORGED = ("frames_forged_command", "frames_forged_feedback", "frames_old", "bus_second_controller")
_NOBODY: Mapping[str, frozenset[int]] = {}


class Trace(NamedTuple):
    """A run, tick by tick."""

    length: Array
    """(n, 6) m, true."""
    desired: Array
    """(n, 6) m, of the reference."""
    mode: Ints
    """(n,) Mode."""
    faults: Ints
    """(n,) Fault, the bits so far."""
    rate_Hz: float
    begun: int
    """First tick with the fault; that of a plant that fails in it is the one after the last."""
    leg: int | None
    """Whose fault it is."""
    success: bool
    failed: str
    """What the plant's end said when it failed; empty while it lived."""
    causes: Mapping[str, frozenset[int]] = _NOBODY
    """Faults that were named, ENCODER with its doubt as `ENCODER/JUMP`, each with the legs named."""
    lost: frozenset[int] = frozenset()
    """Legs whose encoder counted for nothing any more, while the run went on."""


class Bounds(NamedTuple):
    """What a configuration allows, m."""

    stopping_m: float
    """The printed stopping distance, by the brakes."""
    controlled_m: float
    """That of a stop under control, along the path."""
    harmless_m: float
    harmless_s: float
    """Tracking error that is no fault: at rest, and more by this times the reference's speed."""


class Seen(NamedTuple):
    """What happened."""

    declared: int | None
    """Ticks from the fault's beginning to the reaction; None: there was none."""
    error_m: float
    """Largest error of a leg before it."""
    added_m: float
    """By how much that is more than when the fault began."""
    speed_m_s: float
    """Largest speed of a leg's reference from then on."""
    travel_m: float
    """Largest travel of a leg after it."""
    last_m: float
    """Largest motion of a leg in the last `rest_s`."""
    in_motion: bool
    """Whether the platform moved at the reaction."""
    braked: bool
    """Whether it stood on closed brakes at the reaction."""
    led: bool
    """Whether the reaction was a stop under control."""
    stood: bool
    """Whether it did so all the time from the fault on."""
    told: int | None
    """Ticks from the fault's beginning to a fault that is expected of it; None: there was none."""
    found_m: float
    """True motion of the faulty leg until then, or to the end."""
    found_ticks: int
    """Ticks from its first true motion until then, or to the end; 0: it did not move before."""


def found_s(rate_Hz: float) -> float:
    """Return in what time of true motion a jump or a freeze is found, s: a slow loop needs longer."""
    period_s = 1.0 / rate_Hz
    return max(float(np.interp(period_s, (1e-3, 4e-3, 10e-3), (20e-3, 44e-3, 70e-3))), 7.0 * period_s)


def rest_s(t: Trace) -> float:
    """Return in what time at the end the platform has to stand still, s."""
    return HELD_REST_S if t.mode[-1] == Mode.HELD else REST_S


def see(kind: str, t: Trace) -> Seen:
    """Return what a run shows since a fault of a kind."""
    n, k0 = len(t.mode), max(t.begun - 1, 0)
    declared = _first(t.faults[t.begun :] != 0)
    told = _first(t.faults[t.begun :] & bits_of(EXPECTED[kind]) != 0)
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
    until = n - 1 if told is None else t.begun + told
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
        told=told,
        found_m=float(motion.max()),
        found_ticks=0 if moved is None else len(motion) - 1 - moved,
    )


def _first(true: Array) -> int | None:
    """Return where the first true element is."""
    found = np.flatnonzero(true)
    return int(found[0]) if found.size else None


def judge(kind: str, t: Trace, s: Seen, bounds: Bounds) -> tuple[bool, str]:
    """Return whether a run is within the bound of its kind of fault and names cause and leg, and why."""
    if t.failed:
        if kind in PLANT_FAILS:
            return True, "the plant failed and said so"
        return False, f"the plant failed, allowed of {', '.join(PLANT_FAILS)} alone"
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
    """Judge how far the legs moved before and after a reaction."""
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
        return True, f"{NOT_OBSERVABLE} in motion: leaves {_mm(s.error_m)}; travelled {text}"
    if kind in _FOUND:
        late_s, allowed_s = s.found_ticks / t.rate_Hz, found_s(t.rate_Hz)
        good = s.found_m <= FOUND_m or late_s <= allowed_s + 1e-9
        what = f"found after {_mm(s.found_m)} of true motion and {1e3 * late_s:.0f} ms"
        return good, what if good else f"{what}, allowed: {_mm(FOUND_m)} or {1e3 * allowed_s:.0f} ms"
    if kind in _FORGED:
        told = s.declared if s.told is None else s.told
        if told is None or told > FORGED_TICKS:
            return False, f"declared after {told} ticks, allowed: {FORGED_TICKS}"
        return _at_most("error until declared", s.added_m, FORGED_m)
    return _at_most("moved", s.error_m, BRAKE_m if s.stood else bounds.stopping_m)


def _missing(kind: str, t: Trace) -> str:
    """Say which cause or leg the run should have named and did not; empty where it has."""
    expected = EXPECTED[kind]
    right = {cause for cause in t.causes if expects(expected, cause)}
    if not right:
        return f"the cause is missing: named {_listed(t.causes)}, expected {_listed(expected) or 'none'}"
    telling = right - NAMES_NO_LEG
    if t.leg is None or not telling or any(t.leg in t.causes[cause] for cause in telling):
        return ""
    legs = sorted(set().union(*(t.causes[cause] for cause in telling)))
    named = f"leg {', '.join(map(str, legs))}" if legs else "no leg"
    return f"the leg is missing: {_listed(telling)} names {named}, expected leg {t.leg}"


def _without_reaction(kind: str, t: Trace, s: Seen, bounds: Bounds) -> tuple[bool, str]:
    """Judge a run that has ended parked as if nothing had been."""
    if not t.success:
        return False, "ended without a reaction, and not parked"
    if kind in _NOT_OBSERVABLE:
        return True, f"{NOT_OBSERVABLE}: leaves {_mm(s.error_m)}"
    if t.leg in t.lost:
        good, text = _at_most("error", s.error_m, FOUND_m)
        return good, f"goes on without the encoder of leg {t.leg}, {text}"
    if kind in _FOUND:
        if s.found_ticks == 0 and kind == _AT_REST:
            return True, f"{NOT_OBSERVABLE}: the leg did not move"
        good, text = _at_most("error", s.error_m, FOUND_m)
        if kind == _AT_REST:
            return good, f"harmless, {text}" if good else f"not found: {text}"
        return False, f"not found: error {_mm(s.error_m)}"
    if kind in _FORGED:
        return False, f"not declared, {_mm(s.error_m)} of error"
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
