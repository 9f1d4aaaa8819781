"""Smallest margin of a run to each limit of the controller, from its recorded rows.

The quantities are those of the safety rules in `hil.safety`, over the ticks in which each rule applies.
"""

from collections.abc import Iterator
from operator import attrgetter
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from drivers.arrays import Array, Ints, Rows
from drivers.signals import LEGS, Fault, Mode
from drivers.tick_columns import COLUMNS
from hil.app.configuration.configuration import Configuration
from hil.estimation.fusion_tick import SLIP_TICKS
from hil.safety.guard import WINDOW_S
from hil.safety.motion import CREEP
from hil.safety.signals import DEAD_BUS, HARMFUL_STRETCH_NS, HISTORY, STRETCH_FREE_NS, UNRELIABLE

Mask = NDArray[np.bool_]
Judged = tuple[Any, ...]
"""Arguments of a rule: its name; the key of its limit, empty for a constant; values (n,) or (n, 6), >= 0; a
column with their unit, empty for none; mask (n,) of the ticks in which the rule applies; the limit, a number
or an array like the values, if it is not the value of the key.
"""
_CLOSED = (Mode.IDLE, Mode.LOADING, Mode.UNLOADING, Mode.PARKED)
"""Modes in which the legs stand on closed brakes."""


class Margin(NamedTuple):
    """Instant at which a run came nearest to a limit, with value and limit."""

    name: str
    key: str
    """Key of the limit in the configuration; empty for a constant."""
    value: float
    limit: float
    unit: str
    row: int
    leg: int | None

    @property
    def used_percent(self) -> float:
        """Value as a percentage of the limit; above 100 the limit was exceeded."""
        return 100.0 * self.value / self.limit if self.limit else float("inf")


def margins(rows: Rows, c: Configuration, rate_Hz: float) -> list[Margin]:
    """Smallest margin to every limit that applied, the nearest first. rows (n,), n > 0, has dtype ROW."""
    mode, well = rows["mode"], rows["faults"] == 0
    struck = np.concatenate((well[:1], well[:-1]))  # the tick of a fault counts, its reaction does not
    before = np.concatenate((mode[:1], mode[:-1]))  # with the rules of the mode before
    mode, counts = np.where(well, mode, before), well | struck
    powered = ((mode >= Mode.LOADING) & (mode <= Mode.UNLOADING) | (mode == Mode.HELD)) & counts
    follows = (mode >= Mode.RELEASING) & (mode <= Mode.PARKING) & powered
    braked, sampled = np.isin(mode, _CLOSED) & counts, (mode >= Mode.IDLE) & counts
    share, confirm = rows["lyapunov_share"], c.monitor.confirm_ticks
    age = _counted_age(rows, mode, c)
    encoder = "encoder length against its rate, as a share of the limit"
    sensor = "mean difference of a sensor from the legs, as a share of its limit"
    certified = f"Lyapunov function, sqrt(V) of an axis as a share of its limit, {confirm} ticks in a row"
    judged: list[Judged] = [
        *_forces(rows, c, rate_Hz, powered & well),
        *_legs(rows, c, powered, follows),
        ("motion on closed brakes", "limits.standstill_m", _moved(rows, braked), "q", braked),
        ("residual of forward kinematics", "limits.consistency_m", rows["fk_residual"], "q", powered),
        ("condition number of J", "limits.condition", rows["condition"], "condition", powered),
        ("age of a leg's feedback", "limits.stale_fault_ticks", age, "age", powered),
        (encoder, "monitor.length_noise_m", rows["encoder_share"], "", sampled, 1.0),
        (sensor, "sensors", _against_legs(rows), "", powered, 1.0),
        (certified, "monitor", _lasting(share, confirm), "", powered & np.isfinite(share), 1.0),
        *_fused(rows, c, rate_Hz, powered),
        *_loop(rows, c, powered),
    ]
    return sorted(filter(None, (_nearest(c, *each) for each in judged)), key=lambda m: -m.used_percent)


def _against_legs(rows: Rows) -> Array:
    """Largest `sensor_share` (n,) of the sensors that send; nan without one."""
    share = np.where(np.isinf(rows["sensor_share"]), np.nan, rows["sensor_share"])
    found: Array = np.fmax.reduce(share, axis=1)
    return found


