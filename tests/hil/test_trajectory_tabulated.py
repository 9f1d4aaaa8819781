"""Evaluation before the run: the same bits at the loop's ticks, and between them."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from drivers.errors import ConfigurationError
from hil.config.reference import (
    HoldReference,
    MultisineReference,
    SampledReference,
    SinusoidReference,
    TimeOptimalReference,
    WaypointReference,
)
from hil.config.values import Pose
from hil.loop.motion import Motion
from hil.trajectory.build import build_trajectory
from hil.trajectory.tabulated import TabulatedTrajectory

DATA = Path(__file__).parent.parent / "data"
HOME = Pose(position_m=(0, 0, 1))
LIMITS: dict[Any, Any] = {
    **dict.fromkeys(("velocity_m_s", "acceleration_m_s2"), 0.5),
    **dict.fromkeys(("velocity_deg_s", "acceleration_deg_s2", "jerk_deg_s3"), 100),
    "jerk_m_s3": 5,
}
POSES: list[dict[str, Any]] = [
    {"position_m": [0, 0, 1]},
    {"position_m": [0.1, 0, 1.1], "rotation_vector_deg": [5, 0, 3]},
    {"position_m": [0, 0, 1]},
]
POINTS: list[dict[str, Any]] = [{"t_s": k, **pose} for k, pose in enumerate(POSES)]
KINDS: dict[Any, dict[str, Any]] = {
    HoldReference: {"type": "hold", "duration_s": 0.7},
    WaypointReference: {"type": "waypoints", "points": POINTS, "periods": 2},
    TimeOptimalReference: {"type": "time_optimal", "points": POSES, "limits": LIMITS, "periods": 2},
    SinusoidReference: {
        "type": "sinusoids",
        "components": [{"axis": "rx_deg", "amplitude": 5, "frequency_Hz": 0.7}],
        "duration_s": 2.5,
    },
    MultisineReference: {
        "type": "multisine",
        "axes": [{"axis": "z_m", "band_Hz": [1, 5], "lines": 9, "amplitude": 0.02}],
        "period_s": 2,
    },
    SampledReference: {"type": "sampled", "path": "path.csv"},
}


def build(kind, evaluation, period_s):
    settings = kind.model_validate({**KINDS[kind], "evaluation": evaluation})
    return build_trajectory(settings, HOME, DATA, period_s)


@pytest.mark.parametrize("rate", [1000.0, 333.0])
@pytest.mark.parametrize("kind", KINDS)
def test_a_table_gives_the_bits_of_the_evaluation_in_the_loop(kind, rate):
    online, offline = (build(kind, evaluation, 1 / rate) for evaluation in ("online", "offline"))
    assert isinstance(offline, TabulatedTrajectory)
    assert not isinstance(online, TabulatedTrajectory)
    assert offline.duration_s == online.duration_s
    here, there = (Motion(1 / rate, np.zeros(3), np.eye(3), 0.5) for _ in range(2))
    here.start(online, 17)
    there.start(offline, 17)
    for tick in range(17, 17 + int(online.duration_s * rate) + 20):
        for a, b in zip(here.sample(tick), there.sample(tick), strict=True):
            assert a.tobytes() == b.tobytes()


def test_the_table_is_read_and_not_evaluated_again():
    class Counted:
        duration_s = 0.1
        calls = 0

        def sample(self, t):
            self.calls += 1
            return build(HoldReference, "online", None).sample(t)

    counted = Counted()
    table = TabulatedTrajectory(counted, 1e-3)
    before = counted.calls
    for tick in range(101):
        table.sample(tick * 1e-3)
    assert counted.calls == before
    table.sample(0.5e-3)
    assert counted.calls == before + 1


def test_a_stop_along_the_path_is_the_same():
    online, offline = (build(WaypointReference, evaluation, 1e-3) for evaluation in ("online", "offline"))
    here, there = (Motion(1e-3, np.zeros(3), np.eye(3), 0.5) for _ in range(2))
    for motion, trajectory in ((here, online), (there, offline)):
        motion.start(trajectory, 0)
        motion.stop(440, 0.5)
    for tick in range(440, 1000):
        for a, b in zip(here.sample(tick), there.sample(tick), strict=True):
            assert a.tobytes() == b.tobytes()


def test_what_has_no_end_cannot_be_evaluated_before_the_run():
    settings = HoldReference(type="hold", evaluation="offline")
    for period in (None, 1e-3):
        with pytest.raises(ConfigurationError, match=r"reference.evaluation: offline .* no end"):
            build_trajectory(settings, HOME, None, period)


def test_a_table_that_would_be_too_large_is_refused():
    settings = HoldReference(type="hold", evaluation="offline", duration_s=3600)
    with pytest.raises(ConfigurationError, match=r"3600002 ticks would take 691 MB, allowed: at most 256"):
        build_trajectory(settings, HOME, None, 1e-3)


def test_what_was_evaluated_before_the_run_cannot_be_altered_by_who_reads_it():
    path = build(WaypointReference, "offline", 0.01)
    assert isinstance(path, TabulatedTrajectory)
    before = [column.tobytes() for column in path.sample(0.5)]
    for column in path.sample(0.5):
        np.add(column, 1.0, out=column)
    assert [column.tobytes() for column in path.sample(0.5)] == before
