"""A row of a campaign: its seed, its time limit, its verdict, and the columns of its values."""

from types import SimpleNamespace
from typing import cast

import pytest

from drivers.signals import Fault
from hil.study.campaign import row
from hil.study.campaign.figures import METRICS, Measurement
from hil.study.campaign.plan import read_plan
from hil.study.campaign.row import row_configuration, run_row
from tests.hil.study.campaign.campaigns import written
from tests.hil.study.campaign.test_plan import ALL


@pytest.fixture(scope="module")
def plan(tmp_path_factory):
    text = ALL.replace("wn: {key: controller.wn_rad_s", "wn: {key: limits.condition")
    return read_plan(written(tmp_path_factory.mktemp("row"), text))


def test_the_sensor_seed_of_a_row_is_the_configured_one_plus_the_rows_seed(tmp_path):
    text = ALL.replace("changes:\n", "changes:\n  sensors: {tracker: {rate_Hz: 200}}\n").replace(
        "plant: {", "plant: {sensors: {seed: 7}, "
    )
    plan = read_plan(written(tmp_path, text.replace("controller.wn_rad_s", "limits.condition")))
    jobs = [plan.job(k) for k in range(len(plan))]
    assert {job.seed for job in jobs} == {0, 1}
    for job in jobs:
        plant = row_configuration(job).plant
        assert plant is not None
        assert plant.sensors.seed == 7 + job.seed


@pytest.mark.parametrize(
    ("how", "passed"),
    [("complete", True), ("fault", True), ("limit", False), ("stopped", False), ("plant", False)],
)
def test_campaign_row_passes_only_if_its_run_completed_or_ended_in_a_fault(plan, how, passed):
    measured = SimpleNamespace(figures=lambda: dict.fromkeys(METRICS, 0))
    ended = row.Ended(how, "", Fault(0), 5)
    assert row.outcome(plan.job(0), 1e3, ended, cast("Measurement", measured))["passed"] is passed


def test_campaign_row_that_does_not_end_fails_an_hour_after_its_reference(plan, monkeypatch):
    assert row.LONGEST_S == 3600.0
    monkeypatch.setattr(row, "LONGEST_S", 0.05)
    job = plan.job(0)
    settings = job.subject.settings.model_copy(update={"duration_s": 0.1})
    found = run_row(job._replace(subject=job.subject._replace(settings=settings)))
    assert (found["ended"], found["passed"], found["ended_s"]) == ("stopped", False, pytest.approx(0.15))
    assert "the run has not ended 0.05 s after its" in found["trouble"]
