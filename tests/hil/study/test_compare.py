"""`hil compare`: laws from the configuration, paths, disturbances, faults, and output files."""

import json
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner
from matplotlib.image import imread

from drivers.config import HomingSettings
from drivers.errors import ConfigurationError
from hil.app.configuration.compare import DisturbanceSettings, StepSettings
from hil.app.configuration.configuration import load, loads
from hil.app.configuration.text_file import shipped
from hil.cli import main
from hil.config.delay import DelayCompensation
from hil.config.reference import HoldReference
from hil.control import LAWS
from hil.control.law import ModelBasedSettings
from hil.control.pd import PDSettings
from hil.control.state_space import StateSpaceSettings
from hil.study.compare.command import compare
from hil.study.compare.laws import VARIANTS, changed, chosen, desired_loop, paths, with_scale
from hil.study.compare.measure import Job, measure
from plant_fmu.config import StewartPlant

DATA = Path(__file__).parents[2] / "data"
BOOK = json.loads((DATA / "book_closed_loop.json").read_text())["rows"]
WN = 20.0
SHIPPED_RATE_HZ = 1000.0
DESIGNED = f"{{law: state_space, controller_file: {DATA / 'controller.yaml'}}}"
HOLD_S = 0.5e-3
"""A force held for a period of 1 ms is delayed by half of it on average."""
BUS_S = (6 * 64.6 + 60.0 + 105.6) * 1e-6
"""Six feedbacks of 12 bytes, the controller's 60 us, a command of 32 bytes, at 1 and 5 Mbit/s. The tracking
error counts at the measurement of the lengths, the end of SYNC.
"""
LENGTH = np.sqrt(1.0 + 2.0**2 + 1.0**2 - 2 * 2.0 * 1.0 * np.cos(np.pi / 6))
"""m, of every leg of the book's platform at home: 1 m up, joint circles of 2 and 1 m, 30 degrees apart."""
S_Z = 1.0 / LENGTH
ROD, CYLINDER = 22.0, 85.0
"""kg, centres of mass 0.75 m from the platform's joint and from the base joint."""
TURNING = (CYLINDER * 0.75**2 + 16.0 + ROD * (LENGTH - 0.75) ** 2 + 4.1) / LENGTH**2
"""kg, a leg's inertia about its base joint as a mass at the platform."""
VERTICAL_MASS = 1150.0 + 6 * (ROD * S_Z**2 + TURNING * (1 - S_Z**2))
"""kg, for vertical motion: a rod moves along its leg, both halves turn."""
LEVER = (CYLINDER * 0.75 + ROD * (LENGTH - 0.75)) / LENGTH
VERTICAL_WEIGHT = 9.81 * (1150.0 + 6 * (ROD * S_Z**2 + LEVER * (1 - S_Z**2)))
"""N, weight that the platform's vertical motion lifts."""
LAG_S = 1 / (2 * np.pi * 200.0)
"""First-order force loop of 200 Hz."""


def with_law(c, settings):
    return changed(c, {"controller": settings})


@pytest.fixture(scope="module")
def virtual():
    return load("virtual")


@pytest.fixture(scope="module")
def ideal():
    return load("ideal")


def job(c, law="inverse_dynamics", **changes):
    base = Job(law, "own", with_law(c, chosen(c, [law])[law]), 0.1, None, None, 30 / WN)
    return base._replace(**changes)


def hil(*arguments):
    return CliRunner().invoke(main, ["compare", *map(str, arguments)])


def with_section(text):
    return load("virtual").text + text


def every_law(c):
    """All laws of the table for which a controller at the loop's rate is shipped."""
    designed = "hinf" in shipped("controllers") and c.loop.rate_Hz == SHIPPED_RATE_HZ
    return (set(LAWS) | set(VARIANTS)) - (set() if designed else {"state_space"})


def test_hil_compare_has_a_row_for_every_law_by_default(virtual):
    found = chosen(virtual)
    assert set(found) == every_law(virtual)
    assert found["inverse_dynamics"] == virtual.controller, "the configuration's own law is as configured"


def test_pd_gains_are_derived_from_the_largest_inertia_of_the_legs(virtual):
    """J^-T M J^-1 of the book's platform at home: the largest eigenvalue is 1595.67 kg."""
    pd = chosen(virtual, ["pd"])["pd"]
    assert isinstance(pd, PDSettings)
    assert pd.kp_N_m == pytest.approx(1595.673 * WN**2, rel=1e-6)
    assert pd.kv_N_s_m == pytest.approx(2 * 1595.673 * WN, rel=1e-6)


def test_frequency_and_damping_of_a_pd_law_are_used_for_all_other_laws(virtual):
    c = with_law(virtual, chosen(virtual, ["pd"])["pd"])
    f = desired_loop(c)
    assert (f.wn, f.zeta) == pytest.approx((WN, 1.0))


