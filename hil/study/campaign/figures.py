"""What is measured of a run while it goes: peaks, sums and counts, in blocks of ticks, in bounded memory.

Blocks and the order of sums are fixed, so that the same ticks give the same figures to the bit, in the run
and from its log.
"""

from typing import Any, NamedTuple

import numpy as np

from drivers.arrays import Array, Rows
from drivers.signals import Mode, Warn
from drivers.tick_columns import ROW
from hil.record.figures import pose_errors
from hil.study.campaign.settings import Limit

BLOCK = 100
"""Ticks that are looked at together; limits are judged that often."""
_POWERED = (*range(Mode.LOADING, Mode.UNLOADING + 1), Mode.HELD)
_LIMITED = Warn.FORCE_LIMIT | Warn.FORCE_STEP | Warn.FORCE_WINDOW


class Metric(NamedTuple):
    """One figure of a run."""

    unit: str
    meaning: str


METRICS: dict[str, Metric] = {
    "faulted": Metric("1", "whether a fault was latched, 0 or 1"),
    "tracked_s": Metric("s", "time along the reference"),
    "peak_leg_error_mm": Metric("mm", "largest q_d - q of a leg while tracking, as measured"),
    "rms_leg_error_mm": Metric("mm", "its root of the mean square over legs and ticks"),
    "peak_true_leg_error_mm": Metric("mm", "largest q_d - true length of a leg while tracking"),
    "rms_true_leg_error_mm": Metric("mm", "its root of the mean square over legs and ticks"),
    "peak_position_error_mm": Metric("mm", "largest distance of the measured pose from its reference"),
    "rms_position_error_mm": Metric("mm", "its root of the mean square"),
    "peak_rotation_error_deg": Metric("deg", "largest angle of the measured pose to its reference"),
    "rms_rotation_error_deg": Metric("deg", "its root of the mean square"),
    "peak_force_N": Metric("N", "largest force sent to a leg in the whole run"),
    "force_variation_N": Metric("N", "sum of |changes| of the leg whose force varies most, while tracking"),
    "peak_leg_rate_m_s": Metric("m/s", "largest measured rate of a leg while tracking"),
    "limited_ticks": Metric("1", "ticks at which a limit of the force acted"),
    "stale_ticks": Metric("1", "powered ticks without a fresh feedback of every leg"),
    "certificate_percent": Metric("%", "largest share of its bound that the certificate's V took"),
    "travel_mm": Metric("mm", "largest true travel of a leg after a fault, 0 without; after_fault: rest"),
}
"""Name -> what it is, in the order of the table. None in a row: it was not measured."""
COUNTS = frozenset({"faulted", "limited_ticks", "stale_ticks"})
"""Metrics that are whole numbers."""


def broken(limits: dict[str, Limit], figures: dict[str, Any]) -> list[str]:
    """Return the metrics that are out of their limits; one that was not measured is, too."""
    return [
        name
        for name, limit in limits.items()
        if (value := figures.get(name)) is None
        or (limit.min is not None and not value >= limit.min)
        or (limit.max is not None and not value <= limit.max)
    ]


class Measurement:
    """The figures of one run.

    `travels`: the run goes on after a fault. Mutable state: the ticks of the block that is not full, and what
    the blocks before amount to.
    """

    def __init__(self, *, travels: bool) -> None:
        self._travels = travels
        self._rows: list[Any] = []
        self._lengths: list[Array] = []
        self._peaks: dict[str, float] = {}
        self._squares: dict[str, tuple[float, int]] = {}
        self._counts = dict.fromkeys(sorted(COUNTS), 0)
        self._tau: Array | None = None
        self._variation = np.zeros(6)
        self._tracked_s: float | None = None
        self._stood: Array | None = None

    def take(self, row: Any, length: Array) -> bool:
        """Take in a tick of dtype ROW and the true lengths (6,) m; tell whether a block is full."""
        self._rows.append(row)
        self._lengths.append(length)
        if len(self._rows) < BLOCK:
            return False
        self._block()
        return True

    def figures(self) -> dict[str, Any]:
        """Return all METRICS as they are by now, None where no number was measured. Closes the block."""
        if self._rows:
            self._block()
        found = dict(self._peaks)
        found |= {name: float(np.sqrt(total / n)) for name, (total, n) in self._squares.items()}
        if self._travels:
            found.setdefault("travel_mm", 0.0)
        if self._tracked_s is not None:
            found |= {"tracked_s": self._tracked_s, "force_variation_N": float(self._variation.max())}
        measured = {name: float(value) for name, value in found.items() if np.isfinite(value)}
        return dict.fromkeys(METRICS) | measured | self._counts

    def passed_limit(self, limits: dict[str, Limit]) -> bool:
        """Tell whether a peak or a count is past its limit: more ticks do not mend it."""
        found = self._peaks | self._counts
        return any(
            limit.max is not None and found.get(name, limit.max) > limit.max for name, limit in limits.items()
        )

    def _block(self) -> None:
        rows, lengths = np.array(self._rows, ROW), np.array(self._lengths)
        self._rows, self._lengths = [], []
        self._peak("peak_force_N", np.abs(rows["tau"]))
        share = rows["lyapunov_share"]
        self._peak("certificate_percent", 100.0 * share[np.isfinite(share)])
        stale = (rows["age"] > 0).any(axis=1) & np.isin(rows["mode"], _POWERED)
        self._counts["stale_ticks"] += int(np.count_nonzero(stale))
        self._counts["limited_ticks"] += int(np.count_nonzero(rows["warnings"] & _LIMITED))
        self._counts["faulted"] |= int((rows["faults"] != 0).any())
        if self._travels:
            self._travelled(rows, lengths)
        tracking = rows["mode"] == Mode.TRACKING
        if tracking.any():
            self._tracking(rows[tracking], lengths[tracking])

    def _travelled(self, rows: Rows, lengths: Array) -> None:
        """Note how far the legs are from where they were at the first latched fault."""
        faulted = np.flatnonzero(rows["faults"])
        if self._stood is None and len(faulted):
            self._stood = lengths[faulted[0]]
        if self._stood is not None and len(faulted):
            self._peak("travel_mm", 1e3 * np.abs(lengths[faulted] - self._stood))

    @np.errstate(over="ignore", invalid="ignore")
    def _tracking(self, rows: Rows, lengths: Array) -> None:
        measured, true = 1e3 * (rows["q_d"] - rows["q"]), 1e3 * (rows["q_d"] - lengths)
        p_mm, r_deg = (np.linalg.norm(e, axis=1) for e in pose_errors(rows))
        for name, values in (
            ("leg_error_mm", np.abs(measured)),
            ("true_leg_error_mm", np.abs(true)),
            ("position_error_mm", p_mm),
            ("rotation_error_deg", r_deg),
        ):
            self._peak(f"peak_{name}", values)
            total, n = self._squares.get(f"rms_{name}", (0.0, 0))
            self._squares[f"rms_{name}"] = (total + float((values**2).sum()), n + values.size)
        self._peak("peak_leg_rate_m_s", np.abs(rows["dq"]))
        tau = rows["tau"] if self._tau is None else np.vstack([self._tau, rows["tau"]])
        self._variation += np.abs(np.diff(tau, axis=0)).sum(axis=0)
        self._tau = rows["tau"][-1]
        self._tracked_s = float(rows["reference_time_s"][-1])

    def _peak(self, name: str, values: Array) -> None:
        """Raise a peak to the largest of some values; one that is no number stays."""
        if values.size:
            self._peaks[name] = float(np.maximum(self._peaks.get(name, 0.0), values.max()))
