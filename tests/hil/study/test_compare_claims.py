"""Claims of the control chapter in `hil compare`: they follow the figures, and need them."""

import math

import pytest

from hil.control.inverse_dynamics import InverseDynamicsSettings
from hil.record.metrics import Share
from hil.study.compare.claims import judge
from hil.study.compare.measure import Outcome

WN = 20.0
ID, FF = "inverse_dynamics", "feedforward_pd"


def evidence(errors, H=0.005):
    rows = {
        name: Outcome(name, "own", None, None, {"peak_leg_error_mm": e, "steady_leg_error_mm": e}, {})
        for name, e in errors.items()
    }
    settings = {"inverse_dynamics": InverseDynamicsSettings(law="inverse_dynamics", wn_rad_s=WN)}
    return rows, settings, {"H": Share(H, 40.0), "J_dot": Share(0.157, 1188.0), "G": Share(1.0, 1e4)}


def verdicts(rows, settings, shares):
    return {c["claim"]: c["holds"] for c in judge(rows, settings, shares)}


@pytest.mark.parametrize(
    ("claim", "good", "bad"),
    [
        ("PD on leg lengths tracks poorly", {"pd": 10.0, ID: 0.1}, {"pd": 0.2, ID: 0.1}),
        ("PD leaves a static error", {"pd": 10.0, ID: 0.1}, {"pd": 0.2, ID: 0.1}),
        ("with a good model feed-forward makes PD track", {"pd": 1.0, FF: 0.1}, {"pd": 1.0, FF: 0.7}),
        (
            "the law may be printed without (dJ/dt) twist",
            {"printed": 0.031, ID: 0.03},
            {"printed": 2.6, ID: 0.03},
        ),
    ],
)
def test_textbook_claims_on_laws_hold_or_fail_according_to_the_figures(claim, good, bad):
    assert [verdicts(*evidence(errors))[claim] for errors in (good, bad)] == [True, False]


def test_textbook_claim_about_coriolis_forces_depends_only_on_their_share_of_the_force():
    small = "H takes less than 1 % of the force"
    assert [verdicts(*evidence({}, H=share)) for share in (0.005, 0.02)] == [{small: True}, {small: False}]
    assert list(verdicts(*evidence({"pd": 1.0}))) == [small], "claims about laws without results are left out"


def test_textbook_claim_whose_figure_is_missing_is_left_out():
    rows, *rest = evidence({"pd": 5.0, "pd_gravity": 0.1})
    claim = "gravity compensation takes PD's static error away"
    assert claim in verdicts(rows, *rest)
    figures = {"peak_leg_error_mm": 5.0}
    rows = {name: row._replace(figures=figures, fault="STROKE") for name, row in rows.items()}
    assert claim not in verdicts(rows, *rest)


def test_textbook_claims_relative_to_inverse_dynamics_are_left_out_if_that_law_faulted():
    """Any error is smaller than the infinite error of a stopped law, which proves nothing."""
    rows, *rest = evidence({ID: 5.0, "partial_linearisation": 500.0, "printed": 500.0, "pd": 500.0})
    stopped = rows | {ID: rows[ID]._replace(fault="FOLLOWING")}
    assert set(verdicts(rows, *rest)) - set(verdicts(stopped, *rest)) == {
        "PD on leg lengths tracks poorly",
        "without H the linearisation is good enough",
        "the law may be printed without (dJ/dt) twist",
    }


@pytest.mark.parametrize(("factor", "holds"), [(1.04, True), (0.96, True), (0.94, False), (1.06, False)])
def test_the_linear_loop_claim_holds_within_5_percent_of_its_bandwidth(factor, holds):
    """wn 20 rad/s, zeta 1: -3 dB at 0.6436 wn."""
    rows, *rest = evidence({ID: 0.1})
    figures = rows[ID].figures | {"bandwidth_Hz": factor * 0.6436 * WN / (2 * math.pi)}
    found = verdicts({ID: rows[ID]._replace(figures=figures)}, *rest)
    assert found["inverse dynamics leaves E'' + K_D E' + K_P E = 0"] is holds
