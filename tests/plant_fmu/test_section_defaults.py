"""What the section `plant` and its faults take where nothing is said, and that all of it is allowed."""

from __future__ import annotations

from typing import Any

import pytest
from pydantic import BaseModel, ValidationError

from plant_fmu import config
from plant_fmu.faults import FAULTS
from plant_fmu.faults.kinds import FramesOld
from tests.plant_fmu.test_faults import example

FMU: dict[str, Any] = {"type": "fmu", "path": "a.fmu", "force": ["f"], "length": ["q"], "rate": ["v"]}
DEFAULTS: dict[str, tuple[BaseModel, dict[str, Any]]] = {
    "drives": (
        config.DriveEmulation(),
        {
            "encoder_resolution_m": 1e-6,
            "damping_N_s_m": 2e4,
            "hold_stiffness_N_m": 2e6,
            "force_bandwidth_Hz": 0.0,
            "brake_open_ms": 0.0,
            "brake_close_ms": 0.0,
        },
    ),
    "stewart": (
        config.StewartPlant(type="stewart"),
        {
            "type": "stewart",
            "fmi_version": "3.0",
            "isolation": "in_process",
            "force_bandwidth_Hz": 200.0,
            "viscous_friction_N_s_m": 0.0,
            "coulomb_friction_N": 0.0,
            "reflected_mass_kg": 0.0,
            "brake_force_N": 20_000.0,
            "internal_step_us": 100.0,
        },
    ),
    "bench": (
        config.BenchPlant(type="bench"),
        {
            "type": "bench",
            "mass_kg": 200.0,
            "damping_N_s2_m2": 500.0,
            "stiffness_N_m": 5_000.0,
            "stiffness_N_m3": 20_000.0,
            "rest_length_m": 1.6,
            "internal_step_us": 100.0,
        },
    ),
    "fmu": (
        config.FmuPlant.model_validate(FMU),
        {
            **FMU,
            "isolation": "child_process",
            "brake": [],
            "wrench": [],
            "parameters": {},
            "assume_unit": {},
            "allow_execution_tool": False,
            "memory_GB": 4.0,
            "step_us": 1000.0,
        },
    ),
    "tracker": (
        config.TrackerEmulation(),
        {
            "latency_ms": 5.0,
            "lost_percent": 0.0,
            "position_noise_m": 1e-3,
            "orientation_noise_deg": 0.1,
            "position_bias_m": (0.0, 0.0, 0.0),
            "rotation_bias_deg": (0.0, 0.0, 0.0),
        },
    ),
    "imu": (
        config.ImuEmulation(),
        {
            "latency_ms": 0.2,
            "lost_percent": 0.0,
            "angular_rate_noise_rad_s": 2e-3,
            "specific_force_noise_m_s2": 0.05,
            "angular_rate_bias_rad_s": (0.0, 0.0, 0.0),
            "specific_force_bias_m_s2": (0.0, 0.0, 0.0),
        },
    ),
    "wrench": (
        config.WrenchEmulation(),
        {
            "latency_ms": 0.0,
            "lost_percent": 0.0,
            "force_noise_N": 0.0,
            "moment_noise_N_m": 0.0,
            "force_bias_N": (0.0, 0.0, 0.0),
            "moment_bias_N_m": (0.0, 0.0, 0.0),
        },
    ),
}
OF_FAULTS: dict[str, dict[str, Any]] = {
    "bus_flood": {"rate_Hz": 8000.0, "bus": 0, "identifier": 0},
    "bus_second_controller": {"rate_Hz": 1000.0, "bus": 0, "force_N": 0.0},
    "bus_off": {"bus": None},
    "encoder_late": {"by_ms": 1.0},
    "encoder_noise": {"seed": 0},
    "frames_loss": {"probability": 1.0, "identifier": None, "seed": 0},
    "frames_forged_command": {"force_N": 0.0},
    "payload_step": {"position_m": (0.0, 0.0, 0.0)},
    "wrench_step": {"moment_N_m": (0.0, 0.0, 0.0)},
}
"""Beside those of all: at 0 s, of no mode, to the end."""


@pytest.mark.parametrize("name", DEFAULTS)
def test_a_section_in_which_nothing_is_said_has_the_documented_values_and_they_are_allowed(name):
    section, expected = DEFAULTS[name]
    assert section.model_dump() == expected
    assert type(section).model_validate(expected) == section


@pytest.mark.parametrize(
    "section", [config.DriveEmulation, lambda **key: config.StewartPlant(type="stewart", **key)]
)
@pytest.mark.parametrize(
    ("bandwidth_Hz", "fine"),
    [(0.0, True), (0.1, True), (1e6, True), (0.0999, False), (1e-60, False), (-1.0, False)],
)
def test_a_force_loop_is_ideal_or_as_fast_as_the_slowest_drive(section, bandwidth_Hz, fine):
    if fine:
        assert section(force_bandwidth_Hz=bandwidth_Hz).force_bandwidth_Hz == bandwidth_Hz
        return
    with pytest.raises(ValidationError, match="force_bandwidth_Hz"):
        section(force_bandwidth_Hz=bandwidth_Hz)


def test_a_plant_writes_its_log_and_its_sensors_have_the_seed_1_where_nothing_is_said():
    plant = config.PlantSettings.model_validate({"model": {"type": "bench"}})
    assert (plant.log, plant.sensors.seed, plant.faults, plant.homing_file) == (True, 1, [], None)
    assert (plant.initial_position_m, plant.initial_rotation_vector_deg) == (None, None)


def test_an_old_frame_is_the_one_before_the_last_where_nothing_is_said():
    assert FramesOld().back == 2


@pytest.mark.parametrize("name", FAULTS)
def test_a_fault_begins_at_once_and_lasts_and_its_other_values_are_allowed_ones(name):
    fault = example(name)
    said = fault.model_dump()
    assert type(fault).model_validate(said) == fault
    wanted = {"at_s": 0.0, "mode": None, **OF_FAULTS.get(name, {})}
    if name != "process_stop":
        wanted |= {key: None for key in ("for_s",) if key in said}
    assert {key: said[key] for key in wanted} == wanted
