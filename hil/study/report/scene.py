"""The pose over time, for the picture that plays."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from drivers.arrays import Array, Rows
from hil.app.configuration.configuration import Configuration
from hil.app.configuration.platform import platform_dict
from hil.study.report.samples import packed

FRAMES = 1500
"""At most; a picture of each moment between two is made by the page."""


def has_pose(rows: Rows, p: str, R: str) -> NDArray[np.bool_]:
    """Tell in which rows (n,) two columns hold a pose: finite, and a rotation that has been filled."""
    rotation = rows[R].reshape(len(rows), -1)
    there: NDArray[np.bool_] = rotation.any(axis=1) & np.isfinite(rotation).all(axis=1)
    there &= np.isfinite(rows[p]).all(axis=1)
    return there


def scene(rows: Rows, t: Array, c: Configuration) -> dict[str, Any] | None:
    """Return joints, poses and leg forces for the page; None where the log has no pose.

    t (n,) s. p (m, 3) m and R (m, 9) of platform and reference in the base frame; load (m, 6): tau as a share
    of the largest force that is allowed.
    """
    posed = np.flatnonzero(has_pose(rows, "p", "R"))
    if not len(posed):
        return None
    kept = posed[np.unique(np.linspace(0, len(posed) - 1, FRAMES).astype(np.int64))]
    robot = platform_dict(c.platform)
    limit = min(c.limits.force_N, c.drives.force_limit_N)
    return {
        "base": np.asarray(robot["base_joints"], np.float64).tolist(),
        "platform": np.asarray(robot["platform_joints"], np.float64).tolist(),
        "t": packed(t[kept]),
        **{name: packed(rows[name][kept]) for name in ("p", "R", "p_d", "R_d")},
        "load": packed(rows["tau"][kept] / limit),
    }
