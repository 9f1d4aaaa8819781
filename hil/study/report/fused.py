"""What the rules on encoders and a fused pose judge, from the recorded columns of the filter."""

import numpy as np
from numpy.typing import NDArray

from drivers.arrays import Array, Ints, Rows
from drivers.signals import LEGS, Fault, Mode
from hil.app.configuration.configuration import Configuration


def is_fused(c: Configuration) -> bool:
    """Tell whether the pose of a configuration is fused."""
    return c.estimation.pose == "fused"


def excused(rows: Rows, c: Configuration) -> NDArray[np.bool_]:
    """Tell which encoders do not count although their legs are needed, (n, 6): see `PoseFusion`."""
    fusion = c.estimation.fusion
    lost = (rows["legs_lost"][:, None] >> np.arange(LEGS) & 1) > 0
    may = np.isin(np.arange(LEGS), fusion.may_lose_legs) & is_fused(c)
    few: NDArray[np.bool_] = lost.sum(axis=1) <= fusion.lost_at_once
    return lost & may & few[:, None]


def counted_age(rows: Rows, mode: Ints, c: Configuration) -> Ints:
    """Return the age of each leg's feedback as safety judges it, (n, 6) ticks: 0 for a leg that may be lost.

    mode (n,): no estimate proves a brake, so that every leg counts while the brakes are tested; and where
    its age has just been a fault.
    """
    proves = np.isin(mode, (Mode.LOADING, Mode.UNLOADING)) | ((rows["faults"] & Fault.STALE) != 0)
    age: Ints = np.where(excused(rows, c) & ~proves[:, None], 0, rows["age"])
    return age


def position_std_m(rows: Rows) -> Array:
    """Return the filter's standard deviation of the position over all directions, (n,) m."""
    std: Array = np.linalg.norm(rows["pose_std"][:, :3], axis=1)
    return std


def alone_s(rows: Rows, c: Configuration, rate_Hz: float) -> Array:
    """Return for how long the pose had no sample of the tracker while an encoder was lost, (n,) s; else 0."""
    tick = rows["tick"]
    heard = np.maximum.accumulate(np.where(rows["tracker"] > 0, tick, tick[:1]))
    alone: Array = np.where(excused(rows, c).any(axis=1), (tick - heard) / rate_Hz, 0.0)
    return alone


def against_m(rows: Rows) -> Array:
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
