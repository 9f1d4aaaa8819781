"""Feed-forward with PD: the engines' forces on the reference, from a table or at each tick."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from drivers.errors import ConfigurationError
from hil.config.model import ModelSettings
from hil.config.reference import Waypoint, WaypointReference
from hil.contracts.records import altered, arrived, asked, referred
from hil.control.feedforward_pd import FeedforwardPDSettings
from hil.control.law import LawContext
from hil.robot.geometry import Platform
from hil.trajectory.holding import HoldTrajectory
from hil.trajectory.path import PoseSample
from hil.trajectory.waypoints import waypoint_trajectory

DATA = Path(__file__).parents[2] / "data"
BOOK = json.loads((DATA / "book_platform.json").read_text())
TRUTH = json.loads((DATA / "rigid_body_cases.json").read_text())
PLATFORM = Platform.from_dict(BOOK["geometry"])
HOME = np.array([0.0, 0.0, 1.0])
NONE = np.zeros(6)
PERIOD = 1.0 / 700.0
"""s; no sum and no product of it is a round number."""
PATH = waypoint_trajectory(
    WaypointReference(
        type="waypoints",
        interpolation="cubic",
        points=[
            Waypoint(t_s=k["t"], position_m=tuple(k["p"]), rotation_vector_deg=tuple(k["rotvec_deg"]))
            for k in BOOK["trajectory"]["knots"]
        ],
    )
)


def law_of(evaluation="online", platform=PLATFORM, trajectory=PATH, period=PERIOD, preview=0.0, **model):
    settings = FeedforwardPDSettings(
        law="feedforward_pd", kp_N_m=2e6, kv_N_s_m=5e4, evaluation=evaluation, model=ModelSettings(**model)
    )
    return settings.build(LawContext(platform, "none", period, trajectory, preview))


@pytest.mark.parametrize("case", TRUTH["cases"][::4], ids=lambda c: c["id"])
def test_the_feedforward_is_the_engines_force_on_the_reference_and_the_load_is_taken_off(case):
    platform = Platform.from_dict(TRUTH["geometries"][case["geometry"]])
    s, e = case["state"], case["expected"]
    sample = PoseSample(
        np.array(s["p"]), np.array(s["R"]), np.array(s["v"] + s["omega"]), np.array(s["a"] + s["alpha"])
    )
    gone = referred(platform, sample, p=HOME, R=np.eye(3), J=np.eye(6), wrench=s["wrench"])
    gone["q"], gone["dq"] = gone["q_d"] - 1e-3, gone["dq_d"] + 2e-2
    tau = asked(law_of(platform=platform), gone)
    expected = np.array(e["leg_forces"]) + 2e6 * 1e-3 - 5e4 * 2e-2
    np.testing.assert_allclose(tau, expected, rtol=0, atol=2e-9 * np.abs(expected).max())


def tabulated(law, t):
    """Tell whether a law takes its force from the table at the time t: a table without numbers gives none."""
    table, law.table = law.table, np.full_like(law.table, np.nan)
    tau = asked(law, arrived(PLATFORM, PATH.sample(0.3), t))
    law.table = table
    return bool(np.isnan(tau).all())


def test_offline_gives_the_bits_of_online_at_every_tick_of_the_trajectory():
    online, offline = law_of(), law_of("offline")
    assert offline.table.shape == (1401, 6)
    for k in range(1401):
        t = k * PERIOD
        tick = arrived(PLATFORM, PATH.sample(t), t)
        tick["q"] += 1e-4
        assert tabulated(offline, t)
        assert asked(offline, tick).tobytes() == asked(online, tick).tobytes()


def test_offline_tabulates_the_instants_at_which_the_force_acts():
    """With delay compensation the reference of tick k is that of k period + preview."""
    ahead = 1.8e-3
    online, offline = law_of(), law_of("offline", preview=ahead)
    for k in (0, 1, 700, 1400):
        t = k * PERIOD + ahead
        tick = arrived(PLATFORM, PATH.sample(t), t)
        assert tabulated(offline, t)
        assert asked(offline, tick).tobytes() == asked(online, tick).tobytes()
    assert not tabulated(offline, 5 * PERIOD)


def test_offline_computes_what_is_no_tick_of_the_trajectory():
    """On the way to it, between its ticks and past its end the table has no say."""
    online, offline = law_of(), law_of("offline")
    offline.table = np.full_like(offline.table, np.nan)
    for t, at in ((float("nan"), 0.3), (0.3 * PERIOD, 0.3 * PERIOD), (2.0 + PERIOD, 2.0 + PERIOD)):
        tick = arrived(PLATFORM, PATH.sample(at), t)
        assert asked(offline, tick).tobytes() == asked(online, tick).tobytes()
    assert np.isnan(asked(offline, arrived(PLATFORM, PATH.sample(0.0), 0.0))).all()


@pytest.mark.parametrize("t", [0.0, float("nan")], ids=["on the trajectory", "on the way to it"])
def test_a_load_is_not_known_before_the_run(t):
    online, offline = law_of(), law_of("offline")
    load = np.array([1e3, 2e3, 3e3, 100.0, 200.0, 300.0])
    bare = arrived(PLATFORM, PATH.sample(0.0), t)
    loaded = altered(bare, wrench=load)
    assert asked(offline, loaded).tobytes() == asked(offline, bare).tobytes()
    taken = asked(online, bare) - asked(online, loaded)
    np.testing.assert_allclose(bare["J"].T @ taken, load, atol=1e-8)


def test_a_trajectory_without_end_is_refused():
    with pytest.raises(
        ConfigurationError, match=r"controller\.evaluation: offline needs a reference that ends"
    ):
        law_of("offline", trajectory=HoldTrajectory(HOME, np.eye(3)))


def test_a_model_of_nine_tenths_feeds_nine_tenths_of_the_forces_forward():
    """On massless legs every force is proportional to the platform's mass, its inertia and com."""
    bare = {
        **BOOK["geometry"],
        **{
            half: {**BOOK["geometry"][half], "mass": 0, "inertia_transverse": 0}
            for half in ("cylinder", "rod")
        },
    }
    platform = Platform.from_dict(bare)
    tick = arrived(PLATFORM, PATH.sample(0.7))
    full, light = (asked(law_of(platform=platform, inertia_scale=k), tick) for k in (1.0, 0.9))
    np.testing.assert_allclose(light, 0.9 * full, rtol=1e-9)
