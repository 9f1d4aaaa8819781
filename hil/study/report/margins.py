"""How near a run came to each limit of the controller, from its recorded rows.

The quantities are those of the rules in `hil.safety`, over the ticks in which each of them is judged.
"""

from collections.abc import Iterator
from operator import attrgetter
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import maximum_filter1d, minimum_filter1d

from drivers.arrays import Array, Ints, Rows
from drivers.signals import LEGS, Fault, Mode
from drivers.tick_columns import COLUMNS
from hil.app.configuration.configuration import Configuration
from hil.estimation.fusion_tick import SLIP_TICKS
from hil.safety.guard import WINDOW_S
from hil.safety.motion import CREEP
from hil.safety.signals import DEAD_BUS, HARMFUL_STRETCH_NS, HISTORY, STRETCH_FREE_NS, UNRELIABLE

Mask = NDArray[np.bool_]
_CLOSED = (Mode.IDLE, Mode.LOADING, Mode.UNLOADING, Mode.PARKED)
"""Modes in which the legs stand on closed brakes."""


M, S, TICKS = COLUMNS["q"].unit, COLUMNS["reference_time_s"].unit, COLUMNS["age"].unit


class Judged(NamedTuple):
    """What a rule judges."""

    name: str
    key: str
    """Where the configuration has the limit; empty where it is a constant."""
    values: Any
    """(n,) or (n, 6), not negative."""
    unit: str
    judged: Mask
    """(n,) ticks in which it is judged."""
    limit: Any = None
    """Number or an array like the values; None: what is at the key."""


class Margin(NamedTuple):
    """The instant at which a run came nearest to a limit."""

    name: str
    key: str
    """Where the configuration has the limit; empty where it is a constant."""
    value: float
    limit: float
    unit: str
    row: int
    leg: int | None

    @property
    def used_percent(self) -> float:
        """Share of the limit that was used; beyond 100 the limit was passed."""
        return 100.0 * self.value / self.limit if self.limit else float("inf")


def margins(rows: Rows, c: Configuration, rate_Hz: float) -> list[Margin]:
    """Return the smallest margin of every limit that was judged, the nearest first. rows has dtype ROW."""
    found = [_nearest(each, c) for each in _all(rows, c, rate_Hz)]
    return sorted(filter(None, found), key=lambda m: -m.used_percent)


def _all(rows: Rows, c: Configuration, rate_Hz: float) -> Iterator[Judged]:
    mode = rows["mode"]
    well = rows["faults"] == 0
    struck = np.concatenate((well[:1], well[:-1]))  # the tick of a fault counts, what its reaction does not
    before = np.concatenate((mode[:1], mode[:-1]))  # and its rules were those of the mode until then
    mode = np.where(well, mode, before)
    powered = ((mode >= Mode.LOADING) & (mode <= Mode.UNLOADING) | (mode == Mode.HELD)) & (well | struck)
    follows = (mode >= Mode.RELEASING) & (mode <= Mode.PARKING) & powered
    yield from _forces(rows, c, rate_Hz, powered & well)
    yield from _legs(rows, c, powered, follows)
    stands = np.isin(mode, _CLOSED) & (well | struck)
    yield Judged("motion on closed brakes", "limits.standstill_m", _moved(rows, stands), M, stands)
    name, residual = "residual of forward kinematics", rows["fk_residual"]
    yield Judged(name, "limits.consistency_m", residual, COLUMNS["fk_residual"].unit, powered)
    name, condition = "condition number of J", rows["condition"]
    yield Judged(name, "limits.condition", condition, COLUMNS["condition"].unit, powered)
    age = _counted_age(rows, mode, c)
    yield Judged("age of a leg's feedback", "limits.stale_fault_ticks", age, TICKS, powered)
    name, share = "length of an encoder against its rate, of what is allowed", rows["encoder_share"]
    yield Judged(name, "monitor.length_noise_m", share, "1", (mode >= Mode.IDLE) & (well | struck), 1.0)
    confirm = c.monitor.confirm_ticks
    name = f"Lyapunov function, sqrt(V) of an axis over what is allowed, {confirm} ticks in a row"
    share = rows["lyapunov_share"]
    yield Judged(name, "monitor", _lasting(share, confirm), "1", powered & np.isfinite(share), 1.0)
    yield from _fused(rows, c, rate_Hz, powered)
    yield from _loop(rows, c, powered)


