"""Feed-forward with PD: the engines' forces on the reference, from a table or at each tick."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from drivers.errors import ConfigurationError
from hil.config import FeedforwardPDSettings, ModelSettings, Waypoint, WaypointReference
from hil.control import LawContext, build_law
from hil.loop.reference import complete
from hil.robot.geometry import Platform
from hil.robot.kinematics import jacobian
from hil.signals import State
from hil.trajectory import PoseSample, hold, waypoint_trajectory

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
    return build_law(settings, LawContext(platform, "none", period, trajectory, preview))


def on(reference, wrench=NONE):
    J = jacobian(PLATFORM, reference.p, reference.R)
    return State(reference.q, reference.dq, reference.p, reference.R, reference.twist, J, 0, 0.0, wrench)


@pytest.mark.parametrize("case", TRUTH["cases"][::4], ids=lambda c: c["id"])
def test_the_feedforward_is_the_engines_force_on_the_reference_and_the_load_is_taken_off(case):
    platform = Platform.from_dict(TRUTH["geometries"][case["geometry"]])
    s, e = case["state"], case["expected"]
    sample = PoseSample(
        np.array(s["p"]), np.array(s["R"]), np.array(s["v"] + s["omega"]), np.array(s["a"] + s["alpha"])
    )
    reference = complete(platform, sample)
    gone = State(
        reference.q - 1e-3,
        reference.dq + 2e-2,
        HOME,
        np.eye(3),
        NONE,
        np.eye(6),
        0,
        0.0,
        np.array(s["wrench"]),
    )
    tau = law_of(platform=platform).effort(gone, reference, NONE).tau
    expected = np.array(e["leg_forces"]) + 2e6 * 1e-3 - 5e4 * 2e-2
    np.testing.assert_allclose(tau, expected, rtol=0, atol=2e-9 * np.abs(expected).max())


def test_offline_gives_the_bits_of_online_at_every_tick_of_the_trajectory():
    online, offline = law_of(), law_of("offline")
    assert offline.table.shape == (1401, 6)
    for k in range(1401):
        t = k * PERIOD
        reference = complete(PLATFORM, PATH.sample(t), t)
        state = on(reference)._replace(q=reference.q + 1e-4)
        assert offline._tabulated(t) is not None
        assert (
            offline.effort(state, reference, NONE).tau.tobytes()
            == online.effort(state, reference, NONE).tau.tobytes()
        )


def test_offline_tabulates_the_instants_at_which_the_force_acts():
    """With delay compensation the reference of tick k is that of k period + preview."""
    ahead = 1.8e-3
    online, offline = law_of(), law_of("offline", preview=ahead)
    for k in (0, 1, 700, 1400):
        t = k * PERIOD + ahead
        reference = complete(PLATFORM, PATH.sample(t), t)
        assert offline._tabulated(t) is not None
        assert (
            offline.effort(on(reference), reference, NONE).tau.tobytes()
            == online.effort(on(reference), reference, NONE).tau.tobytes()
        )
    assert offline._tabulated(5 * PERIOD) is None


def test_offline_computes_what_is_no_tick_of_the_trajectory():
    """On the way to it, between its ticks and past its end the table has no say."""
    online, offline = law_of(), law_of("offline")
    offline.table = np.full_like(offline.table, np.nan)
    for t, at in ((float("nan"), 0.3), (0.3 * PERIOD, 0.3 * PERIOD), (2.0 + PERIOD, 2.0 + PERIOD)):
        reference = complete(PLATFORM, PATH.sample(at), t)
        tau = offline.effort(on(reference), reference, NONE).tau
        assert tau.tobytes() == online.effort(on(reference), reference, NONE).tau.tobytes()
    reference = complete(PLATFORM, PATH.sample(0.0), 0.0)
    assert np.isnan(offline.effort(on(reference), reference, NONE).tau).all()


@pytest.mark.parametrize("t", [0.0, float("nan")], ids=["on the trajectory", "on the way to it"])
def test_a_load_is_not_known_before_the_run(t):
    online, offline = law_of(), law_of("offline")
    load = np.array([1e3, 2e3, 3e3, 100.0, 200.0, 300.0])
    reference = complete(PLATFORM, PATH.sample(0.0), t)
    bare, loaded = on(reference), on(reference, load)
    assert (
        offline.effort(loaded, reference, NONE).tau.tobytes()
        == offline.effort(bare, reference, NONE).tau.tobytes()
    )
    taken = online.effort(bare, reference, NONE).tau - online.effort(loaded, reference, NONE).tau
    np.testing.assert_allclose(bare.J.T @ taken, load, atol=1e-8)


def test_a_trajectory_without_end_is_refused():
    with pytest.raises(
        ConfigurationError, match=r"controller\.evaluation: offline needs a reference that ends"
    ):
        law_of("offline", trajectory=hold(HOME, np.eye(3)))


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
    reference = complete(PLATFORM, PATH.sample(0.7))
    full, light = (
        law_of(platform=platform, inertia_scale=k).effort(on(reference), reference, NONE).tau
        for k in (1.0, 0.9)
    )
    np.testing.assert_allclose(light, 0.9 * full, rtol=1e-9)
