"""How near a run came to each limit of the controller, from its recorded rows.

The quantities are those of the rules in `hil.safety`, over the ticks in which each of them is judged.
"""

from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import maximum_filter1d, minimum_filter1d

from drivers.arrays import Array, Ints, Rows
from drivers.signals import LEGS, Mode
from drivers.tick_columns import COLUMNS
from hil.app.configuration.configuration import Configuration
from hil.estimation.fusion_tick import SLIP_TICKS
from hil.safety.guard import WINDOW_S
from hil.safety.motion import CREEP
from hil.safety.signals import DEAD_BUS, HARMFUL_STRETCH_NS, HISTORY, STRETCH_FREE_NS, UNRELIABLE
from hil.study.report.fused import against_m, alone_s, counted_age, is_fused, position_std_m

Mask = NDArray[np.bool_]
_CLOSED = (Mode.IDLE, Mode.LOADING, Mode.UNLOADING, Mode.PARKED)
"""Modes in which the legs stand on closed brakes."""


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
    found = [m for m in _all(rows, c, rate_Hz) if m is not None]
    return sorted(found, key=lambda m: -m.used_percent)


def _all(rows: Rows, c: Configuration, rate_Hz: float) -> Iterator[Margin | None]:
    limits, mode = c.limits, rows["mode"]
    well = rows["faults"] == 0
    struck = np.concatenate((well[:1], well[:-1]))  # the tick of a fault counts, what its reaction does not
    before = np.concatenate((mode[:1], mode[:-1]))  # and its rules were those of the mode until then
    mode = np.where(well, mode, before)
    powered = ((mode >= Mode.LOADING) & (mode <= Mode.UNLOADING) | (mode == Mode.HELD)) & (well | struck)
    follows = (mode >= Mode.RELEASING) & (mode <= Mode.PARKING) & powered
    yield from _forces(rows, c, rate_Hz, powered & well)
    yield from _legs(rows, c, powered, follows)
    stands = np.isin(mode, _CLOSED) & (well | struck)
    moved = _moved(rows, stands)
    name, key = "motion on closed brakes", "limits.standstill_m"
    yield nearest(name, key, moved, limits.standstill_m, COLUMNS["q"].unit, stands)
    for name, column, limit in (
        ("residual of forward kinematics", "fk_residual", limits.consistency_m),
        ("condition number of J", "condition", limits.condition),
    ):
        unit = COLUMNS[column].unit
        key = f"limits.{'consistency_m' if column == 'fk_residual' else 'condition'}"
        yield nearest(name, key, rows[column], limit, unit, powered)
    age, ticks = counted_age(rows, mode, c), COLUMNS["age"].unit
    yield nearest(
        "age of a leg's feedback", "limits.stale_fault_ticks", age, limits.stale_fault_ticks, ticks, powered
    )
    name, share = "length of an encoder against its rate, of what is allowed", rows["encoder_share"]
    yield nearest(name, "monitor.length_noise_m", share, 1.0, "1", (mode >= Mode.IDLE) & (well | struck))
    confirm = c.monitor.confirm_ticks
    name = f"Lyapunov function, sqrt(V) of an axis over what is allowed, {confirm} ticks in a row"
    share = rows["lyapunov_share"]
    yield nearest(name, "monitor", _lasting(share, confirm), 1.0, "1", powered & np.isfinite(share))
    yield from _fused(rows, c, rate_Hz, powered)
    yield from _loop(rows, c, powered)


