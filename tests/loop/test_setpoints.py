"""Live set-points in the closed loop: motion, refusal, recording, replay, and a stop on the way."""

import numpy as np
import pytest

from drivers.errors import ConfigurationError
from drivers.signals import Mode, Refusal, Warn
from hil.app.check.command import inspect
from hil.app.configuration.configuration import load
from hil.app.replay import replay_log
from hil.app.sim.command import simulate
from hil.loop.replay import replay
from hil.record.log import Log
from hil.signals import SetPoint
from tests.live_reference import LIVE_REFERENCE
from tests.loop.bench import changed, new_cycle

LIVE = changed("virtual", reference=LIVE_REFERENCE)
POSES = """t_s,x_m,y_m,z_m,rx_deg,ry_deg,rz_deg
0.0, 0.1, 0, 1.05, 0, 0, 0
0.4, 0.1, 0.1, 1, 5, 0, -5
0.5, 0, 0, 3, 0, 0, 0
2.5, -0.05, 0.05, 0.95, 0, 10, 0
"""


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    folder = tmp_path_factory.mktemp("live")
    (folder / "poses.csv").write_text(POSES)
    summary = simulate(LIVE, log=folder / "a.mcap", duration_s=6.3, setpoints=folder / "poses.csv")
    return summary, Log.open(folder / "a.mcap")


def test_platform_reaches_its_live_set_points_and_parks(run):
    summary, log = run
    assert summary["success"], summary
    assert summary["faults"] == []
    assert set(summary["limited_ticks"].values()) == {0}
    rows = log.rows()
    tracking = rows[rows["mode"] == Mode.TRACKING]
    t = tracking["reference_time_s"]
    for instant, p in ((2.4, [0.1, 0.1, 1.0]), (4.4, [-0.05, 0.05, 0.95])):
        here = tracking[int(np.argmin(np.abs(t - instant)))]
        assert np.abs(here["p"] - p).max() < 1e-4
        assert np.abs(here["p_d"] - p).max() < 1e-12
    assert summary["tracking"]["peak_leg_error_mm"] < 0.5


def test_live_reference_stays_within_rate_and_acceleration_limits_at_every_new_set_point(run):
    _, log = run
    rows = log.rows()
    moving = rows[(rows["mode"] == Mode.TRACKING) | (rows["mode"] == Mode.STOPPING)]
    v, a = moving["twist_d"], moving["dtwist_d"]
    assert 0.2 < np.abs(v[:, :3]).max() <= 0.3 * (1 + 1e-9)
    assert 0.9 < np.abs(a[:, :3]).max() <= 1.0 * (1 + 1e-9)
    assert np.abs(np.diff(a[:, :3], axis=0)).max() <= 10 * 1e-3 * (1 + 1e-9)


def test_live_set_point_out_of_reach_is_refused_counted_and_reported(run):
    summary, log = run
    assert summary["setpoints"] == {
        "taken": 3,
        "refused": 1,
        "why": "a leg would be outside the soft ends of its stroke",
    }
    rows = log.rows()
    (tick,) = np.flatnonzero(rows["setpoint_refusal"])
    assert rows["setpoint_refusal"][tick] == Refusal.STROKE
    assert rows["warnings"][tick] & Warn.SETPOINT
    assert rows["reference_time_s"][tick] == pytest.approx(0.5, abs=2e-3)


def test_log_contains_the_live_set_points_and_replays_to_the_bit(run):
    _, log = run
    given = [setpoint for tick in log.ticks() for setpoint in tick.setpoints]
    assert [s.z for s in given] == [1.05, 1.0, 3.0, 0.95]
    assert given[1] == SetPoint(0.1, 0.1, 1.0, np.deg2rad(5.0), 0.0, np.deg2rad(-5.0))
    verdict, _ = replay_log(log.path)
    assert verdict.exact


class Changed:
    """A log with one changed set-point."""

    def __init__(self, log, change):
        self.log, self.change = log, change

    def ticks(self):
        yield from map(self.change, self.log.ticks())


