"""`hil new`: five very different robots, calculated figures, and implausible answers."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from click.testing import CliRunner

from drivers.errors import ConfigurationError
from hil.app.check.command import inspect
from hil.app.configuration.configuration import load
from hil.app.configuration.platform import joint_list
from hil.app.configuration.schema import named_schema, schema_path
from hil.app.new import derive
from hil.app.new.answers import QUESTIONS
from hil.app.new.command import new_configuration
from hil.app.new.robot import robot_at_home
from hil.app.sim.command import simulate
from hil.cli import main
from plant_fmu.fmu.propose import Proposal
from tests.broad import broad

ROBOTS = {
    "desktop": (
        "--base-radius 0.12 --platform-radius 0.08 --length-min 0.16 --stroke 0.04 --mass 2 --leg-mass 0.15 "
        "--drive-force 60 --drive-speed 0.05"
    ),
    "table": (
        "--base-radius 0.35 --platform-radius 0.25 --length-min 0.5 --stroke 0.2 --mass 42 --leg-mass 4 "
        "--drive-force 800 --drive-speed 0.3 --reflected-mass 5"
    ),
    "stand": (
        "--base-radius 0.7 --platform-radius 0.5 --length-min 0.8 --stroke 0.35 --mass 200 --com-height 0.2 "
        "--leg-mass 15 --drive-force 3000 --drive-speed 0.5 --reflected-mass 20 --inertia 15,15,25"
    ),
    "simulator": (
        "--base-radius 1.8 --platform-radius 1.6 --length-min 2 --stroke 1 --mass 2000 --com-height 0.6 "
        "--leg-mass 120 --drive-force 20000 --drive-speed 0.8 --reflected-mass 150 --layout classic"
    ),
    "hanging": (
        "--base-radius 0.5 --platform-radius 0.2 --length-min 0.6 --stroke 0.25 --mounting hanging --mass 30 "
        "--com-height 0.1 --leg-mass 3 --drive-force 600 --drive-speed 0.4"
    ),
}


def new(path, words, *more, answers=None):
    options = words.split() if answers is not None else [*words.split(), "--yes"]
    return CliRunner().invoke(main, ["new", str(path), *options, *more], input=answers)


@pytest.mark.parametrize("name", broad(ROBOTS, quick=1))
def test_configuration_of_hil_new_passes_hil_check_with_force_in_reserve(name, tmp_path):
    path = tmp_path / f"{name}.yaml"
    done = new(path, ROBOTS[name])
    assert done.exit_code == 0, done.output
    report = inspect(load(path))
    words = dict(zip(ROBOTS[name].split()[::2], ROBOTS[name].split()[1::2], strict=True))
    low, stroke = float(words["--length-min"]), float(words["--stroke"])
    home, path_figures = report.figures["home"], report.figures["reference"]
    np.testing.assert_allclose(home["leg_lengths_m"], low + stroke / 2, rtol=1e-6)
    assert low + 0.25 * stroke < path_figures["length_min_m"] < low + 0.4 * stroke
    assert low + 0.6 * stroke < path_figures["length_max_m"] < low + 0.75 * stroke
    assert path_figures["rate_max_m_s"] <= 0.26 * float(words["--drive-speed"])
    assert max(abs(path_figures["force_min_N"]), path_figures["force_max_N"]) < 0.6 * float(
        words["--drive-force"]
    )
    assert all("silence" in warning or "SCHED_FIFO" in warning for warning in report.warnings), (
        report.warnings
    )


@pytest.mark.parametrize(
    "name",
    [
        "desktop",
        pytest.param("simulator", marks=pytest.mark.long),
        pytest.param("hanging", marks=pytest.mark.long),
    ],
)
def test_new_robot_tracks_its_path_parks_and_replays(name, tmp_path):
    path = tmp_path / f"{name}.yaml"
    assert new(path, ROBOTS[name]).exit_code == 0
    summary = simulate(load(path), log=tmp_path / "run.mcap", duration_s=3.0)
    assert summary["success"]
    assert summary["replay"]["agrees"]
    stroke = float(ROBOTS[name].split("--stroke ")[1].split()[0])
    assert summary["tracking"]["peak_leg_error_mm"] < stroke  # a thousandth of it


MOUNTED = {
    "wall": [-9.81, 0, 0],
    "hanging": [0, 0, 9.81],
    "standing": [0, 0, -9.81],
    "0,6.937,-6.937": [0, 6.937, -6.937],
}


@pytest.mark.parametrize("mounting", MOUNTED)
def test_leg_forces_of_a_robot_from_hil_new_carry_its_weight_in_each_mounting(mounting, tmp_path):
    """The sum of the leg forces along gravity is the weight of the platform and the share of the legs at it."""
    path, gravity = tmp_path / "r.yaml", np.array(MOUNTED[mounting])
    done = new(path, ROBOTS["table"], "--mounting", mounting, "--leg-mass", "0")
    assert done.exit_code == 0, done.output
    home = inspect(load(path)).figures["home"]
    c = load(path).platform
    a, b = (np.array(joint_list(joints)) for joints in (c.base_joints_m, c.platform_joints_m))
    legs = b + np.array(c.home.position_m) - a
    along = np.array(home["static_forces_N"]) @ (legs / np.linalg.norm(legs, axis=1)[:, None])
    np.testing.assert_allclose(along, -42 * gravity, rtol=1e-6, atol=1e-6)


def test_new_robot_on_a_wall_needs_an_fmu_with_gravity_in_each_direction(tmp_path):
    proposal = Proposal("x", "3.0", False, {}, {}, ("mass", "gravity_z"))
    answers = answered() | {"mounting": "wall"}
    with pytest.raises(ConfigurationError, match="gravity_x"):
        new_configuration(answers, tmp_path / "r.yaml", (tmp_path / "r.fmu", proposal))


LIGHT = (
    "--mounting hanging --base-radius 0.2 --platform-radius 0.12 --length-min 0.3 --stroke 0.12 --mass 5 "
    "--leg-mass 0.5 --drive-force 200 --drive-speed 0.3 --drives cubemars --model AK80-9"
)


@pytest.mark.parametrize(
    ("words", "told"),
    [
        ("--stroke 0.5", "--stroke: a telescopic leg of 0.5 m"),
        ("--length-min 0.15 --stroke 0.02", "--stroke: retracted legs of 0.15 m do not lift the platform"),
        ("--platform-radius 0.35 --base-half-angle 30 --platform-half-angle 30", "condition number"),
        ("--drive-force 100", "--drive-force: a leg carries"),
        ("--brake-force 50", "--brake-force: a leg carries"),
        ("--inertia 1,1,9", "--inertia: "),
        ("--mounting sideways", "allowed: standing, wall, hanging, or gravity as three numbers"),
        ("--mounting 0,0,nan", "allowed: standing, wall, hanging, or gravity as three numbers"),
        ("--inertia 1,1", "'--inertia': allowed: three numbers"),
        ("--cylinder-mass 5", "--cylinder-mass: heavier than the whole leg, allowed: at most 4 kg"),
        ("--coulomb-friction 401", "--coulomb-friction: over half the rated force"),
        ("--reflected-mass 5e-5@0", "'--reflected-mass': 5e-5@0, allowed: kg, or kg m^2@m"),
        ("--reflected-mass rotor@0.005", "'--reflected-mass': rotor@0.005, allowed: kg"),
        ("--reflected-mass -1", "'--reflected-mass': -1.0 is not in the range"),
        ("--encoder-resolution 1e-3", "--encoder-resolution: below 1000 counts"),
        ("--drive-speed 20", "--drive-speed: whole stroke in less than 20 ms"),
        ("--mass nan", "'--mass': nan is not finite"),
        ("--base-radius 0,35", "not a valid number in m without the unit, with a decimal point"),
        ("--rate 1500", "--rate: bus: the frames of one tick do not fit"),
        ("--rate 5", "'--rate': 5.0 is not in the range"),
        ("", "no default for --base-radius, --platform-radius, --length-min, --stroke, --mass, --leg-mass"),
        ("--drives moteus", "no default for --travel"),
        ("--drives legs --travel 0.01", "--travel: does not apply to drives of legs"),
        ("--drives moteus --travel 0.01 --model AK80-9", "--model: does not apply to drives of moteus"),
        ("--drives damiao --model AK80-9 --travel 0.1", "--model: allowed with damiao: DM4310"),
        # +-12.5 rad are 3.98 turns, 0.2 m of stroke over them 0.0503 m; 54 N m over 800 N are 0.424 m
        ("--drives damiao --model DM8009 --travel 0.01", "--travel: allowed with DM8009: 0.05077 to 0.4199 m"),
        ("--drives damiao --model DM3507 --travel 0.06", "--travel: DM3507 suits no lead"),
        ("--drives cubemars --travel 0.06", "no default for --model"),
        ("--drives moteus --travel 0.01 --layout classic", "--layout: drives of moteus have fd frames only"),
        ("--drives cia402 --travel 0.01 --rate 500", "--rate: bus: the frames of one tick do not fit"),
        # by hand: 2 x 18 N m on 4095 steps, over 0.06 m a turn, are 0.92 N; over 0.13 m 0.42 N
        (f"{LIGHT} --travel 0.06", "allowed with AK80-9: 0.1257 to 0.5598 m a turn"),
        (f"{LIGHT} --travel 0.06", "one code of torque is 0.92 N at the leg"),
        (f"{LIGHT} --travel 0.13 --rate 250", "--rate: at 250 Hz one code of torque is 0.42 N"),
    ],
)  # fmt: skip
def test_implausible_answer_is_refused_and_nothing_is_written(words, told, tmp_path):
    robot = "" if not words or words.startswith(LIGHT) else ROBOTS["table"]
    done = new(tmp_path / "r.yaml", f"{robot} {words}")
    assert done.exit_code == 2
    assert told in done.output
    assert not list(tmp_path.iterdir())


DRIVES = {
    "moteus": "--drives moteus --travel 0.01",
    "cia402": "--drives cia402 --travel 0.01",
    "odrive": "--drives odrive --travel 0.02",
    "cubemars": "--drives cubemars --model AK80-9 --travel 0.06",
    "damiao": "--drives damiao --model DM8009 --travel 0.1",
    "mini_cheetah": "--drives mini_cheetah --travel 0.1",
    "robstride": "--drives robstride --model rs-02 --travel 0.1",
}


@pytest.mark.long
@pytest.mark.parametrize("name", DRIVES)
def test_new_robot_runs_at_the_highest_rate_of_its_drives(name, tmp_path):
    """Rates of the table of docs/guides/drives.md, rounded down to a candidate rate."""
    rate_Hz = {"cia402": 312.5, "odrive": 312.5, "robstride": 312.5}.get(name, 400.0)
    path = tmp_path / f"{name}.yaml"
    done = new(path, f"{ROBOTS['table']} {DRIVES[name]}")
    assert done.exit_code == 0, done.output
    summary = simulate(load(path), log=tmp_path / "run.mcap", duration_s=3.0)
    assert summary["success"], summary
    assert summary["rate_Hz"] == rate_Hz
    assert summary["tracking"]["peak_leg_error_mm"] < 0.5
    assert summary["replay"]["agrees"]


HEAVY = ROBOTS["simulator"].replace(" --layout classic", " --drives cia402 --travel 0.01 --rate 500")


def test_hil_new_refuses_a_rate_too_high_for_one_bus_with_the_needed_bus_count(tmp_path):
    """docs/guides/buses.md: six drives on one bus take 2005 us of a tick, three on a bus 1030 us."""
    path = tmp_path / "r.yaml"
    done = new(path, HEAVY)
    assert done.exit_code == 2
    assert "2005.0 us of a 2000.0 us period" in done.output
    assert "here --channels 2 is enough" in done.output
    for words, legs in (
        ("--channels 2", {"hil0": [0, 1, 2], "hil1": [3, 4, 5]}),
        ("--channels 3 --interface socketcan", {"can0": [0, 1], "can1": [2, 3], "can2": [4, 5]}),
    ):
        assert new(path, f"{HEAVY} {words}", "--force").exit_code == 0
        c = load(path)
        assert {each.channel: each.legs for each in c.bus.channels} == legs
        assert (c.loop.rate_Hz, c.bus.layout, c.bus.bitrate_bit_s) == (500.0, "classic", 1_000_000)


def test_hil_new_repeats_a_question_after_an_implausible_answer(tmp_path):
    path = tmp_path / "r.yaml"
    typed = "0.35 0.25 10 10 0.5 0.9 0.2 standing 42 0 estimate 4 9 2.8 100 800 0.3 5 0 0 1e-6 800 50 "
    typed += "localcan legs FD 1 1000"
    done = new(path, "", answers="\n".join(typed.split()) + "\n")
    assert done.exit_code == 0, done.output
    assert done.output.count("impossible: ") == 3
    assert "impossible: a telescopic leg of 0.5 m" in done.output
    asked, given = tmp_path / "a.yaml", ROBOTS["table"]
    assert new(asked, given).exit_code == 0
    a, b = (yaml.safe_load(file.read_text()) for file in (path, asked))
    assert {k: v for k, v in a.items() if k != "name"} == {k: v for k, v in b.items() if k != "name"}


def test_hil_new_whose_input_ends_early_reports_the_open_question_and_writes_no_file(tmp_path):
    done = new(tmp_path / "r.yaml", "", answers="0.35\n0.25\n")
    assert done.exit_code == 2
    assert "ended at base_half_angle_deg, nothing is written" in done.output
    assert "--base-half-angle" in done.output
    assert not list(tmp_path.iterdir())


def test_existing_file_is_not_overwritten_without_force(tmp_path):
    path = tmp_path / "r.yaml"
    path.write_text("mine")
    assert new(path, ROBOTS["desktop"]).exit_code == 2
    assert path.read_text() == "mine"
    assert new(path, ROBOTS["desktop"], "--force").exit_code == 0
    assert named_schema(path.read_text()) == str(schema_path())


def test_hil_schema_restores_a_missing_schema(tmp_path):
    path = tmp_path / "copy.yaml"
    text = load("ideal").text
    path.write_text(text)
    assert any("Unable to load schema" in warning for warning in inspect(load(path)).warnings)
    assert CliRunner().invoke(main, ["schema", str(path)]).exit_code == 0
    mended = path.read_text()
    named = named_schema(mended)
    assert named is not None
    assert '"title": "hexapod-hil configuration"' in Path(named).read_text()
    assert mended.splitlines()[1:] == text.splitlines()[1:]
    assert not [w for w in inspect(load(path)).warnings if "schema" in w]


def answered() -> dict[str, Any]:
    """Answers for the table of 42 kg; defaults for questions without an option there."""
    typed = dict(zip(ROBOTS["table"].split()[::2], ROBOTS["table"].split()[1::2], strict=True))
    answers: dict[str, Any] = {}
    for question in QUESTIONS:
        if question.needed(answers):
            text = typed.get(question.option)
            assert text is not None or question.default is not None
            answers[question.key] = question.kind(text) if text else question.default(answers)  # type: ignore[misc]
    return answers


@pytest.mark.parametrize(
    "words",
    ["--encoder-resolution 1.32500004e-4", "--stroke 0.012344", "--mass 2.36 --platform-radius 0.1862699"],
)
def test_hil_new_writes_a_valid_configuration_although_its_figures_are_rounded(words, tmp_path):
    """standstill_m is at least four encoder counts; the axial moment of a disc is the sum of the others."""
    assert new(tmp_path / "r.yaml", f"{ROBOTS['table']} {words}").exit_code == 0


def test_brake_time_of_hil_new_covers_closing_and_stopping_the_fastest_leg():
    """60 kg at 1 m/s: 50 ms, then 1000 N minus 400 N of weight take 100 ms; 0.18 s are written."""
    a = answered() | {"brake_ms": 50.0, "brake_force_N": 1000.0}
    for held in ([400.0, 0, 0, 0, 0, 0], [100.0, 0, 0, 0, -400.0, 0]):
        bearing = robot_at_home(a)._replace(static_N=np.array(held), leg_mass_kg=60.0)
        assert derive.closing_s(a, bearing, 1.0) == pytest.approx(0.18)
        assert derive.closing_s(a, bearing, 2.0) == pytest.approx(0.3)
        # weight that leaves a brake less than a twentieth of its force: 50 N
        weak = derive.closing_s(a | {"brake_force_N": 401.0}, bearing, 1.0)
        assert weak == pytest.approx(1.2 * (0.05 + 60.0 / 20.05), rel=0.04)


def test_reflected_mass_takes_the_inertia_of_a_rotor_and_the_lead_of_its_screw(tmp_path):
    """I (2 pi / lead)^2: 5e-5 kg m^2 on a 5 mm screw are 78.96 kg."""
    path = tmp_path / "screws.yaml"
    assert (
        new(path, ROBOTS["stand"].replace("--reflected-mass 20", "--reflected-mass 5e-5@0.005")).exit_code
        == 0
    )
    c: Any = load(path)
    assert c.plant.model.reflected_mass_kg == pytest.approx(78.957, abs=1e-3)
    assert c.controller.model.reflected_mass_kg == c.plant.model.reflected_mass_kg


def test_stated_friction_is_compensated_and_is_in_the_plant(tmp_path):
    path = tmp_path / "r.yaml"
    friction = ["--coulomb-friction", "60", "--viscous-friction", "200"]
    done = new(path, ROBOTS["stand"], *friction)
    assert done.exit_code == 0, done.output
    c: Any = load(path)
    for part in (c.controller.model, c.plant.model):
        assert (part.coulomb_friction_N, part.viscous_friction_N_s_m) == (60.0, 200.0)
    assert not any("force_N" in warning for warning in inspect(c).warnings)


SLOW = [["--rate", "50"], ["--rate", "100"], ["--drives", "odrive", "--travel", "0.05"]]


@pytest.mark.parametrize("more", broad(SLOW, quick=1))
def test_robot_with_friction_and_rotors_is_valid_at_a_low_rate(more, tmp_path):
    robot = (
        "--base-radius 0.3 --platform-radius 0.2 --length-min 0.35 --stroke 0.15 --mass 20 --leg-mass 1.5 "
        "--drive-force 300 --drive-speed 0.4 --reflected-mass 5e-5@0.005 --coulomb-friction 6"
    )
    done = new(tmp_path / "r.yaml", robot, *more)
    assert done.exit_code == 0, done.output


def test_new_robot_that_sticks_at_a_low_rate_tracks_its_own_path(tmp_path):
    """At 312.5 Hz the law is soft: the friction leaves more than 2 % of the stroke."""
    robot = (
        "--base-radius 0.3 --platform-radius 0.2 --length-min 0.35 --stroke 0.15 --mass 20 --leg-mass 1.5 "
        "--drive-force 300 --drive-speed 0.4 --coulomb-friction 6 --drives odrive --travel 0.05"
    )
    assert new(tmp_path / "r.yaml", robot).exit_code == 0
    assert simulate(load(tmp_path / "r.yaml"), duration_s=10.0, log=tmp_path / "r.mcap")["success"]


def test_masses_of_both_halves_of_a_leg_are_those_given(tmp_path):
    path = tmp_path / "r.yaml"
    assert new(path, ROBOTS["stand"], "--cylinder-mass", "12").exit_code == 0
    platform = load(path).platform
    assert (platform.cylinder.mass_kg, platform.rod.mass_kg) == (12.0, 3.0)
