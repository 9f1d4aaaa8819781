"""Pass rates: intervals, values and quarters of an axis, the worst rows."""

from hil.study.campaign.figures import METRICS
from hil.study.campaign.rates import by_value, causes, why, worst
from hil.study.campaign.settings import Limit, ListedAxis, SampledAxis

LIMITS = {"faulted": Limit(max=0.0), "peak_force_N": Limit(max=100.0)}


def row(number, *, passed=True, ended="complete", ended_s=1.0, trouble="", **values):
    return {
        "row": number, "passed": passed, "ended": ended, "ended_s": ended_s, "trouble": trouble,
        "faults": "DRIVE" if ended == "fault" else "",
        **dict.fromkeys(METRICS), "faulted": 0, **values,
    }  # fmt: skip


def test_pass_rates_of_axis_options_are_listed_in_the_order_of_the_file():
    axis = ListedAxis(options={"pd": {}, "inverse": {}})
    rows = [row(0, law="inverse"), row(1, law="pd", passed=False), row(2, law="inverse")]
    found = by_value("law", axis, rows)
    assert [(r.label, r.rows, r.passed) for r in found] == [("pd", 1, 0), ("inverse", 2, 2)]


def test_pass_rates_of_an_axis_with_many_numbers_are_listed_by_quarters_of_its_values():
    axis = SampledAxis(key="x.y", uniform=(0.0, 20.0))
    rows = [row(k, mass=float(19 - k), passed=k >= 5) for k in range(20)]
    found = by_value("mass", axis, rows)
    labels = ["0 to 4", "5 to 9", "10 to 14", "15 to 19"]
    assert [(r.label, r.rows, r.passed) for r in found] == [
        (label, 5, passed) for label, passed in zip(labels, (5, 5, 5, 0), strict=True)
    ]


def test_worst_row_of_each_failure_cause_is_listed_first():
    rows = [
        row(0, passed=False, peak_force_N=110.0),
        row(1),
        row(2, passed=False, peak_force_N=300.0),
        row(3, passed=False, ended="fault", ended_s=0.5, faulted=1),
        row(4, passed=False, ended="fault", ended_s=0.1, faulted=1),
    ]
    assert [r["row"] for r in worst(rows, LIMITS, 3)] == [4, 2, 3]
    assert [r["row"] for r in worst(rows, LIMITS, 9)] == [4, 2, 3, 0]
    assert sorted(causes(rows)) == [("fault DRIVE", 2), ("limit", 2)]


def test_the_reason_of_a_failed_row_has_value_and_limit():
    assert why(row(0, passed=False, peak_force_N=110.5), LIMITS) == "peak_force_N 110.5, allowed: <= 100"
    ended = row(0, passed=False, ended="plant", trouble="the FMU failed\nfar away", peak_force_N=1.0)
    assert why(ended, LIMITS) == "plant: the FMU failed"
    assert why(row(0, passed=False), LIMITS) == "not measured: peak_force_N"


def test_a_row_without_its_required_fault_gives_that_as_the_reason():
    assert why(row(0, passed=False), {"faulted": Limit(min=1.0)}) == "faulted 0, allowed: >= 1"
