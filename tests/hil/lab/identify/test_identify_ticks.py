"""Which ticks of a log `hil identify` counts as measured, and about which pose and beside which friction it looks."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from drivers.errors import ConfigurationError, IdentificationError
from drivers.signals import DriveState, Mode
from drivers.tick_columns import ROW
from hil.app.configuration.configuration import load, loads
from hil.config.delay import DelayCompensation
from hil.config.reference import SinusoidReference
from hil.lab.identify import axes, delay, payload
from hil.lab.identify.axes import axes_of_log, excited_axes
from hil.lab.identify.delay import delay_of_log, excited, friction_block, motion_of
from hil.lab.identify.linearised import linearised_law, signals_of
from hil.lab.identify.runs import Recorded, exact_model
from hil.robot.kinematics import jacobian

COUNT = 12


def running(tick=range(COUNT)):
    """Return rows that track, brakes open, all legs fresh."""
    ticks = np.array(tick)
    rows = np.zeros(len(ticks), ROW)
    rows["tick"], rows["mode"], rows["drive_state"] = ticks, Mode.TRACKING, DriveState.RUN
    rows["p"], rows["R"] = (0.0, 0.0, 1.0), np.eye(3)
    rows["q"] = 1.5 + 1e-3 * ticks[:, None]
    rows["drive_force"] = rows["tau"] = 3000.0
    return rows


def by_delay(rows, _):
    return motion_of(rows, 1e-3).usable


def by_axes(rows, _):
    good = signals_of(rows, linearised_law(load("virtual")), 1000.0)[0].good
    return good[1:] & good[:-1]


def by_payload(rows, monkeypatch):
    """What the equations are made from."""
    seen = []

    def equations_of(_model, signals, _given):
        seen.append(signals.good)

    monkeypatch.setattr(payload, "recorded_run", lambda _: Recorded(load("virtual"), rows, 1000.0, {}))
    monkeypatch.setattr(payload, "equations_of", equations_of)
    payload._source(Path("a.mcap"), None)
    (good,) = seen
    return good[1:] & good[:-1]


@pytest.fixture(params=[by_delay, by_axes, by_payload])
def usable(request, monkeypatch):
    """Return of which periods both ends count as measured, by each command."""
    return lambda rows: request.param(rows, monkeypatch).tolist()


def without(*ticks):
    """Return the periods that are left where these ticks do not count."""
    return [k not in ticks and k + 1 not in ticks for k in range(COUNT - 1)]


def test_ticks_that_the_log_lacks_count_as_not_measured(usable):
    assert usable(running()) == without()
    assert usable(running([k for k in range(COUNT) if k not in {3, 7, 8}])) == without(3, 7, 8)


@pytest.mark.parametrize("leg", range(6))
def test_a_tick_in_which_one_leg_is_stale_does_not_count_as_measured(usable, leg):
    rows = running()
    rows["age"][5, leg], rows["age"][9, leg] = 1, 7
    assert usable(rows) == without(5, 9)


def test_the_wrench_is_taken_off_what_a_law_demands_where_it_compensates_it_and_nowhere_else():
    """By hand: legs of the acceleration J M^-1 wrench, which a law that answers the wrench takes off its forces."""
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


REFUSAL = "estimation.pose: fused, so that lengths, pose and rates of the log are the filter's"


@pytest.mark.parametrize(
    "identify", [delay_of_log, axes_of_log, lambda path: payload.identify_payload([path], None)]
)
def test_a_log_whose_motion_is_that_of_the_filter_says_nothing_of_masses_or_delays(identify, monkeypatch):
    """The filter goes by what the controller believes of masses and forces, and its phase is no delay of the bus."""
    recorded = Recorded(fused(load("virtual")), running(), 1000.0, {})
    for module in (axes, delay, payload):
        monkeypatch.setattr(module, "recorded_run", lambda _: recorded)
    with pytest.raises(ConfigurationError) as caught:
        identify(Path("a.mcap"))
    assert str(caught.value).startswith(f"a.mcap: {REFUSAL}")


@pytest.mark.parametrize("excite", [excited, excited_axes])
def test_a_fused_pose_is_refused_before_anything_runs(excite):
    c = fused(load("virtual"))
    with pytest.raises(ConfigurationError) as caught:
        excite(c, None, None)
    assert str(caught.value).startswith(f"{c.source}: {REFUSAL}")


def kind_of(force, rate_Hz=1000.0, lag_ms=0.8):
    """Return a log whose drives report forces or not, at this rate and with this delay in its configuration."""
    rows, c = running(), load("virtual")
    rows["drive_force"] = force
    law: Any = c.controller
    delay = DelayCompensation(bus_ms=0.5, drive_lag_ms=lag_ms, hold_ms=0.5)
    law = law.model_copy(update={"delay_compensation": delay})
    return Recorded(c.model_copy(update={"controller": law}), rows, rate_Hz, {})


class FittedError(Exception):
    """All logs have been taken."""


@pytest.mark.parametrize(
    ("one", "other", "refused"),
    [
        ((3000.0,), (0.0,), "as sent, at 1000 Hz and late by 1.3 ms"),
        ((0.0,), (3000.0,), "as the drives report them"),
        ((0.0,), (0.0, 500.0), "as sent, at 500 Hz"),
        ((0.0,), (0.0, 1000.0, 0.9), "late by 1.4 ms"),
        ((0.0,), (0.0,), None),
        ((3000.0,), (3000.0, 500.0, 0.9), None),
    ],
)
def test_logs_whose_forces_are_late_by_times_of_their_own_are_not_fitted_together(
    one, other, refused, monkeypatch
):
    """One lateness is found for all of them: of two, the difference would pass for viscous friction."""

    def progress(what):
        if what == "least squares":
            raise FittedError

    logs = {Path("a.mcap"): kind_of(*one), Path("b.mcap"): kind_of(*other)}
    monkeypatch.setattr(payload, "recorded_run", logs.__getitem__)
    monkeypatch.setattr(payload, "equations_of", lambda *_: None)
    with pytest.raises(IdentificationError if refused else FittedError) as caught:
        payload.identify_payload(list(logs), None, progress)
    own = str(caught.value).partition(", those of a.mcap ")[0]
    assert own.startswith("b.mcap: its forces are " if refused else "")
    assert (refused or "") in own


def configured(*changes):
    text = load("virtual").text
    for old, new in changes:
        assert text.count(old) == 1, old
        text = text.replace(old, new)
    return loads(text, "my.yaml", Path())


def test_the_block_has_the_friction_that_the_model_has_and_what_the_log_shows_beyond_it():
    viscous, coulomb = [100.0, 200.0, 0.0, 50.0, 300.0, 10.0], [5.0, 0.0, 15.0, 20.0, 25.0, 30.0]
    model = f"    variant: full\n    viscous_friction_N_s_m: {viscous}\n    coulomb_friction_N: {coulomb}\n"
    beyond = np.array([10.0, 20.0, 30.0, 40.0, 50.0, 60.0])
    found: Any = SimpleNamespace(
        viscous=beyond, viscous_std=0.2 * beyond, coulomb=0.1 * beyond, coulomb_std=0.02 * beyond
    )
    exact = exact_model(configured(("    variant: full\n", model)))
    assert friction_block(found, exact) == {
        "viscous_friction_N_s_m": pytest.approx(np.array(viscous) + beyond),
        "coulomb_friction_N": pytest.approx(np.array(coulomb) + 0.1 * beyond),
    }


@pytest.mark.parametrize(
    ("reference", "position", "turn"),
    [
        (
            "{type: hold, pose: {position_m: [0.02, -0.03, 1.05], rotation_vector_deg: [2, -3, 4]}}",
            (0.02, -0.03, 1.05),
            (2.0, -3.0, 4.0),
        ),
        ("{type: hold}", (0.0, 0.0, 1.0), (0.0, 0.0, 0.0)),
        (load("virtual").reference, (0.0, 0.0, 1.0), (0.0, 0.0, 0.0)),
    ],
)
def test_the_platform_is_shaken_about_the_pose_that_is_held_and_else_about_home(
    monkeypatch, reference, position, turn
):
    monkeypatch.setattr("hil.lab.identify.runs.refuse_unreachable", lambda _: None)
    c = load("virtual")
    if isinstance(reference, str):
        first, last = c.text.index("\nreference:") + 1, c.text.index("\nlimits:") + 1
        c = loads(f"{c.text[:first]}reference: {reference}\n\n{c.text[last:]}", "my.yaml", Path())
    for excite in (excited, excited_axes):
        made = excite(c, None, None).configuration.reference
        assert isinstance(made, SinusoidReference)
        assert made.centre is not None
        assert (made.centre.position_m, made.centre.rotation_vector_deg) == (position, turn)