@pytest.mark.long
@pytest.mark.parametrize("word", [5, 1])
def test_replay_detects_a_set_point_changed_by_a_nanometre(run, word):
    _, log = run
    first: list[int] = []

    def change(tick):
        if not tick.setpoints or first:
            return tick
        first.append(int(tick.row["tick"]))
        words = list(tick.setpoints[0])
        words[word] += 1e-9
        return tick._replace(setpoints=(SetPoint(*words),))

    verdict = replay(Changed(log, change), new_cycle(LIVE))
    assert not verdict.exact
    assert first[0] <= verdict.first[0].tick <= first[0] + 1000


def test_stop_command_between_live_set_points_ends_at_rest_within_the_limits(tmp_path):
    (tmp_path / "poses.csv").write_text(POSES.splitlines()[0] + "\n0,0.3,0,1.1,0,0,8\n9,0,0,1,0,0,0\n")
    summary = simulate(
        LIVE, log=tmp_path / "a.mcap", duration_s=2.0, setpoints=tmp_path / "poses.csv", check_replay=False
    )
    assert summary["success"], summary
    rows = Log.open(tmp_path / "a.mcap").rows()
    tracking, stopping = (rows[rows["mode"] == m] for m in (Mode.TRACKING, Mode.STOPPING))
    assert np.abs(tracking["twist_d"][-1]).max() > 0.1, "the platform was moving at the stop"
    assert 0.01 < tracking["p"][-1, 0] < 0.29
    assert np.abs(stopping["dtwist_d"][:, :3]).max() <= 1 + 1e-9
    assert not stopping["twist_d"][-1].any()
    assert summary["setpoints"] == {"taken": 1, "refused": 0, "why": None, "not_reached": 1}
    assert len(stopping) * 1e-3 < 0.3 / 1 + 2 * 1 / 10 + 0.05
    assert stopping["p_d"][-1, 0] < 0.3


def test_live_reference_stops_on_the_way_to_an_accepted_pose_before_the_force_limit(tmp_path):
    u, v = "-0.28,-0.1,0.86,-2.9,-5.2,-4.0", "-0.23,0,0.78,-25.8,38.4,-17.2"
    (tmp_path / "poses.csv").write_text(f"{POSES.splitlines()[0]}\n0,{u}\n3,{v}\n")
    summary = simulate(LIVE, log=tmp_path / "a.mcap", duration_s=7.0, setpoints=tmp_path / "poses.csv")
    assert summary["success"], summary
    assert (summary["setpoints"]["taken"], summary["setpoints"]["refused"]) == (2, 1)
    rows = Log.open(tmp_path / "a.mcap").rows()
    (tick,) = np.flatnonzero(rows["setpoint_refusal"])
    assert rows["setpoint_refusal"][tick] == Refusal.ON_THE_WAY | Refusal.FORCE
    assert rows["warnings"][tick] & Warn.SETPOINT
    assert not rows["twist_d"][tick + 1000].any(), "at rest"
    assert summary["replay"]["exact"]


def test_unsuitable_file_or_use_of_live_set_points_is_refused(tmp_path):
    (tmp_path / "poses.csv").write_text(POSES)
    with pytest.raises(ConfigurationError, match="--duration"):
        simulate(LIVE, log=tmp_path / "a.mcap")
    with pytest.raises(ConfigurationError, match="takes no set-points"):
        simulate(load("virtual"), log=tmp_path / "a.mcap", setpoints=tmp_path / "poses.csv")
    (tmp_path / "poses.csv").write_text(POSES + "2.0,0,0,1,0,0,0\n")
    with pytest.raises(ConfigurationError, match="times must increase"):
        simulate(LIVE, log=tmp_path / "a.mcap", duration_s=1, setpoints=tmp_path / "poses.csv")
    fast = changed(LIVE, reference={"limits": {"acceleration_m_s2": 19}})
    with pytest.raises(ConfigurationError, match="at its start, set-points are refused"):
        inspect(fast)
