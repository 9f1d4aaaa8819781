"""The desktop hexapod with each family of drives that can be bought, in lockstep, beside our own protocol."""

from __future__ import annotations

from functools import cache
from importlib import resources
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import pytest

from drivers.errors import ConfigurationError
from drivers.signals import DriveState, Mode
from hil.app.compose import build_cycle
from hil.app.configuration.changes import with_changes
from hil.app.configuration.configuration import Configuration, loads
from hil.app.sim.command import simulate
from hil.loop.report import waiting_text
from hil.record.log import Log
from plant_fmu.faults.kinds import BusOff
from tests.broad import broad
from tests.loop.test_held import run

TEXT = resources.files("configs").joinpath("desktop.yaml").read_text(encoding="utf-8")
MIT = "  protocol: mit\n  options: {variant: damiao, model: DM4310}\n"
GEAR = TEXT[TEXT.index("  transmission:\n") : TEXT.index("  watchdog_ms")]
SLOW = ("rate_Hz: 400\n", "rate_Hz: 312.5\n")
FAMILIES: dict[str, tuple[tuple[str, str], ...]] = {
    "legs": ((MIT, ""), (GEAR, "")),
    "damiao": (),
    "cubemars": (("variant: damiao, model: DM4310", "variant: cubemars, model: AK80-9"),),
    "mini_cheetah": (("variant: damiao, model: DM4310", "variant: mini_cheetah"),),
    "robstride": (("variant: damiao, model: DM4310", "variant: robstride, model: rs-02"), SLOW),
    "odrive": ((MIT, "  protocol: odrive\n"), SLOW),
    "moteus": (
        (MIT, "  protocol: moteus\n  options: {timeout_mode: stopped, torque_N_m: 7}\n"),
        ("layout: classic\n", "layout: fd\n"),
    ),
}
SOME = ("legs", "moteus")
"""Run every day; the others are their variants, or in the contract suite alone."""


def desktop(*changes: tuple[str, str]) -> Configuration:
    text = TEXT
    for old, new in changes:
        assert text.count(old) == 1, old
        text = text.replace(old, new)
    return loads(text, "desktop")


@cache
def simulated(family: str) -> tuple[dict[str, Any], Any]:
    with TemporaryDirectory() as folder:
        path = Path(folder) / "run.mcap"
        summary = simulate(desktop(*FAMILIES[family]), log=path, duration_s=4.0)
        return summary, Log.open(path).rows()


@pytest.mark.parametrize("family", broad(sorted(FAMILIES, key=lambda n: n not in SOME), quick=len(SOME)))
def test_it_runs_to_parked_and_replays_to_the_bit(family):
    summary, rows = simulated(family)
    assert summary["success"], summary
    assert summary["replay"]["exact"]
    assert summary["rejected_frames"] == 0
    assert (rows["drive_state"][-1] == DriveState.OFF).all() or (
        rows["drive_state"][-1] == DriveState.READY
    ).all()
    assert rows["age"][10:].max() <= 1
    assert rows["doubled"].max() == rows["foreign"].max() == 0


@pytest.mark.parametrize(
    "family",
    broad([name for name in sorted(FAMILIES, key=lambda n: n not in SOME) if name != "legs"], quick=1),
)
def test_it_errs_as_with_our_own_protocol_because_friction_decides(family):
    ours, theirs = (simulated(name)[0]["tracking"]["rms_leg_error_mm"] for name in ("legs", family))
    assert theirs == pytest.approx(ours, rel=0.1)


@pytest.mark.parametrize(
    ("family", "rate_Hz", "arithmetic"),
    [
        ("damiao", 500, "12 x classic  8 byte: 135 bit = 135.0 us each, 1620.0 us"),
        ("robstride", 400, "12 x classic  8 byte: 160 bit = 160.0 us each, 1920.0 us"),
        ("odrive", 400, "6 x classic  0 byte: 55 bit = 55.0 us each, 330.0 us"),
        ("moteus", 1000, "6 x CAN FD  48 byte: 57 bit + 519 fast bit = 160.8 us"),
    ],
)
def test_a_bus_that_is_too_small_is_refused_with_the_arithmetic(family, rate_Hz, arithmetic):
    changes = [each for each in FAMILIES[family] if each != SLOW]
    if rate_Hz != 400:
        changes.append(("rate_Hz: 400\n", f"rate_Hz: {rate_Hz}\n"))
    with pytest.raises(ConfigurationError) as caught:
        desktop(*changes)
    assert arithmetic in str(caught.value)


def refused(*changes: tuple[str, str]) -> str:
    with pytest.raises(ConfigurationError) as caught:
        desktop(*changes)
    return str(caught.value)


def test_a_reaction_that_the_drives_do_not_have_is_refused():
    damp = ("recording:\n", "reactions:\n  silence: damp\n\nrecording:\n")
    assert (
        "reactions.silence: not what these drives do by themselves, allowed with drives.protocol mit"
        in refused(damp)
    )
    zero_velocity = [(old, new.replace("stopped", "zero_velocity")) for old, new in FAMILIES["moteus"]]
    desktop(*zero_velocity, damp)
    assert "options: damp, given: brake" in refused(*zero_velocity)


def test_a_stroke_that_the_position_field_does_not_hold_is_refused():
    # 12.5 rad x 5 mm = 62.5 mm on each side of 325 mm
    text = refused(("pulley_radius_m: 0.02", "pulley_radius_m: 0.005"))
    assert "the position that drive 0 reports ends at leg lengths of 0.2625 and 0.3875 m" in text


def test_a_fault_code_is_told_with_its_leg_and_what_the_maker_means_by_it():
    cycle = build_cycle(desktop(), 400.0, 0.01)
    cycle.tick["drive_state"], cycle.tick["age"] = DriveState.OFF, 0
    cycle.tick["drive_state"][4], cycle.tick["drive_fault"][4] = DriveState.FAULT, 0x100 + 8
    assert "drive 4 stays in FAULT (264: over voltage)" in waiting_text(cycle)


@pytest.mark.parametrize("family", broad(("cubemars", "mini_cheetah", "robstride", "damiao"), quick=1))
def test_drives_without_a_watchdog_are_not_said_to_have_stopped_on_a_dead_bus(family):
    """The plant decides: a leg whose brake has closed stands, one that has kept its torque does not."""
    ran = run(desktop(*FAMILIES[family]), BusOff(mode="TRACKING", at_s=0.6), duration_s=5.0)
    assert ran.ending.mode is Mode.FAULT
    stopped = np.abs(ran.true[-1] - ran.true[-5]).max() < 1e-9
    promised = "the watchdog of each acts" in ran.ending.trouble
    assert (stopped, promised) == ((family == "damiao"),) * 2
    assert ("they keep the last torque; cut their power now" in ran.ending.trouble) != promised


@pytest.mark.long
def test_a_jump_is_found_beside_a_drive_that_is_heard_four_times_in_five(tmp_path):
    """0.2 mm in motion, 0.09 mm are allowed; a way of one period, 0.3 mm, is allowed to the lossy leg alone."""
    faults = [
        {"kind": "frames_loss", "identifier": 22, "probability": 0.2, "at_s": 3.5},
        {"kind": "encoder_jump", "leg": 0, "at_s": 4.13, "by_m": 2e-4},
    ]
    c = loads(with_changes(TEXT, {"plant": {"faults": faults}}), "desktop")
    trouble = simulate(c, log=tmp_path / "run.mcap", duration_s=4.2, check_replay=False)["trouble"]
    assert "the length of leg 0 changed by" in str(trouble)