def _forces(rows: Rows, c: Configuration, rate_Hz: float, powered: Mask) -> Iterator[Judged]:
    tau, rated = rows["tau"], c.drives.force_limit_N
    key = "limits.force_N" if c.limits.force_N <= rated else "drives.force_limit_N"
    yield "leg force", key, np.abs(tau), "tau", powered
    step = np.zeros_like(tau)
    step[1:] = np.abs(np.diff(tau, axis=0)) * (np.diff(rows["tick"]) == 1 + rows["skipped"][1:])[:, None]
    limit = c.limits.force_step_N * c.loop.rate_Hz / rate_Hz  # as `hil.app.compose` has it
    yield "change of force in a tick", "limits.force_step_N", step, "tau", powered, limit
    # a force is held through ticks that were skipped or are not in the log
    n = max(2, round(WINDOW_S * rate_Hz) + 1)
    gaps = np.append(np.clip(np.diff(rows["tick"]), 1, n), 1)
    places, held = np.cumsum(gaps) - gaps, np.repeat(tau, gaps, axis=0)
    low, high = (_running(extreme, held, n)[places] for extreme in (np.minimum, np.maximum))
    name, change = f"change of force within {1e3 * WINDOW_S:g} ms", np.maximum(tau - low, high - tau)
    yield name, "limits.force_window_N", change, "tau", powered


def _legs(rows: Rows, c: Configuration, powered: Mask, follows: Mask) -> Iterator[Judged]:
    limits, q, dq = c.limits, rows["q"], rows["dq"]
    low, high, margin = c.platform.length_min_m, c.platform.length_max_m, limits.stroke_margin_m
    off, half = np.abs(q - (high + low) / 2), (high - low) / 2
    yield "leg length from mid-stroke", "platform.length_max_m", off, "q", powered, half
    left = np.where(dq > 0.0, high - margin - q, q - low - margin)
    cap = np.maximum(np.sqrt(2.0 * limits.deceleration_m_s2 * np.maximum(left, 0.0)), CREEP)
    name, key = "leg rate that can stop before the soft end", "limits.deceleration_m_s2"
    yield name, key, np.abs(dq), "dq", powered, cap
    yield "leg rate", "limits.speed_m_s", np.abs(dq), "dq", powered
    allowed = limits.following_error_m + limits.following_error_s * np.abs(rows["dq_d"])
    error = np.abs(rows["q_d"] - q)
    yield "leg error", "limits.following_error_m", error, "q", follows, allowed
    name, key = "leg acceleration of the reference", "limits.acceleration_m_s2"  # None: no limit
    yield name, key, np.abs(rows["ddq_d"]), "ddq_d", follows


def _moved(rows: Rows, braked: Mask) -> Array:
    """Distance (n, 6) m of each leg from its first fresh reading since the brakes were closed."""
    moved = np.zeros((len(rows), LEGS))
    edges = np.flatnonzero(np.diff(np.concatenate(([0], braked.astype(np.int8), [0]))))
    for begin, end in edges.reshape(-1, 2).tolist():
        fresh = rows["age"][begin:end] == 0
        for leg in np.flatnonzero(fresh.any(axis=0)).tolist():
            q = rows["q"][begin:end, leg]
            moved[begin:end, leg] = np.where(fresh[:, leg], np.abs(q - q[np.argmax(fresh[:, leg])]), 0.0)
    return moved


def _loop(rows: Rows, c: Configuration, powered: Mask) -> Iterator[Judged]:
    skipped = rows["skipped"] * (np.arange(len(rows)) > 0)
    total = np.cumsum(skipped)
    missed = total - np.maximum.accumulate(np.where(skipped > 0, 0, total))
    yield "periods missed in a row", "limits.missed_stop_ticks", missed, "age", powered
    name = f"ticks of {HISTORY} in which the bus did not accept our frames"
    yield name, "", _recent(rows["sends_failed"] > 0), "age", powered, DEAD_BUS
    name = f"ticks of {HISTORY} in which frames were refused"
    alone = not any(kind for _, kind in c.sensors)  # the column also counts sensors
    yield name, "", _recent(rows["rejected"] > 0), "age", powered & alone, UNRELIABLE
    stood = rows["stretched_ns"]
    harmful = np.cumsum(np.where(stood >= HARMFUL_STRETCH_NS, stood, 0))
    allowed = STRETCH_FREE_NS + 0.01 * c.limits.stretch_percent * (rows["t_ns"] - rows["t_ns"][0])
    name, judged = "bench time that stood still", powered & (harmful[-1] > 0)
    yield name, "limits.stretch_percent", harmful, "stretched_ns", judged, allowed


