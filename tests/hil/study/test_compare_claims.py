"""What `hil compare` says of the control chapter: claims follow the figures, and are made only with them."""

import math

import pytest

from hil.control.inverse_dynamics import InverseDynamicsSettings
from hil.record.metrics import Share
from hil.study.compare.claims import Evidence, judge
from hil.study.compare.measure import Outcome

WN = 20.0


def evidence(errors, H=0.005):
    rows = {
        name: Outcome(name, "own", None, None, {"peak_leg_error_mm": e, "steady_leg_error_mm": e}, {})
        for name, e in errors.items()
    }
    settings = {"inverse_dynamics": InverseDynamicsSettings(law="inverse_dynamics", wn_rad_s=WN)}
    return Evidence(
        rows, settings, {"H": Share(H, 40.0), "J_dot": Share(0.157, 1188.0), "G": Share(1.0, 1e4)}
    )


def verdicts(*arguments, **words):
    return {c["claim"]: c["holds"] for c in judge(evidence(*arguments, **words))}


def test_claims_follow_the_figures():
    poor = "PD on leg lengths tracks poorly"
    assert verdicts({"pd": 10.0, "inverse_dynamics": 0.1})[poor]
    assert not verdicts({"pd": 0.2, "inverse_dynamics": 0.1})[poor]
    static = "PD leaves a static error"
    assert verdicts({"pd": 10.0, "inverse_dynamics": 0.1})[static]
    assert not verdicts({"pd": 0.2, "inverse_dynamics": 0.1})[static]
    forward = "with a good model feed-forward makes PD track"
    assert verdicts({"pd": 1.0, "feedforward_pd": 0.1})[forward]
    assert not verdicts({"pd": 1.0, "feedforward_pd": 0.7})[forward]
    small = "H takes less than 1 % of the force"
    assert verdicts({})[small]
    assert not verdicts({}, H=0.02)[small]
    printed = "the law may be printed without (dJ/dt) twist"
    assert not verdicts({"printed": 2.6, "inverse_dynamics": 0.03})[printed]
    assert verdicts({"printed": 0.031, "inverse_dynamics": 0.03})[printed]


def test_a_claim_without_its_figure_is_not_made():
    e = evidence({"pd": 5.0, "pd_gravity": 0.1})
    rows = {
        name: row._replace(figures={"peak_leg_error_mm": 5.0}, fault="STROKE") for name, row in e.rows.items()
    }
    claims = [c["claim"] for c in judge(e._replace(rows=rows))]
    assert "gravity compensation takes PD's static error away" not in claims
    assert "gravity compensation takes PD's static error away" in [c["claim"] for c in judge(e)]


def test_where_the_law_that_is_the_measure_faulted_nothing_is_claimed():
    """Any error is less than that of a law that was stopped: that makes no law good enough."""
    e = evidence({"inverse_dynamics": 5.0, "partial_linearisation": 500.0, "printed": 500.0, "pd": 500.0})
    stopped = {"inverse_dynamics": e.rows["inverse_dynamics"]._replace(fault="FOLLOWING")}
    left = {c["claim"] for c in judge(e._replace(rows={**e.rows, **stopped}))}
    assert {c["claim"] for c in judge(e)} - left == {
        "PD on leg lengths tracks poorly",
        "without H the linearisation is good enough",
        "the law may be printed without (dJ/dt) twist",
    }


def test_a_claim_about_laws_that_were_not_compared_is_not_made():
    assert list(verdicts({"pd": 1.0})) == ["H takes less than 1 % of the force"]


@pytest.mark.parametrize(
    ("factor", "holds"), [(1.0, True), (0.96, True), (1.04, True), (0.94, False), (0.5, False), (1.06, False)]
)
def test_the_loop_is_the_linear_one_only_where_its_bandwidth_is_neither_less_nor_more(factor, holds):
    """wn 20 rad/s, zeta 1: -3 dB at 0.6436 wn."""
    e = evidence({"inverse_dynamics": 0.1})
    row = e.rows["inverse_dynamics"]
    figures = row.figures | {"bandwidth_Hz": factor * 0.6436 * WN / (2 * math.pi)}
    found = judge(e._replace(rows={"inverse_dynamics": row._replace(figures=figures)}))
    claims = {c["claim"]: c["holds"] for c in found}
    assert claims["inverse dynamics leaves E'' + K_D E' + K_P E = 0"] is holds
