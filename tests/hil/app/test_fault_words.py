"""Faults in the configuration and in the words of a command: meaning and refusals."""

from __future__ import annotations

import pytest
from click.testing import CliRunner

from drivers.errors import ConfigurationError
from hil.app.configuration.configuration import load, loads
from hil.app.configuration.fault_words import read_fault, show_fault, with_faults
from hil.cli import main
from plant_fmu.faults.kinds import (
    BrakeSlow,
    BrakeStuckOpen,
    EncoderJump,
    FramesLoss,
    PayloadStep,
    ProcessKill,
    WrenchStep,
)


def configured(name: str, entry: str):
    text = load(name).text.replace("\nplant:", f"\nplant:\n  faults:\n    - {entry}\n", 1)
    return loads(text, "my.yaml", load(name).folder)


# words

MEANT = [
    ("encoder_jump leg=0 at=2 by=5e-3", EncoderJump(leg=0, at_s=2.0, by_m=5e-3)),
    ("encoder_jump leg=0 at_s=2 by_m=5e-3", EncoderJump(leg=0, at_s=2.0, by_m=5e-3)),
    ("brake_stuck_open leg=3 mode=PARKING", BrakeStuckOpen(leg=3, mode="PARKING")),
    ("brake_slow leg=3 by=150 for=2", BrakeSlow(leg=3, by_ms=150.0, for_s=2.0)),
    (
        "frames_loss probability=0.1 identifier=642 seed=7",
        FramesLoss(probability=0.1, identifier=642, seed=7),
    ),
    ("wrench_step force=0,0,-500 moment=1,2,3", WrenchStep(force_N=(0, 0, -500), moment_N_m=(1, 2, 3))),
    ("payload_step mass=50 position=0.2,0,0.1", PayloadStep(mass_kg=50.0, position_m=(0.2, 0.0, 0.1))),
    ("process_kill at=3", ProcessKill(at_s=3.0)),
]


@pytest.mark.parametrize(("text", "fault"), MEANT, ids=[text for text, _ in MEANT])
def test_fault_text_is_parsed_and_printed_back_as_the_configured_fault(text, fault):
    assert read_fault(text) == fault
    assert read_fault(show_fault(fault)) == fault


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("encoder_jmp leg=0 by=1", "unknown kind 'encoder_jmp', did you mean encoder_jump? allowed: encoder_jump, "),
        ("", "unknown kind ''"),
        ("encoder_jump leg=0 bye=1", "bye: unknown key, allowed: kind, at_s, mode, for_s, leg, by_m"),
        ("encoder_jump leg=0", "by_m: missing, allowed: a number"),
        ("encoder_jump leg=6 by=1", "leg: out of range, allowed: a whole number at least 0 and less than 6, given: 6"),
        ("encoder_jump leg=0 by=far", 'by_m: wrong type, allowed: a number, given: "far"'),
        ("encoder_jump leg=0 by=1 by_m=2", "by_m: key given twice"),
        ("encoder_jump leg=0 by=1 mode=FLYING", "mode: unknown value, allowed: IDLE, LOADING, "),
        ("drive_reset leg=0 for=1", "for: unknown key, allowed: kind, at_s, mode, leg"),
    ],
)  # fmt: skip
def test_option_fault_with_invalid_text_is_refused_with_the_allowed_values(text, message):
    with pytest.raises(ConfigurationError) as refused:
        read_fault(text)
    assert str(refused.value).startswith(f'--fault "{text}": ')
    assert message in str(refused.value)


# configuration


def test_option_fault_adds_a_fault_to_those_of_the_configuration():
    c = configured("virtual", "{kind: encoder_jump, leg: 0, at_s: 2, by_m: 5e-3}")
    more = with_faults(c, ["drive_silence leg=1"])
    assert c.plant is not None
    assert more.plant is not None
    assert [show_fault(fault) for fault in more.plant.faults] == [
        "encoder_jump at=2 leg=0 by=0.005",
        "drive_silence leg=1",
    ]
    assert len(c.plant.faults) == 1


def test_sim_refuses_process_faults_and_plant_refuses_mode_faults():
    process = with_faults(load("virtual"), ["process_kill at=1"])
    process.require("plant")
    with pytest.raises(ConfigurationError, match="process_kill: a simulation has no separate process"):
        process.require("sim")
    mode = with_faults(load("virtual"), ["drive_silence leg=0 mode=PARKING"])
    mode.require("sim")
    with pytest.raises(ConfigurationError, match=r"PARKING: the plant's end does not know .* `hil sim`"):
        mode.require("plant")


# commands


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (("sim", "virtual", "--fault", "teleport"), "unknown kind 'teleport'"),
        (("sim", "virtual", "--fault", "process_kill"), "a simulation has no separate process"),
        (
            ("plant", "virtual", "--fault", "drive_silence leg=0 mode=HOLD"),
            "does not know the controller's mode",
        ),
        (("run", "virtual", "--plant", "--fault", "drive_silence leg=0 mode=HOLD"), "does not know"),
        (("run", "virtual", "--fault", "drive_silence leg=0"), "add --plant"),
        (("faults", "virtual", "--only", "nothing*"), "matches no case"),
        (("faults", "virtual", "--legs", "two"), "two, allowed: leg numbers with commas"),
        (("faults", "virtual", "--legs", "0,6"), "unknown leg 6, allowed: 0 to 5"),
        (("faults", "virtual", "--only", "plant_nan/HOLD", "--junit", "/nowhere/x.xml"), "no folder"),
    ],
)
def test_commands_refuse_invalid_fault_options_before_the_run_starts(words, message):
    result = CliRunner().invoke(main, list(words))
    assert result.exit_code == 2, result.output
    assert message in " ".join(result.output.split())
