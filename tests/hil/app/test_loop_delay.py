"""How late a force answers a measurement: one answer in every report."""

import pytest

from hil.app.check.controller import report_controller
from hil.app.check.findings import Report
from hil.app.configuration.configuration import load
from hil.app.loop_delay import loop_delay
from hil.app.stability.subject import Stated, Subject
from hil.config.delay import DelayCompensation
from plant_fmu.config import BenchPlant, FmuPlant, StewartPlant

OTHERS_FMU = FmuPlant.model_construct(type="fmu", path="own.fmu")


def configuration(model, bandwidth_Hz=0.0, **controller):
    """Return `virtual`, at 1 kHz over a real bus, with another plant behind drives of such a bandwidth."""
    c = load("virtual")
    assert c.plant is not None
    drives = c.plant.drives.model_copy(update={"force_bandwidth_Hz": bandwidth_Hz})
    plant = None if model is None else c.plant.model_copy(update={"model": model, "drives": drives})
    return c.model_copy(update={"plant": plant, "controller": c.controller.model_copy(update=controller)})


def checked_ms(c):
    report = Report("")
    report_controller(report, c)
    return report.figures["controller"]["delay_ms"]


@pytest.mark.parametrize(
    ("model", "bandwidth_Hz", "lag_ms"),
    [
        (OTHERS_FMU, 50.0, 3.183),
        (OTHERS_FMU, 0.0, 0.0),
        (BenchPlant(type="bench"), 200.0, 0.796),
        (StewartPlant(type="stewart", force_bandwidth_Hz=200.0), 0.0, 0.796),
        (StewartPlant(type="stewart", force_bandwidth_Hz=0.0), 0.0, 0.0),
        (None, 0.0, 0.0),
    ],
)
def test_the_lag_of_whichever_drives_there_are_counts_in_check_and_in_the_theorems(
    model, bandwidth_Hz, lag_ms
):
    c = configuration(model, bandwidth_Hz)
    axis = Subject(c, Stated()).axis
    assert 1e3 * axis.transport_s == pytest.approx(1.0)  # at most a period
    assert 1e3 * axis.lag_s == pytest.approx(lag_ms, abs=1e-3)
    assert checked_ms(c) == pytest.approx(1.0 + 0.5 + lag_ms, abs=1e-3)


def test_delays_that_the_law_states_count_in_both_before_those_of_the_plant():
    c = configuration(OTHERS_FMU, 50.0, delay_compensation=DelayCompensation(bus_ms=0.4, drive_lag_ms=0.7))
    axis = Subject(c, Stated()).axis
    assert (axis.transport_s, axis.lag_s) == pytest.approx((0.4e-3, 0.7e-3))
    assert checked_ms(c) == pytest.approx(0.4 + 0.5 + 0.7)


def test_on_the_ideal_bus_only_hold_and_lag_are_left():
    ideal = load("ideal")
    assert loop_delay(ideal).transport_s == 0.0
    assert loop_delay(ideal).total_s == pytest.approx(0.5e-3)