def _forces(rows: Rows, c: Configuration, rate_Hz: float, powered: Mask) -> Iterator[Margin | None]:
    limits, tau, unit = c.limits, rows["tau"], COLUMNS["tau"].unit
    rated = c.drives.force_limit_N
    key = "limits.force_N" if limits.force_N <= rated else "drives.force_limit_N"
    yield nearest("leg force", key, np.abs(tau), min(limits.force_N, rated), unit, powered)
    if powered.any():
        step = np.zeros_like(tau)
        step[1:] = np.abs(np.diff(tau, axis=0)) * (np.diff(rows["tick"]) == 1 + rows["skipped"][1:])[:, None]
        limit = limits.force_step_N * c.loop.rate_Hz / rate_Hz  # as `hil.app.compose` has it
        yield nearest("change of force in a tick", "limits.force_step_N", step, limit, unit, powered)
        n = max(2, round(WINDOW_S * rate_Hz) + 1)
        places, holds = _every_tick(rows["tick"], n)
        held = tau[holds]
        low = minimum_filter1d(held, n, axis=0, mode="nearest", origin=(n - 1) // 2)[places]
        high = maximum_filter1d(held, n, axis=0, mode="nearest", origin=(n - 1) // 2)[places]
        change = np.maximum(tau - low, high - tau)
        name = f"change of force within {1e3 * WINDOW_S:g} ms"
        yield nearest(name, "limits.force_window_N", change, limits.force_window_N, unit, powered)


def _every_tick(tick: Ints, longest: int) -> tuple[Ints, Ints]:
    """Return the place of each row (n,) among all ticks (m,), and the row at or before each of these.

    A force is held through ticks that were skipped or are not in the log. Gaps count as `longest` at most.
    """
    gaps = np.clip(np.diff(tick), 1, longest)
    places = np.concatenate(([0], np.cumsum(gaps)))
    return places, np.repeat(np.arange(len(tick)), np.append(gaps, 1))


def _legs(rows: Rows, c: Configuration, powered: Mask, follows: Mask) -> Iterator[Margin | None]:
    limits, q, dq = c.limits, rows["q"], rows["dq"]
    m, speed = COLUMNS["q"].unit, COLUMNS["dq"].unit
    low, high, margin = c.platform.length_min_m, c.platform.length_max_m, limits.stroke_margin_m
    middle, half = (high + low) / 2, (high - low) / 2
    yield nearest("leg length from mid-stroke", "platform.length_max_m", np.abs(q - middle), half, m, powered)
    left = np.where(dq > 0.0, high - margin - q, q - low - margin)
    cap = np.maximum(np.sqrt(2.0 * limits.deceleration_m_s2 * np.maximum(left, 0.0)), CREEP)
    yield nearest(
        "leg rate that can stop before the soft end",
        "limits.deceleration_m_s2",
        np.abs(dq),
        cap,
        speed,
        powered,
    )
    yield nearest("leg rate", "limits.speed_m_s", np.abs(dq), limits.speed_m_s, speed, powered)
    error = np.abs(rows["q_d"] - q)
    allowed = limits.following_error_m + limits.following_error_s * np.abs(rows["dq_d"])
    yield nearest("leg error", "limits.following_error_m", error, allowed, m, follows)
    if limits.acceleration_m_s2 is not None:
        name, key = "leg acceleration of the reference", "limits.acceleration_m_s2"
        unit = COLUMNS["ddq_d"].unit
        yield nearest(name, key, np.abs(rows["ddq_d"]), limits.acceleration_m_s2, unit, follows)


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


def _loop(rows: Rows, c: Configuration, powered: Mask) -> Iterator[Margin | None]:
    ticks = COLUMNS["age"].unit
    run, missed = 0, np.zeros(len(rows))
    for k in np.flatnonzero(rows["skipped"][1:] > 0).tolist():
        run = int(rows["skipped"][k + 1]) + (run if k and rows["skipped"][k] > 0 else 0)
        missed[k + 1] = run
    limit = c.limits.missed_stop_ticks
    yield nearest("periods missed in a row", "limits.missed_stop_ticks", missed, limit, ticks, powered)
    name = f"ticks of {HISTORY} in which the bus did not take our frames"
    yield nearest(name, "", _recent(rows["sends_failed"] > 0), DEAD_BUS, ticks, powered)
    if not any(kind for _, kind in c.sensors):  # theirs are counted in the column, and by no rule
        name = f"ticks of {HISTORY} in which frames were refused"
        yield nearest(name, "", _recent(rows["rejected"] > 0), UNRELIABLE, ticks, powered)
    stood = rows["stretched_ns"]
    harmful = np.cumsum(np.where(stood >= HARMFUL_STRETCH_NS, stood, 0))
    if len(rows) and harmful[-1]:
        allowed = STRETCH_FREE_NS + 0.01 * c.limits.stretch_percent * (rows["t_ns"] - rows["t_ns"][0])
        unit = COLUMNS["stretched_ns"].unit
        yield nearest(
            "bench time that stood still", "limits.stretch_percent", harmful, allowed, unit, powered
        )


def _fused(rows: Rows, c: Configuration, rate_Hz: float, powered: Mask) -> Iterator[Margin | None]:
    if not is_fused(c):
        return
    fusion, key = c.estimation.fusion, "estimation.fusion"
    m, s = COLUMNS["pose_std"].units[0], COLUMNS["reference_time_s"].unit
    name, std = "standard deviation of the fused position", position_std_m(rows)
    yield nearest(name, f"{key}.position_std_max_m", std, fusion.position_std_max_m, m, powered)
    name, limit = "encoder lost, and no sample of the tracker", 1e-3 * fusion.tracker_gap_max_ms
    yield nearest(name, f"{key}.tracker_gap_max_ms", alone_s(rows, c, rate_Hz), limit, s, powered)
    name = f"encoder against the fused pose, {SLIP_TICKS} ticks in a row"
    off = _lasting(against_m(rows), SLIP_TICKS)
    yield nearest(name, f"{key}.encoder_slip_m", off, fusion.encoder_slip_m, m, powered)


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


def nearest(name: str, key: str, values: Any, limit: Any, unit: str, judged: Mask) -> Margin | None:
    """Return the value nearest to its limit among the rows that are judged; None where there is none.

    values (n,) or (n, 6), not negative; limit a number or an array alike.
    """
    values = np.asarray(values, np.float64)
    share = np.where(judged.reshape(-1, *(1,) * (values.ndim - 1)), values / limit, np.nan)
    if not np.isfinite(share).any():
        return None
    at = np.unravel_index(int(np.nanargmax(share)), share.shape)
    worst = float(np.broadcast_to(np.asarray(limit, np.float64), share.shape)[at])
    return Margin(
        name, key, float(values[at]), worst, unit, int(at[0]), int(at[1]) if values.ndim > 1 else None
    )
