"""Payload and friction unknown to the controller, identified from logs of its runs on the bus path.

configs/virtual.yaml carries 230 kg at (0.5, 0.3, 0.5) m, encoders of 1 um; configs/lab.yaml has friction and
motor inertia that its controller's model lacks. The plant's physics code is independent.
"""

from __future__ import annotations

import json
import os

import numpy as np
import pytest
from click.testing import CliRunner

from drivers.signals import Mode
from hil.app.configuration.configuration import load
from hil.app.configuration.platform import build_platform
from hil.app.sim.command import simulate
from hil.cli import main
from hil.lab.identify.estimators.rigid_body import parameters_of
from hil.lab.identify.payload import identify_payload
from hil.lab.identify.payload_report import block
from hil.record.log import Log
from plant_fmu.faults.kinds import EncoderNoise
from tests.loop import loaded_plant

AXES = {
    "x_m": (0.08, 0.5),
    "y_m": (0.08, 0.7),
    "z_m": (0.06, 0.9),
    "rx_deg": (5, 0.8),
    "ry_deg": (5, 1.1),
    "rz_deg": (5, 1.3),
}
MOTION = {
    "type": "sinusoids",
    "duration_s": 10,
    "ramp_s": 2,
    "components": [{"axis": k, "amplitude": a, "frequency_Hz": f} for k, (a, f) in AXES.items()],
}
"""All six axes, each at its own frequency; small enough for a law that is 20 % off."""
MASS, COM, SIZE_m = 230.0, np.array([0.5, 0.3, 0.5]), np.array([0.4, 0.6, 0.5])
PAYLOAD = {"mass_kg": MASS, "com_m": COM.tolist(), "shape": {"type": "box", "size_m": SIZE_m.tolist()}}
LADEN = {"platform": {"platform": {"payload": [PAYLOAD]}}}
LATE_s = -75e-6
"""The drives sample at the end of SYNC, 75 us after the force that they report."""


def truth():
    """Inertia (3, 3) of platform and payload about the platform's origin, from the book and a box."""
    a, b, c = SIZE_m**2
    box = MASS / 12.0 * np.diag([b + c, a + c, a + b])
    return np.diag([570.0, 285.0, 285.0]) + box + MASS * (COM @ COM * np.eye(3) - np.outer(COM, COM))


def virtual():
    """The bench with that motion; a law without the payload may have a tracking error of 0.1 m."""
    return loaded_plant.changed(load("virtual"), reference=MOTION, limits={"following_error_m": 0.1})


def lab():
    """The shipped bench with friction, half as long."""
    return loaded_plant.changed(load("lab"), reference={"duration_s": 10})


def identify(*arguments):
    return CliRunner(env={"COLUMNS": "160"}).invoke(main, ["identify", "payload", *map(str, arguments)])


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Folder with the log a.mcap, with the payload."""
    made = tmp_path_factory.mktemp("payload")
    loaded_plant.run(virtual(), loaded_plant.changed(virtual(), **LADEN), made / "a.mcap")
    return made


@pytest.fixture(scope="module")
def more(folder):
    """The folder, also with the logs free.mcap, without a payload, and lab.mcap."""
    loaded_plant.run(virtual(), virtual(), folder / "free.mcap")
    assert simulate(lab(), log=folder / "lab.mcap", check_replay=False)["success"]
    return folder


@pytest.fixture(scope="module")
def found(folder):
    return identify_payload([folder / "a.mcap"])


def tensor(theta):
    xx, yy, zz, xy, xz, yz = theta[4:10]
    return np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])


def test_mass_centre_and_inertia_of_an_unknown_payload_are_identified(found):
    mass, moment = found.theta[0] - 1150.0, found.theta[1:4]
    off = np.abs(tensor(found.theta) - truth()).max() / truth().max()
    assert mass == pytest.approx(MASS, rel=0.005)
    assert moment == pytest.approx(MASS * COM, rel=0.02)
    assert off < 0.02
    assert np.abs(tensor(found.theta) / truth() - 1.0).max() < 0.1


def test_reflected_mass_given_as_an_option_is_not_estimated_in_payload_identification(found, folder):
    summary = folder / "given.json"
    result = identify(folder / "a.mcap", "--reflected", 2, "--json", summary)
    assert result.exit_code == 0, result.output
    assert "reflected mass, kg: 2 each, given" in result.output
    given = json.loads(summary.read_text())
    assert given["reflected_mass"] == "given"
    assert "reflected_mass_kg" not in given
    assert given["not_shown"] == []
    assert given["condition"] < found.estimate.condition
    assert given["block"]["controller"]["model"]["reflected_mass_kg"] == [2.0] * 6


@pytest.mark.long
def test_payload_block_printed_by_identification_restores_the_empty_platforms_tracking_error(found, tmp_path):
    """On the book's path: inverse dynamics with the identified payload, compared with a run without payload."""
    book = loaded_plant.changed(load("virtual"), reference={"periods": 1})
    heavy = loaded_plant.changed(book, **LADEN)

    def peak_mm(controller, plant, name):
        loaded_plant.run(controller, plant, tmp_path / name)
        rows = Log.open(tmp_path / name).rows()
        rows = rows[rows["mode"] == Mode.TRACKING]
        return 1e3 * float(np.abs(rows["q_d"] - rows["q"]).max())

    empty = peak_mm(book, book, "empty.mcap")
    fed = peak_mm(loaded_plant.changed(book, **block(found)), heavy, "fed.mcap")
    unknown = peak_mm(loaded_plant.changed(book, limits={"following_error_m": 0.1}), heavy, "unknown.mcap")
    assert fed <= 1.3 * empty
    assert unknown > 20.0 * empty