def _fused(rows: Rows, c: Configuration, rate_Hz: float, powered: Mask) -> Iterator[Judged]:
    key, judged = "estimation.fusion", powered & (c.estimation.pose == "fused")
    name, std = "standard deviation of the fused position", np.linalg.norm(rows["pose_std"][:, :3], axis=1)
    yield name, f"{key}.position_std_max_m", std, "q", judged
    tick = rows["tick"]
    sampled = np.maximum.accumulate(np.where(rows["tracker"] > 0, tick, tick[:1]))
    alone_s = np.where(_excused(rows, c).any(axis=1), (tick - sampled) / rate_Hz, 0.0)
    name, limit = "encoder lost and no tracker sample", 1e-3 * c.estimation.fusion.tracker_gap_max_ms
    yield name, f"{key}.tracker_gap_max_ms", alone_s, "reference_time_s", judged, limit
    compared = (rows["age"] == 0) & ~_legs_of(rows, "legs_used")
    compared[1:] &= ~_legs_of(rows, "legs_slipped")[:-1]  # a slipped encoder is not compared
    against = _lasting(np.where(compared, np.abs(rows["innovation_q"]), 0.0), SLIP_TICKS)
    name = f"encoder against the fused pose, {SLIP_TICKS} ticks in a row"
    yield name, f"{key}.encoder_slip_m", against, "q", judged


def _legs_of(rows: Rows, column: str) -> Mask:
    """Mask (n, 6) of the legs whose bits are set in a column of leg bits."""
    legs: Mask = (rows[column][:, None] >> np.arange(LEGS) & 1) > 0
    return legs


def _lasting(values: Array, ticks: int) -> Array:
    """Smallest of the last `ticks` values in each row, (n,) or (n, 6): a level kept that long; NaN is 0."""
    n = min(ticks, len(values) + 1)
    filled = np.where(np.isnan(values), 0.0, values)
    return _running(np.minimum, np.concatenate([np.zeros_like(filled[:1]), filled]), n)[1:]


def _running(extreme: np.ufunc, values: Array, n: int) -> Array:
    """Minimum or maximum of each row and the n - 1 rows before it, as far as there are; values (m, ...)."""
    width = 1
    while width < n:
        shift = min(width, n - width)
        before = np.concatenate([np.repeat(values[:1], shift, axis=0), values])[: len(values)]
        values, width = extreme(values, before), width + shift
    return values


def _recent(which: Mask) -> Array:
    """Number (n,) of the last HISTORY ticks in which `which` was True."""
    return np.asarray(np.convolve(which, np.ones(HISTORY))[: len(which)], np.float64)


def _nearest(
    c: Configuration, name: str, key: str, of: Any, column: str, judged: Mask, given: Any = None
) -> Margin | None:
    """Value nearest to its limit among the rows in which the rule applies; None without such a value."""
    values = np.asarray(of, np.float64)
    limit = np.asarray(attrgetter(key)(c) if given is None else given, np.float64)
    share = np.where(judged.reshape(-1, *(1,) * (values.ndim - 1)), values / limit, np.nan)
    if not np.isfinite(share).any():
        return None
    at = np.unravel_index(int(np.nanargmax(share)), share.shape)
    worst = float(np.broadcast_to(limit, share.shape)[at])
    leg = int(at[1]) if values.ndim > 1 else None
    unit = COLUMNS[column].unit if column else "1"
    return Margin(name, key, float(values[at]), worst, unit, int(at[0]), leg)


def _excused(rows: Rows, c: Configuration) -> Mask:
    """Mask (n, 6) of lost encoders whose loss sensor fusion tolerates: see `PoseFusion`."""
    fusion, lost = c.estimation.fusion, _legs_of(rows, "legs_lost")
    may = np.isin(np.arange(LEGS), fusion.may_lose_legs) & (c.estimation.pose == "fused")
    excused: Mask = lost & may & (lost.sum(axis=1) <= fusion.lost_at_once)[:, None]
    return excused


def _counted_age(rows: Rows, mode: Ints, c: Configuration) -> Ints:
    """Age (n, 6), ticks, of each leg's feedback as the safety rules count it: 0 for a tolerated loss.

    mode (n,): every leg counts during brake tests, since an estimate cannot prove a brake, and in rows with a
    fault of age.
    """
    proves = np.isin(mode, (Mode.LOADING, Mode.UNLOADING)) | ((rows["faults"] & Fault.STALE) != 0)
    age: Ints = np.where(_excused(rows, c) & ~proves[:, None], 0, rows["age"])
    return age
