"""Values that the section `plant` and its faults take: both ends of each range, maps of an FMU."""

from __future__ import annotations

from math import inf, nextafter
from typing import Any

import pytest
from pydantic import BaseModel, ValidationError

from plant_fmu import config
from plant_fmu.faults import FAULTS
from tests.plant_fmu.test_faults import example

FMU: dict[str, Any] = {"type": "fmu", "path": "a.fmu", "force": ["f"], "length": ["q"], "rate": ["v"]}
MADE: dict[str, BaseModel] = {
    "drives": config.DriveEmulation(),
    "stewart": config.StewartPlant(type="stewart"),
    "bench": config.BenchPlant(type="bench"),
    "fmu": config.FmuPlant.model_validate(FMU),
    "tracker": config.TrackerEmulation(),
    "imu": config.ImuEmulation(),
    "wrench": config.WrenchEmulation(),
    "sensors": config.SensorEmulation(),
}
Border = tuple[float | None, float | None]
"""What is allowed at this end of a range, and what is just beyond it; None: there is no end."""
NONE: Border = (None, None)
TINY = 1e-12


def least(value: float) -> Border:
    return value, value - 1 if isinstance(value, int) else nextafter(value, -inf)


def most(value: float) -> Border:
    return value, value + 1 if isinstance(value, int) else nextafter(value, inf)


FROM_0, ABOVE_0, INTEGER_FROM_0 = least(0.0), (TINY, 0.0), least(0)
SECTIONS: dict[str, dict[str, tuple[Border, Border]]] = {
    "drives": {
        **dict.fromkeys(
            ("encoder_resolution_m", "damping_N_s_m", "hold_stiffness_N_m", "force_bandwidth_Hz"),
            (FROM_0, NONE),
        ),
        **dict.fromkeys(("brake_open_ms", "brake_close_ms"), (FROM_0, most(10_000.0))),
    },
    "stewart": {
        "internal_step_us": (ABOVE_0, NONE),
        **dict.fromkeys(
            (
                *("force_bandwidth_Hz", "viscous_friction_N_s_m", "coulomb_friction_N"),
                *("reflected_mass_kg", "brake_force_N"),
            ),
            (FROM_0, NONE),
        ),
    },
    "bench": {
        **dict.fromkeys(("mass_kg", "rest_length_m", "internal_step_us"), (ABOVE_0, NONE)),
        **dict.fromkeys(("damping_N_s2_m2", "stiffness_N_m", "stiffness_N_m3"), (FROM_0, NONE)),
    },
    "fmu": {"memory_GB": (least(0.25), most(1024.0)), "step_us": (ABOVE_0, NONE)},
    "tracker": {
        "latency_ms": (FROM_0, most(60.0)),
        "lost_percent": (FROM_0, most(100.0)),
        **dict.fromkeys(("position_noise_m", "orientation_noise_deg"), (FROM_0, NONE)),
    },
    "imu": {
        "latency_ms": (FROM_0, most(60.0)),
        **dict.fromkeys(("angular_rate_noise_rad_s", "specific_force_noise_m_s2"), (FROM_0, NONE)),
    },
    "wrench": {
        "latency_ms": (FROM_0, most(60.0)),
        **dict.fromkeys(("force_noise_N", "moment_noise_N_m"), (FROM_0, NONE)),
    },
    "sensors": {"seed": (INTEGER_FROM_0, NONE)},
}
OF_FAULTS: dict[str, dict[str, tuple[Border, Border]]] = {
    "encoder_noise": {"sigma_m": (FROM_0, NONE), "seed": (INTEGER_FROM_0, NONE)},
    "encoder_late": {"by_ms": (ABOVE_0, most(1000.0))},
    "drive_reset": {},
    "drive_saturation": {"limit_N": (FROM_0, NONE)},
    "brake_slow": {"by_ms": (ABOVE_0, most(10_000.0))},
    "brake_slipping": {"share": (FROM_0, most(1.0))},
    "frames_loss": {
        "probability": (FROM_0, most(1.0)),
        "identifier": (INTEGER_FROM_0, NONE),
        "seed": (INTEGER_FROM_0, NONE),
    },
    "frames_delay": {"by_ms": (ABOVE_0, most(1000.0))},
    "frames_old": {"back": (least(1), most(1000))},
    "bus_off": {"bus": (INTEGER_FROM_0, most(5))},
    "bus_flood": {"rate_Hz": (ABOVE_0, most(100_000.0)), "identifier": (INTEGER_FROM_0, most(0x7FF))},
    "bus_second_controller": {"rate_Hz": (ABOVE_0, most(100_000.0)), "bus": (INTEGER_FROM_0, most(5))},
    "process_stop": {"for_s": (ABOVE_0, most(3600.0))},
    "process_slow": {"by_ms": (ABOVE_0, most(1000.0))},
    "payload_step": {"mass_kg": (ABOVE_0, NONE)},
}
"""Beside the time, the length and the leg of each."""


def allowed(of: BaseModel, key: str, value: object) -> bool:
    try:
        type(of).model_validate({**of.model_dump(), key: value})
    except ValidationError:
        return False
    return True


@pytest.mark.parametrize("name", [*SECTIONS, *FAULTS])
def test_a_section_takes_both_ends_of_its_ranges_and_nothing_beyond(name):
    section = MADE[name] if name in MADE else example(name)
    ranges = SECTIONS.get(name, OF_FAULTS.get(name, {}))
    if name in FAULTS:
        has = type(section).model_fields
        more = {"at_s": (FROM_0, NONE), "leg": (INTEGER_FROM_0, most(5)), "for_s": (ABOVE_0, NONE)}
        ranges = {key: ends for key, ends in more.items() if key in has} | ranges
    for key, ends in ranges.items():
        for inside, beyond in ends:
            assert inside is None or allowed(section, key, inside), (key, inside)
            assert beyond is None or not allowed(section, key, beyond), (key, beyond)


SIX = ["a", "b", "c", "d", "e", "f"]


def fmu(**changes: Any) -> config.FmuPlant:
    return config.FmuPlant.model_validate({**FMU, **changes})


@pytest.mark.parametrize("key", ["force", "length", "rate", "brake", "wrench"])
def test_six_variables_or_one_array_are_mapped_each_once(key):
    for names in (["a"], SIX):
        assert getattr(fmu(**{key: names}), key) == names
    for names in ([], ["a", "b"], SIX[:5], [*SIX, "g"], ["a", "f", "b", "b", "e", "f"]):
        if key in {"brake", "wrench"} and not names:
            assert getattr(fmu(**{key: names}), key) == []
            continue
        with pytest.raises(ValidationError, match=r"array of six|the same variable twice: b, f\b"):
            fmu(**{key: names})


@pytest.mark.parametrize("section", ["drives", "stewart"])
def test_a_force_loop_is_ideal_or_at_least_0_1_hz(section):
    for bandwidth_Hz in (0.0, 0.1, 1e6):
        assert allowed(MADE[section], "force_bandwidth_Hz", bandwidth_Hz)
    for bandwidth_Hz in (0.0999, 1e-60, -1.0):
        assert not allowed(MADE[section], "force_bandwidth_Hz", bandwidth_Hz)
