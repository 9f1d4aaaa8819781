"""Metrics of a simulated run, measured while it runs: peaks, rms values and counts, in bounded memory.

Ticks are processed in blocks. Blocks and the order of sums are fixed: the same ticks give bit-identical
metrics, in the run and from its log.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from drivers.arrays import Array, Rows
from drivers.signals import Mode, Warn
from drivers.tick_columns import ROW
from hil.record.metrics import rotation_errors

BLOCK = 100
"""Ticks of a block; limits are checked once per block."""
_POWERED = (*range(Mode.LOADING, Mode.UNLOADING + 1), Mode.HELD)
_LIMITED = Warn.FORCE_LIMIT | Warn.FORCE_STEP | Warn.FORCE_WINDOW


class Metric(NamedTuple):
    """Unit and meaning of one metric of a run."""

    unit: str
    meaning: str


METRICS: dict[str, Metric] = {
    "faulted": Metric("1", "1 if a fault was latched, else 0"),
    "tracked_s": Metric("s", "time along the reference"),
    "peak_leg_error_mm": Metric("mm", "largest q_d - q of a leg while tracking, as measured"),
    "rms_leg_error_mm": Metric("mm", "root mean square of this error over legs and ticks"),
    "peak_true_leg_error_mm": Metric("mm", "largest q_d - true length of a leg while tracking"),
    "rms_true_leg_error_mm": Metric("mm", "root mean square of this error over legs and ticks"),
    "peak_position_error_mm": Metric("mm", "largest distance of the measured pose from its reference"),
    "rms_position_error_mm": Metric("mm", "root mean square of this error"),
    "peak_rotation_error_deg": Metric("deg", "largest angle between the measured pose and its reference"),
    "rms_rotation_error_deg": Metric("deg", "root mean square of this error"),
    "peak_force_N": Metric("N", "largest force sent to a leg in the whole run"),
    "force_variation_N": Metric("N", "total variation of the most active leg's force while tracking"),
    "peak_leg_rate_m_s": Metric("m/s", "largest measured rate of a leg while tracking"),
    "limited_ticks": Metric("1", "ticks in which a force limit acted"),
    "stale_ticks": Metric("1", "powered ticks without fresh feedback of every leg"),
    "certificate_percent": Metric("%", "largest sqrt(V) of an axis, as a share of its limit"),
    "travel_mm": Metric("mm", "largest true travel of a leg after a fault, else 0; after_fault: rest"),
}
"""Name -> description, in the order of the table. A value of None means: not measured."""
COUNTED: dict[str, Callable[[Rows], NDArray[Any]]] = {
    "limited_ticks": lambda rows: rows["warnings"] & _LIMITED,
    "stale_ticks": lambda rows: (rows["age"] > 0).any(axis=1) & np.isin(rows["mode"], _POWERED),
}
"""Metrics that count the ticks with a value other than 0."""
COUNTS = frozenset({"faulted", *COUNTED})
"""Metrics that are integers."""
FOLLOWED: dict[str, Callable[[Rows, Array], Array]] = {
    "leg_error_mm": lambda rows, _: 1e3 * (rows["q_d"] - rows["q"]),
    "true_leg_error_mm": lambda rows, length: 1e3 * (rows["q_d"] - length),
    "position_error_mm": lambda rows, _: np.linalg.norm(1e3 * (rows["p_d"] - rows["p"]), axis=1),
    "rotation_error_deg": lambda rows, _: np.linalg.norm(
        np.rad2deg(rotation_errors(rows["R_d"], rows["R"])), axis=1
    ),
}
"""Errors with a peak_ and an rms_ metric, from tracking rows (n,) and true lengths (n, 6) m."""


class Measurement:
    """Measures the metrics of one run tick by tick.

    travels: the run continues after a fault. Mutable state: the ticks of the unfinished block, and the totals
    of the finished blocks.
    """

    def __init__(self, *, travels: bool) -> None:
        self._travels = travels
        self._ticks: list[tuple[Any, Array]] = []
        self._peaks: dict[str, float] = {}
        self._squares: dict[str, tuple[float, int]] = {}
        self._counts = dict.fromkeys(sorted(COUNTS), 0)
        self._tau: Array = np.zeros((0, 6))
        self._variation = np.zeros(6)
        self._tracked_s: float | None = None
        self._stood: Array | None = None

    def take(self, row: Any, length: Array) -> bool:
        """Add a tick (dtype ROW) and the true leg lengths (6,) m; True if this completes a block."""
        self._ticks.append((row, length))
        if len(self._ticks) < BLOCK:
            return False
        self._block()
        return True

    def figures(self) -> dict[str, Any]:
        """Value of each metric in METRICS so far, None: not measured. Ends the current block."""
        if self._ticks:
            self._block()
        found = dict(self._peaks)
        found |= {name: float(np.sqrt(total / n)) for name, (total, n) in self._squares.items()}
        if self._travels:
            found.setdefault("travel_mm", 0.0)
        if self._tracked_s is not None:
            found |= {"tracked_s": self._tracked_s, "force_variation_N": float(self._variation.max())}
        measured = {name: float(value) for name, value in found.items() if np.isfinite(value)}
        return dict.fromkeys(METRICS) | measured | self._counts

    def growing(self) -> dict[str, float]:
        """Peaks and counts of the finished blocks; these metrics never decrease during a run."""
        return self._peaks | self._counts

    @np.errstate(over="ignore", invalid="ignore")
    def _block(self) -> None:
        given, true = zip(*self._ticks, strict=True)
        rows, lengths = np.array(list(given), ROW), np.array(true)
        self._ticks = []
        self._peak("peak_force_N", rows["tau"])
        share = rows["lyapunov_share"]
        self._peak("certificate_percent", 100.0 * share[np.isfinite(share)])
        for name, of in COUNTED.items():
            self._counts[name] += int(np.count_nonzero(of(rows)))
        faulted = rows["faults"] != 0
        self._counts["faulted"] |= int(faulted.any())
        if self._travels and faulted.any():
            if self._stood is None:  # where the legs were at the first latched fault
                self._stood = lengths[faulted][0]
            self._peak("travel_mm", 1e3 * (lengths[faulted] - self._stood))
        tracking = rows["mode"] == Mode.TRACKING
        if tracking.any():
            self._follow(rows[tracking], lengths[tracking])

    def _follow(self, rows: Rows, lengths: Array) -> None:
        for name, of in FOLLOWED.items():
            values = of(rows, lengths)
            self._peak(f"peak_{name}", values)
            total, n = self._squares.get(f"rms_{name}", (0.0, 0))
            self._squares[f"rms_{name}"] = (total + float((values**2).sum()), n + values.size)
        self._peak("peak_leg_rate_m_s", rows["dq"])
        self._variation += np.abs(np.diff(np.vstack([self._tau, rows["tau"]]), axis=0)).sum(axis=0)
        self._tau = rows["tau"][-1:]
        self._tracked_s = float(rows["reference_time_s"][-1])

    def _peak(self, name: str, values: Array) -> None:
        """Raise a stored peak to the largest magnitude in `values`; a NaN stays."""
        if values.size:
            self._peaks[name] = float(np.maximum(self._peaks.get(name, 0.0), np.abs(values).max()))
