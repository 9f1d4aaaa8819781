"""Ticks of a log that `hil identify` uses, and refused configurations."""

from __future__ import annotations

import numpy as np
import pytest

from drivers.errors import ConfigurationError
from drivers.signals import DriveState, Mode
from drivers.tick_columns import ROW
from hil.app.configuration.configuration import load
from hil.lab.identify.axes import excited_axes
from hil.lab.identify.delay import excited, motion_of
from hil.lab.identify.linearised import linearised_law, signals_of
from hil.robot.kinematics import jacobian

COUNT = 12


def running(tick=range(COUNT)):
    """Rows that track, brakes open, all legs fresh."""
    ticks = np.array(tick)
    rows = np.zeros(len(ticks), ROW)
    rows["tick"], rows["mode"], rows["drive_state"] = ticks, Mode.TRACKING, DriveState.RUN
    rows["p"], rows["R"] = (0.0, 0.0, 1.0), np.eye(3)
    rows["q"] = 1.5 + 1e-3 * ticks[:, None]
    rows["drive_force"] = rows["tau"] = 3000.0
    return rows


def by_delay(rows):
    return motion_of(rows, 1e-3).usable


def by_axes(rows):
    good = signals_of(rows, linearised_law(load("virtual")), 1000.0)[0].good
    return good[1:] & good[:-1]


@pytest.fixture(params=[by_delay, by_axes])
def usable(request):
    """A function for the usable periods of rows, by each command."""
    return lambda rows: request.param(rows).tolist()


def without(*ticks):
    """Usable periods if these ticks are bad."""
    return [k not in ticks and k + 1 not in ticks for k in range(COUNT - 1)]


def test_identification_skips_missing_ticks_and_ticks_with_stale_legs(usable):
    assert usable(running()) == without()
    assert usable(running([k for k in range(COUNT) if k not in {3, 7, 8}])) == without(3, 7, 8)
    for leg in range(6):
        rows = running()
        rows["age"][5, leg], rows["age"][9, leg] = 1, 7
        assert usable(rows) == without(5, 9)


def test_compensated_wrench_is_removed_from_the_demanded_acceleration():
    """By hand: leg accelerations J M^-1 wrench, which a compensating law subtracts from its forces."""
    law = linearised_law(load("virtual"))
    rows, w = running(), np.array([300.0, -200.0, 500.0, 40.0, 60.0, -90.0])
    plain = signals_of(rows, law, 1000.0)[0].v
    rows["wrench"] = w
    J = jacobian(law.model.platform, rows["p"][0], np.eye(3))
    felt = J @ np.linalg.solve(law.model.mass_matrix(rows["p"][0], np.eye(3)), w)
    assert np.abs(felt).min() > 1e-3
    for takes_off, more in ((True, felt), (False, 0.0 * felt)):
        v = signals_of(rows, law._replace(takes_wrench_off=takes_off), 1000.0)[0].v
        assert v - plain == pytest.approx(np.tile(more, (COUNT, 1)), abs=1e-9)


def fused(c):
    return c.model_copy(update={"estimation": c.estimation.model_copy(update={"pose": "fused"})})


@pytest.mark.parametrize("excite", [excited, excited_axes])
def test_identification_with_a_fused_pose_is_refused_before_the_run(excite):
    c = fused(load("virtual"))
    with pytest.raises(ConfigurationError, match="fused"):
        excite(c, None, None)