@pytest.mark.parametrize("name", ["bench", "lab", "vcan50"])
def test_every_shipped_configuration_has_compare_settings_for_every_law(name):
    c = load(name)
    assert set(chosen(c)) == every_law(c)


def test_controller_file_in_section_compare_is_compared_under_its_own_name(virtual):
    c = loads(with_section(f"\ncompare:\n  laws:\n    mine: {DESIGNED}\n"), "my.yaml", Path())
    assert list(chosen(c)) == ["mine"]
    scaled = with_scale(with_scale(chosen(c)["mine"], 0.5), 0.9)
    assert isinstance(scaled, StateSpaceSettings)
    assert scaled.model.inertia_scale == pytest.approx(0.45), "multiplies the scale of the model of the law"
    own = with_law(virtual, chosen(c)["mine"])
    assert chosen(own)["state_space"] == own.controller, "the configuration's own law is as configured"


OWN = """
compare:
  laws:
    stiff: {law: pd, kp_N_m: 2e6, kv_N_s_m: 5e4}
    light: {law: inverse_dynamics, wn_rad_s: 10, model: {inertia_scale: 0.8}}
"""


def test_laws_of_section_compare_are_the_default():
    c = loads(with_section(OWN), "my.yaml")
    assert list(chosen(c)) == ["stiff", "light"]
    assert list(chosen(c, ["stiff", "pd"])) == ["stiff", "pd"]
    assert chosen(c)["stiff"] == PDSettings(law="pd", kp_N_m=2e6, kv_N_s_m=5e4)


@pytest.mark.parametrize(
    ("section", "message"),
    [
        ("laws: {a: {law: pd, kp_N_m: 1e6}}", "compare.laws.a.kv_N_s_m: missing"),
        ("laws: {'a,b': {law: pd, kp_N_m: 1e6, kv_N_s_m: 1e4}}", "text without a comma"),
        ("disturbance: {force_N: [0, 0]}", "compare.disturbance.force_N"),
        ("disturbance: {start_s: 2, stop_s: 1}", "allowed: more than 2, given: 1"),
        ("inertia_scale: 0", "compare.inertia_scale: out of range, allowed: a number greater than 0"),
    ],
)
def test_an_invalid_section_compare_is_refused_with_its_place(section, message):
    with pytest.raises(ConfigurationError) as caught:
        loads(with_section(f"\ncompare:\n  {section}\n"), "my.yaml")
    assert message in str(caught.value)
    assert str(caught.value).startswith("my.yaml:")


def test_ideal_configuration_is_compared_with_one_signal_path_and_a_real_one_with_four(virtual, ideal):
    assert list(paths(ideal)) == ["ideal"]
    found = paths(virtual)
    assert list(found) == ["ideal", "encoders", "bus", "drives"]
    models = [c.plant.model for c in found.values() if c.plant and isinstance(c.plant.model, StewartPlant)]
    layouts = [c.bus.layout for c in found.values()]
    assert layouts == ["ideal", "ideal", "fd", "fd"]
    steps = [c.plant.drives.encoder_resolution_m for c in found.values() if c.plant]
    assert steps == [0.0, 1e-6, 1e-6, 1e-6]
    assert [model.force_bandwidth_Hz for model in models] == [0.0, 0.0, 0.0, 200.0]
    assert found["drives"] == virtual


def looking_ahead(c, **delays_ms):
    return c.controller.model_copy(update={"delay_compensation": DelayCompensation(**delays_ms)})


def delay_of_law(c):
    assert isinstance(c.controller, ModelBasedSettings)
    return c.controller.delay_compensation


def test_law_and_observer_compensate_the_remaining_delays_of_each_path(virtual):
    wrench = virtual.estimation.wrench.model_copy(update={"bus_ms": 0.5, "drive_lag_ms": 0.8})
    c = virtual.model_copy(
        update={
            "controller": looking_ahead(virtual, bus_ms=0.5, drive_lag_ms=0.8, hold_ms=0.5),
            "estimation": virtual.estimation.model_copy(update={"wrench": wrench}),
        }
    )
    left = {"ideal": (0.0, 0.0), "encoders": (0.0, 0.0), "bus": (0.5, 0.0), "drives": (0.5, 0.8)}
    for name, bench in paths(c).items():
        law, observer = delay_of_law(bench), bench.estimation.wrench
        assert law
        assert (law.bus_ms, law.drive_lag_ms) == (observer.bus_ms, observer.drive_lag_ms) == left[name]
        assert law.hold_ms == 0.5
    without_hold = with_law(c, looking_ahead(c, bus_ms=0.5, drive_lag_ms=0.8))
    assert delay_of_law(paths(without_hold)["ideal"]) is None


