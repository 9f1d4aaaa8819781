"""What `hil compare` measures by: loads, errors at rest, believed masses and its verdict, without a run."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from drivers.config import HomingSettings
from drivers.signals import Mode
from drivers.tick_columns import ROW
from hil.app.configuration.compare import DisturbanceSettings, StepSettings
from hil.app.configuration.configuration import load
from hil.config.model import ModelSettings
from hil.study.compare import command, measure
from hil.study.compare.conditions import paths
from hil.study.compare.laws import chosen, with_scale
from hil.study.compare.measure import Job, Outcome

FORCE, MOMENT = (1.0, -2.0, 3.0), (40.0, 50.0, -60.0)


@pytest.fixture(scope="module")
def virtual():
    return load("virtual")


@pytest.mark.parametrize(("stop_s", "lasts"), [(2.0, 1.5), (None, None)])
def test_a_load_comes_at_its_time_along_the_reference_and_goes_at_its_end(stop_s, lasts):
    load_ = DisturbanceSettings(force_N=FORCE, moment_N_m=MOMENT, start_s=0.5, stop_s=stop_s)
    step = measure._wrench(load_)
    assert (step.mode, step.at_s, step.for_s) == ("TRACKING", 0.5, lasts)
    assert (step.force_N, step.moment_N_m) == (FORCE, MOMENT)


def test_at_home_the_whole_load_comes_after_the_step_and_stays(virtual, monkeypatch):
    given: list[Any] = []
    rate, n = virtual.loop.rate_Hz, 600

    def ran(c, duration_s, *, trajectory=None, load=None):
        given.append(load)
        rows = np.zeros(3 * n, ROW)
        rows["mode"], rows["R"] = Mode.TRACKING, np.eye(3).reshape(ROW["R"].shape)
        rows["p"] = virtual.platform.home.position_m
        rows["p"][n:] += trajectory.p1 - trajectory.p0
        return rows

    monkeypatch.setattr(measure, "_run", ran)
    load_ = DisturbanceSettings(force_N=FORCE, moment_N_m=MOMENT, start_s=0.5, stop_s=2.0)
    job = Job("pd", "own", virtual, 1.0, load_, StepSettings(), n / rate)
    measure._at_rest(job, virtual, StepSettings())
    (step,) = given
    assert (step.force_N, step.moment_N_m, step.stop_s) == (FORCE, MOMENT, None)
    assert step.start_s == pytest.approx(2 * n / rate, abs=1 / rate)


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_an_error_at_rest_counts_whether_the_leg_is_too_long_or_too_short(sign):
    rows = np.zeros(100, ROW)
    rows["q"][:, 4] = sign * 0.3e-3
    rows["q"][:, 1] = -sign * 0.2e-3
    rows["q"][:50, 2] = 1.0
    assert measure._steady_mm(rows) == pytest.approx(0.3)


@pytest.mark.parametrize(("own", "scale"), [(0.8, 0.5), (1.0, 0.9), (1.5, 2.0)])
def test_a_scale_of_the_masses_multiplies_what_the_law_believes_already(virtual, own, scale):
    law = chosen(virtual, ["inverse_dynamics"])["inverse_dynamics"]
    settings: Any = law.model_copy(update={"model": ModelSettings(inertia_scale=own)})
    scaled: Any = with_scale(settings, scale)
    assert scaled.model.inertia_scale == pytest.approx(own * scale)
    assert settings.model.inertia_scale == own, "the settings themselves stay"


@pytest.mark.parametrize("name", ["desktop", "virtual-cia402"])
def test_drives_behind_a_transmission_have_an_ideal_path_too(name):
    """Without a bus the numbers are those of the legs: motors, and the turns that they forget, are out of it."""
    c = load(name)
    homing = HomingSettings(file="legs.yaml", limit_m=1e-4)
    c = c.model_copy(update={"drives": c.drives.model_copy(update={"homing": homing})})
    assert c.drives.transmission is not None
    ideal = paths(c)["ideal"]
    outcome = measure.measure(Job("own", "ideal", ideal, 0.005, None, None, 0.1))
    assert outcome.fault is None
    assert outcome.figures["peak_leg_error_mm"] < 0.1
    assert (ideal.drives.transmission, ideal.drives.homing) == (None, None)
    assert paths(c)["bus"].drives == c.drives


@pytest.mark.parametrize(
    ("own", "other", "success"),
    [
        (("", True), ("", True), True),
        (("", True), ("FOLLOWING", True), True),
        (("", True), ("its process died", False), False),
        (("FOLLOWING", True), ("", True), False),
        (("its process died", False), ("", True), False),
    ],
)
def test_a_law_that_could_not_be_run_at_all_fails_a_comparison_and_one_that_faulted_does_not(
    virtual, tmp_path, monkeypatch, own, other, success
):
    became = {"inverse_dynamics": own, "pd": other}

    def perform(work, *_):
        for job in work:
            fault, measured = became[job.law]
            yield Outcome(
                job.law, job.path, fault or None, None, {"peak_leg_error_mm": 1.0} if measured else {}, {}
            )

    for name, stand_in in (
        ("perform", perform), ("_shares", lambda *_: {}), ("judge", lambda _: []), ("draw", lambda *_: None),
    ):  # fmt: skip
        monkeypatch.setattr(command, name, stand_in)
    found = command.compare(
        virtual, laws=list(became), path_laws=["none"], duration_s=0.1, picture=tmp_path / "a.png"
    )
    assert found["success"] is success