def _forces(rows: Rows, c: Configuration, rate_Hz: float, powered: Mask) -> Iterator[Judged]:
    tau, unit, rated = rows["tau"], COLUMNS["tau"].unit, c.drives.force_limit_N
    key = "limits.force_N" if c.limits.force_N <= rated else "drives.force_limit_N"
    yield Judged("leg force", key, np.abs(tau), unit, powered)
    if powered.any():
        step = np.zeros_like(tau)
        step[1:] = np.abs(np.diff(tau, axis=0)) * (np.diff(rows["tick"]) == 1 + rows["skipped"][1:])[:, None]
        limit = c.limits.force_step_N * c.loop.rate_Hz / rate_Hz  # as `hil.app.compose` has it
        yield Judged("change of force in a tick", "limits.force_step_N", step, unit, powered, limit)
        n = max(2, round(WINDOW_S * rate_Hz) + 1)
        places, holds = _every_tick(rows["tick"], n)
        held = tau[holds]
        low = minimum_filter1d(held, n, axis=0, mode="nearest", origin=(n - 1) // 2)[places]
        high = maximum_filter1d(held, n, axis=0, mode="nearest", origin=(n - 1) // 2)[places]
        name, change = f"change of force within {1e3 * WINDOW_S:g} ms", np.maximum(tau - low, high - tau)
        yield Judged(name, "limits.force_window_N", change, unit, powered)


def _every_tick(tick: Ints, longest: int) -> tuple[Ints, Ints]:
    """Return the place of each row (n,) among all ticks (m,), and the row at or before each of these.

    A force is held through ticks that were skipped or are not in the log. Gaps count as `longest` at most.
    """
    gaps = np.clip(np.diff(tick), 1, longest)
    places = np.concatenate(([0], np.cumsum(gaps)))
    return places, np.repeat(np.arange(len(tick)), np.append(gaps, 1))


def _legs(rows: Rows, c: Configuration, powered: Mask, follows: Mask) -> Iterator[Judged]:
    limits, q, dq = c.limits, rows["q"], rows["dq"]
    speed, rate = COLUMNS["dq"].unit, np.abs(dq)
    low, high, margin = c.platform.length_min_m, c.platform.length_max_m, limits.stroke_margin_m
    middle, half = (high + low) / 2, (high - low) / 2
    name, key = "leg length from mid-stroke", "platform.length_max_m"
    yield Judged(name, key, np.abs(q - middle), M, powered, half)
    left = np.where(dq > 0.0, high - margin - q, q - low - margin)
    cap = np.maximum(np.sqrt(2.0 * limits.deceleration_m_s2 * np.maximum(left, 0.0)), CREEP)
    name, key = "leg rate that can stop before the soft end", "limits.deceleration_m_s2"
    yield Judged(name, key, rate, speed, powered, cap)
    yield Judged("leg rate", "limits.speed_m_s", rate, speed, powered)
    error = np.abs(rows["q_d"] - q)
    allowed = limits.following_error_m + limits.following_error_s * np.abs(rows["dq_d"])
    yield Judged("leg error", "limits.following_error_m", error, M, follows, allowed)
    if limits.acceleration_m_s2 is not None:
        name, key = "leg acceleration of the reference", "limits.acceleration_m_s2"
        yield Judged(name, key, np.abs(rows["ddq_d"]), COLUMNS["ddq_d"].unit, follows)


def _moved(rows: Rows, stands: Mask) -> Array:
    """Return how far each leg (n, 6) m is from where it was first heard since the brakes were closed."""
    moved = np.zeros((len(rows), LEGS))
    edges = np.flatnonzero(np.diff(np.concatenate(([0], stands.astype(np.int8), [0]))))
    for begin, end in edges.reshape(-1, 2).tolist():
        heard = rows["age"][begin:end] == 0
        for leg in np.flatnonzero(heard.any(axis=0)).tolist():
            q = rows["q"][begin:end, leg]
            moved[begin:end, leg] = np.where(heard[:, leg], np.abs(q - q[np.argmax(heard[:, leg])]), 0.0)
    return moved


def _loop(rows: Rows, c: Configuration, powered: Mask) -> Iterator[Judged]:
    run, missed = 0, np.zeros(len(rows))
    for k in np.flatnonzero(rows["skipped"][1:] > 0).tolist():
        run = int(rows["skipped"][k + 1]) + (run if k and rows["skipped"][k] > 0 else 0)
        missed[k + 1] = run
    yield Judged("periods missed in a row", "limits.missed_stop_ticks", missed, TICKS, powered)
    name = f"ticks of {HISTORY} in which the bus did not take our frames"
    yield Judged(name, "", _recent(rows["sends_failed"] > 0), TICKS, powered, DEAD_BUS)
    if not any(kind for _, kind in c.sensors):  # theirs are counted in the column, and by no rule
        name = f"ticks of {HISTORY} in which frames were refused"
        yield Judged(name, "", _recent(rows["rejected"] > 0), TICKS, powered, UNRELIABLE)
    stood = rows["stretched_ns"]
    harmful = np.cumsum(np.where(stood >= HARMFUL_STRETCH_NS, stood, 0))
    if len(rows) and harmful[-1]:
        allowed = STRETCH_FREE_NS + 0.01 * c.limits.stretch_percent * (rows["t_ns"] - rows["t_ns"][0])
        name, unit = "bench time that stood still", COLUMNS["stretched_ns"].unit
        yield Judged(name, "limits.stretch_percent", harmful, unit, powered, allowed)


def _fused(rows: Rows, c: Configuration, rate_Hz: float, powered: Mask) -> Iterator[Judged]:
    if c.estimation.pose != "fused":
        return
    key = "estimation.fusion"
    name, std = "standard deviation of the fused position", np.linalg.norm(rows["pose_std"][:, :3], axis=1)
    yield Judged(name, f"{key}.position_std_max_m", std, M, powered)
    name, limit = "encoder lost, and no sample of the tracker", 1e-3 * c.estimation.fusion.tracker_gap_max_ms
    yield Judged(name, f"{key}.tracker_gap_max_ms", _alone_s(rows, c, rate_Hz), S, powered, limit)
    name = f"encoder against the fused pose, {SLIP_TICKS} ticks in a row"
    yield Judged(name, f"{key}.encoder_slip_m", _lasting(_against_m(rows), SLIP_TICKS), M, powered)


def _lasting(values: Array, ticks: int) -> Array:
    """Return what values (n,) or (n, 6) did not fall below in the last so many rows; nan counts as 0."""
    n = min(ticks, len(values) + 1)
    filled = np.where(np.isnan(values), 0.0, values)
    least: Array = minimum_filter1d(filled, n, axis=0, origin=(n - 1) // 2, mode="constant")
    return least


def _recent(which: Mask) -> Array:
    """Return in how many of the last HISTORY ticks something was (n,)."""
    total: Array = np.concatenate((np.zeros(HISTORY), np.cumsum(which)))
    recent: Array = total[HISTORY:] - total[: len(which)]
    return recent


def _nearest(j: Judged, c: Configuration) -> Margin | None:
    """Return the value nearest to its limit among the rows that are judged; None where there is none."""
    values = np.asarray(j.values, np.float64)
    limit = np.asarray(attrgetter(j.key)(c) if j.limit is None else j.limit, np.float64)
    share = np.where(j.judged.reshape(-1, *(1,) * (values.ndim - 1)), values / limit, np.nan)
    if not np.isfinite(share).any():
        return None
    at = np.unravel_index(int(np.nanargmax(share)), share.shape)
    worst = float(np.broadcast_to(limit, share.shape)[at])
    leg = int(at[1]) if values.ndim > 1 else None
    return Margin(j.name, j.key, float(values[at]), worst, j.unit, int(at[0]), leg)


def _excused(rows: Rows, c: Configuration) -> NDArray[np.bool_]:
    """Tell which encoders do not count although their legs are needed, (n, 6): see `PoseFusion`."""
    fusion = c.estimation.fusion
    lost = (rows["legs_lost"][:, None] >> np.arange(LEGS) & 1) > 0
    may = np.isin(np.arange(LEGS), fusion.may_lose_legs) & (c.estimation.pose == "fused")
    few: NDArray[np.bool_] = lost.sum(axis=1) <= fusion.lost_at_once
    return lost & may & few[:, None]


def _counted_age(rows: Rows, mode: Ints, c: Configuration) -> Ints:
    """Return the age of each leg's feedback as safety judges it, (n, 6) ticks: 0 for a leg that may be lost.

    mode (n,): no estimate proves a brake, so that every leg counts while the brakes are tested; and where
    its age has just been a fault.
    """
    proves = np.isin(mode, (Mode.LOADING, Mode.UNLOADING)) | ((rows["faults"] & Fault.STALE) != 0)
    age: Ints = np.where(_excused(rows, c) & ~proves[:, None], 0, rows["age"])
    return age


def _alone_s(rows: Rows, c: Configuration, rate_Hz: float) -> Array:
    """Return for how long the pose had no sample of the tracker while an encoder was lost, (n,) s; else 0."""
    tick = rows["tick"]
    heard = np.maximum.accumulate(np.where(rows["tracker"] > 0, tick, tick[:1]))
    alone: Array = np.where(_excused(rows, c).any(axis=1), (tick - heard) / rate_Hz, 0.0)
    return alone


def _against_m(rows: Rows) -> Array:
    """Return by how much each length that was heard and left out is off its prediction, (n, 6) m; else 0.

    Once its encoder has slipped a leg is out of the question.
    """
    used, slipped = (
        (rows[name][:, None] >> np.arange(LEGS) & 1) > 0 for name in ("legs_used", "legs_slipped")
    )
    asked = (rows["age"] == 0) & ~used
    asked[1:] &= ~slipped[:-1]
    off: Array = np.where(asked, np.abs(rows["innovation_q"]), 0.0)
    return off