def test_drives_with_a_transmission_also_have_an_ideal_signal_path():
    """Without a bus the drives report leg lengths: motors and their lost turns play no part."""
    c = load("virtual-cia402")
    homing = HomingSettings(file="legs.yaml", limit_m=1e-4)
    c = c.model_copy(update={"drives": c.drives.model_copy(update={"homing": homing})})
    assert c.drives.transmission is not None
    ideal = paths(c)["ideal"]
    outcome = measure(Job("own", "ideal", ideal, 0.005, None, None, 0.1))
    assert outcome.fault is None
    assert outcome.figures["peak_leg_error_mm"] < 0.1
    assert (ideal.drives.transmission, ideal.drives.homing) == (None, None)
    assert paths(c)["bus"].drives == c.drives


@pytest.mark.long
def test_tracking_error_of_each_signal_path_is_proportional_to_its_delay(virtual):
    """The error of exact inverse dynamics is proportional to the delay; the delay of the hold is known."""
    zoh = BOOK["joint_IDC_exact_wn20_1kHz_ZOH"]["peak_leg_err_mm"]
    found = {
        name: measure(job(bench, duration_s=2.0)).figures["peak_leg_error_mm"]
        for name, bench in paths(virtual).items()
    }
    assert found["ideal"] == pytest.approx(zoh, rel=0.10)
    assert found["ideal"] < found["encoders"] < found["ideal"] + 2e-3
    assert found["bus"] == pytest.approx(zoh * (HOLD_S + BUS_S) / HOLD_S, rel=0.02)
    assert found["drives"] == pytest.approx(zoh * (HOLD_S + BUS_S + LAG_S) / HOLD_S, rel=0.05)


@pytest.fixture(scope="module")
def measured(ideal):
    return measure(job(ideal, duration_s=0.3, step=StepSettings(), settle_s=0.6))


def test_measured_rise_time_and_bandwidth_agree_with_the_linear_loop(measured):
    """wn 20 rad/s, zeta 1: 10 to 90 % in 3.358 / wn, -3 dB at 0.6436 wn; the hold delays by half a tick."""
    assert measured.fault is None
    found = measured.figures
    assert found["rise_ms"] == pytest.approx(3358 / WN, rel=0.01)
    assert found["bandwidth_Hz"] == pytest.approx(0.6436 * WN / (2 * np.pi), rel=0.01)
    assert found["overshoot_percent"] < 0.1
    assert found["settled"]
    assert found["steady_leg_error_mm"] < 1e-6


def believing(c, scale):
    return with_law(c, with_scale(chosen(c, ["inverse_dynamics"])["inverse_dynamics"], scale))


def test_too_small_model_masses_lower_bandwidth_and_damping_by_the_predicted_factor(ideal):
    """s M (K_D dE + K_P E) instead of M (...): wn and zeta are multiplied by sqrt(s). Without weight."""
    s = 0.25
    weightless = ideal.platform.model_copy(update={"gravity_m_s2": (0.0, 0.0, 0.0)})
    c = believing(ideal.model_copy(update={"platform": weightless}), s)
    zeta, wn = np.sqrt(s), np.sqrt(s) * WN
    a = 1 - 2 * zeta**2
    found = measure(job(ideal, configuration=c, duration_s=0.01, step=StepSettings())).figures
    bandwidth = wn / (2 * np.pi) * np.sqrt(a + np.sqrt(1 + a**2))
    assert found["bandwidth_Hz"] == pytest.approx(bandwidth, rel=0.02)
    overshoot = np.exp(-np.pi * zeta / np.sqrt(1 - zeta**2))
    assert found["overshoot_percent"] == pytest.approx(100 * overshoot, rel=0.05)


def test_too_small_model_masses_let_the_platform_sag(ideal):
    """At rest s M wn^2 dz = (1 - s) G, every leg s_z dz short."""
    s = 0.9
    found = measure(job(ideal, configuration=believing(ideal, s), step=StepSettings(), settle_s=0.6)).figures
    sag = (1 - s) / s * VERTICAL_WEIGHT / VERTICAL_MASS / WN**2
    assert found["steady_leg_error_mm"] == pytest.approx(1e3 * S_Z * sag, rel=0.01)


def test_an_unknown_load_deflects_the_platform_against_the_loops_stiffness(ideal):
    """At rest M wn^2 dz = 500 N, every leg s_z dz short."""
    load = DisturbanceSettings(force_N=(0, 0, -500), start_s=0.05)
    quiet = measure(job(ideal)).figures
    found = measure(job(ideal, disturbance=load, step=StepSettings(), settle_s=0.6)).figures
    assert found["peak_leg_error_mm"] > 10 * quiet["peak_leg_error_mm"], "the load also acts while tracking"
    sag = 500 / VERTICAL_MASS / WN**2
    assert found["disturbed_steady_leg_error_mm"] == pytest.approx(1e3 * S_Z * sag, rel=0.01)
    assert found["steady_leg_error_mm"] < 1e-6