@pytest.mark.long
def test_friction_and_reflected_mass_of_every_leg_of_configuration_lab_are_identified(more):
    summary = more / "lab.json"
    result = identify(more / "lab.mcap", "--json", summary)
    assert result.exit_code == 0, result.output
    lab = json.loads(summary.read_text())
    assert lab["viscous_friction_N_s_m"] == pytest.approx([200.0] * 6, rel=0.05)
    assert lab["coulomb_friction_N"] == pytest.approx([60.0] * 6, rel=0.05)
    assert lab["reflected_mass_kg"] == pytest.approx([9.9] * 6, rel=0.05)
    assert lab["payload"] is None
    assert lab["platform"]["mass_kg"] == pytest.approx(300.0, rel=1e-3)
    model = lab["block"]["controller"]["model"]
    assert model["coulomb_friction_N"] == pytest.approx([60.0] * 6, rel=0.05)
    result = identify(more / "lab.mcap", "--reflected", 9.9, "--json", more / "given.json")
    assert result.exit_code == 0, result.output
    given = json.loads((more / "given.json").read_text())
    assert given["coulomb_friction_N"] == pytest.approx([60.0] * 6, rel=0.05)
    assert given["block"]["controller"]["model"]["reflected_mass_kg"] == [9.9] * 6


def test_identification_computes_forces_the_drives_do_not_report_from_commands(folder, monkeypatch):
    """Layout classic does not contain them. The configured delay, 1 ms, is 0.5 ms too long, which the fit
    finds.

    Encoders are latched 0.025 ms before the time grid of rates and forces.
    """
    rows = Log.rows

    def silent(log):
        found = rows(log).copy()
        found["drive_force"] = 0.0
        return found

    monkeypatch.setattr(Log, "rows", silent)
    found = identify_payload([folder / "a.mcap"])
    assert found.sources[0].sent
    late_ms = 1e3 * found.theta[22]
    assert late_ms == pytest.approx(0.475, abs=0.02)
    assert found.theta[0] - 1150.0 == pytest.approx(MASS, rel=0.005)
    assert np.abs(tensor(found.theta) - truth()).max() < 0.02 * truth().max()


MOTIONS = (
    ("virtual", ((0.08, 0.5), (0.08, 0.7), (0.06, 0.9), (5, 0.8), (5, 1.1), (5, 1.3))),
    ("virtual", ((0.06, 0.9), (0.07, 0.6), (0.05, 1.3), (4, 1.1), (4, 0.7), (5, 0.4))),
    ("lab", ()),
    ("lab", ((0.04, 0.5), (0.05, 0.7), (0.03, 0.9), (4, 0.8), (3, 1.1), (4, 1.3))),
    ("lab", ((0.05, 0.4), (0.03, 1.1), (0.04, 0.6), (3, 1.3), (4, 0.9), (5, 0.5))),
)
"""Platform with an unknown payload, or with friction; amplitudes and frequencies, else the shipped motion."""
FRICTION = {"virtual": [0.0] * 12, "lab": [200.0] * 6 + [60.0] * 6}
REFLECTED_kg = {"virtual": 0.0, "lab": 9.9}


def relative_errors(name, axes, seed, path):
    """Errors (29,) in units of the printed standard error, with white noise of 2 um on every encoder."""
    parts = [{"axis": k, "amplitude": a, "frequency_Hz": f} for k, (a, f) in zip(AXES, axes, strict=False)]
    reference = {**MOTION, "components": parts} if parts else {"duration_s": 10}
    c = loaded_plant.changed(load(name), reference=reference, limits={"following_error_m": 0.1})
    plant = loaded_plant.changed(c, **LADEN) if name == "virtual" else c
    noise = [EncoderNoise(leg=leg, at_s=0.0, sigma_m=2e-6, seed=6 * seed + leg) for leg in range(6)]
    loaded_plant.run(c, plant, path, *noise)
    found = identify_payload([path])
    body = parameters_of(build_platform(plant.platform).platform)
    true = np.hstack([body, FRICTION[name], LATE_s, [REFLECTED_kg[name]] * 6])
    return (found.theta - true) / found.estimate.std


@pytest.mark.long
def test_errors_of_the_identified_payload_agree_with_the_reported_standard_errors(tmp_path):
    """In the closed loop, where the law returns the encoders' noise as force."""
    e = [
        relative_errors(name, axes, seed, tmp_path / f"{k}-{seed}.mcap")
        for k, (name, axes) in enumerate(MOTIONS)
        for seed in range(int(os.environ.get("SEEDS", "3")))
    ]
    assert 0.8 < np.sqrt(np.mean(np.square(e))) < 1.25
    assert np.abs(e).max() < 4.0


@pytest.mark.long
def test_standard_errors_of_the_identified_payload_match_the_spread_over_noise_seeds(tmp_path):
    """White noise of 2 um on every encoder, in the closed loop, 12 seeds."""
    c = loaded_plant.changed(virtual(), reference={**MOTION, "duration_s": 14})
    plant = loaded_plant.changed(c, **LADEN)
    theta, std = [], []
    for seed in range(12):
        noise = [EncoderNoise(leg=leg, at_s=0.0, sigma_m=2e-6, seed=6 * seed + leg) for leg in range(6)]
        path = tmp_path / f"{seed}.mcap"
        loaded_plant.run(c, plant, path, *noise)
        found = identify_payload([path])
        theta.append(found.theta)
        std.append(found.estimate.std)
        path.unlink()
    ratio = np.sqrt(np.mean(np.square(std), axis=0)) / np.std(theta, axis=0, ddof=1)
    assert ratio.min() > 0.5
    assert ratio.max() < 2.0
    assert np.mean(theta, axis=0)[0] - 1150.0 == pytest.approx(MASS, rel=0.005)