def test_no_error_at_rest_is_given_for_a_load_under_which_the_run_ends_in_a_fault(virtual):
    load = DisturbanceSettings(force_N=(0, 0, -9000), start_s=0.05)
    found = measure(job(virtual, disturbance=load, step=StepSettings(), settle_s=0.6)).figures
    assert found["disturbed_peak_leg_error_mm"] > 9.0
    assert "disturbed_steady_leg_error_mm" not in found


def test_a_law_that_faults_keeps_its_figures_until_the_fault(virtual):
    o = measure(job(virtual, "pd", duration_s=2.0))
    assert o.fault == "FOLLOWING"
    assert o.fault_s is not None
    assert 0.1 < o.fault_s < 1.0
    assert 9.0 < o.figures["peak_leg_error_mm"] < 12.0, "limits.following_error_m is 10 mm"
    assert o.figures["tracked_s"] == o.fault_s
    assert len(o.traces["t"]) > 100


@pytest.fixture(scope="module")
def compared(tmp_path_factory):
    folder = tmp_path_factory.mktemp("compare")
    result = CliRunner(env={"COLUMNS": "100"}).invoke(
        main,
        [
            *("compare", "virtual", "--laws", "pd,inverse_dynamics,printed", "--duration", "0.7"),
            *("--jobs", "1", "--picture", str(folder), "--json", str(folder / "a.json")),
        ],
    )
    assert result.exit_code == 0, result.output
    return folder, result.output, json.loads((folder / "a.json").read_text())


def test_the_table_has_one_row_per_law_and_marks_faults(compared):
    lines = compared[1].splitlines()
    assert {"pd", "inverse_dynamics", "printed"} <= {line.split()[0] for line in lines if line.strip()}
    assert "FOLLOWING at 0." in next(line for line in lines if line.startswith("pd "))
    assert "--lift-limits" in compared[1]


def test_the_json_file_has_figures_settings_losses_and_claims(compared):
    folder, _, summary = compared
    (file,) = folder.glob("virtual-compare-*.png")
    assert summary["picture"] == str(file)
    assert len(np.unique(imread(file).reshape(-1, 4), axis=0)) > 100
    assert summary["success"], "the configuration's own law went well"
    assert summary["laws"]["pd"]["fault"] == "FOLLOWING"
    assert summary["laws"]["inverse_dynamics"]["fault"] is None
    assert summary["laws"]["inverse_dynamics"]["settings"]["wn_rad_s"] == WN
    assert summary["laws"]["printed"]["force_variation_N"] > 1000
    losses = summary["paths"]["inverse_dynamics"]
    assert list(losses) == ["ideal", "encoders", "bus", "as configured"]
    peaks = [o["peak_leg_error_mm"] for o in losses.values()]
    assert peaks == sorted(peaks)
    claims = {c["claim"]: c["holds"] for c in summary["claims"]}
    assert claims["the law may be printed without (dJ/dt) twist"] is False
    assert claims["inverse dynamics leaves E'' + K_D E' + K_P E = 0"] is True


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("--laws", "lqr"), "unknown law lqr; allowed: cartesian_pd, "),
        (("--laws", ","), "Invalid value for '--laws': it contains no name"),
        (("--wrench", "nan", *"00000"), "'nan', allowed in size"),
        (("--wrench-at", 0.5), "--wrench-at is the time of --wrench"),
        (("--wrench", *"100000", "--wrench-at", 2), "the reference ends before the load begins"),
        (("--laws", "pd", "--paths", "printed"), "printed is not among the compared laws: pd"),
        (("--picture", "a.pdf"), "let its name end in .png"),
    ],
)
def test_invalid_options_are_refused_before_anything_runs(arguments, message):
    result = hil("virtual", *arguments)
    assert result.exit_code == 2
    assert message in result.output


def test_a_reference_without_end_needs_a_duration(virtual, tmp_path):
    c = changed(virtual, {"reference": HoldReference(type="hold")})
    with pytest.raises(ConfigurationError, match="has no end"):
        compare(c, laws=["inverse_dynamics"], picture=tmp_path / "a.png")


def test_the_example_section_in_the_guide_is_valid():
    guide = (Path(__file__).parents[3] / "docs/guides/compare.md").read_text()
    section = guide.split("```yaml\n")[1].split("```")[0]
    c = loads(with_section("\n" + section), "my.yaml")
    assert list(chosen(c)) == ["stiff", "slow"]
    assert c.compare.disturbance == DisturbanceSettings(force_N=(0, 0, -500), start_s=0.5)
